"""Texts that a user gives: read from regular files of a bounded size, and free of control characters."""

from __future__ import annotations

import os
import re
import stat
from functools import lru_cache
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import BinaryIO

from halfshaft.library.base.errors import InputError

#: What a name may look like; it stands in FMUs, in tables and on the terminal.
NAME = re.compile(r"\w[\w .+()-]{0,99}")


def open_regular(path: str | Path) -> BinaryIO:
    """Open a file for reading, and refuse at once what is no regular file: a pipe or a device may never end.

    Raises
    ------
    InputError
        If there is no such file, or it is no regular one.

    """
    try:
        # A pipe without a writer is opened too, instead of being waited for.
        file = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)), "rb")
    except (OSError, ValueError) as e:
        raise InputError(str(path), [f"cannot be read: {getattr(e, 'strerror', None) or e}"]) from e
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return file
    file.close()
    raise InputError(str(path), ["is not a regular file"])


def read_text(path: Path | Traversable, most: int) -> str:
    """Return the text of a file of at most `most` megabytes.

    Raises
    ------
    InputError
        If there is no such file, it is no regular one, too large, or not in UTF-8.

    """
    if isinstance(path, Path):
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            # What grows while it is read, or does not tell its size, is cut off here.
            content = file.read(most * 10**6 + 1) if size <= most * 10**6 else b""
        if max(size, len(content)) > most * 10**6:
            raise InputError(str(path), [f"has more than {most} MB, which is the most that is read"])
    else:
        content = path.read_bytes()
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise InputError(str(path), [f"not a text file in UTF-8: {e.reason} at byte {e.start + 1}"]) from e


@lru_cache(maxsize=256)
def cleaned(text: str) -> str:
    """Return a title or a source on one line, without control characters, marks of direction and doubled spaces."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def name_problem(name: str) -> str | None:
    """Return what is wrong with a name, if anything."""
    if NAME.fullmatch(name):
        return None
    return f'name = "{name}", must be letters, digits, spaces and _ . + - ( ), begin with a letter or a digit and have at most 100 of them'
