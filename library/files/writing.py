"""Writes files whole or not at all."""

from __future__ import annotations

import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from halfshaft.library.base.errors import InputError


def target_problem(path: Path) -> str:
    """Return why no file can be written to a path, as far as that shows before; empty if nothing is in the way."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        mode = None
    except (OSError, ValueError) as error:
        return f"cannot be written: {getattr(error, 'strerror', None) or error}"
    if mode is not None:
        if stat.S_ISDIR(mode):
            return "is a folder, must be a file"
        if not stat.S_ISREG(mode):
            return "is a device or a pipe, must be a file"
        if not os.access(path, os.W_OK):
            return "is there and must not be written to"
    folder = _followed(path).parent
    if not folder.is_dir():
        return f"there is no folder {folder}"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"the folder {folder} cannot be written to"
    return ""


def source_date() -> datetime | None:
    """Return the date that ``SOURCE_DATE_EPOCH`` sets for what is written, or None if it sets none.

    Raises
    ------
    InputError
        If the variable holds no time.

    """
    given = os.environ.get("SOURCE_DATE_EPOCH", "")
    if not given:
        return None
    try:
        if not re.fullmatch("[0-9]+", given):
            raise ValueError
        return datetime.fromtimestamp(int(given), UTC)
    except (ValueError, OverflowError, OSError):
        problem = f'SOURCE_DATE_EPOCH = "{ascii(given[:40])[1:-1]}", must be whole seconds since 1970'
        raise InputError("environment", [problem]) from None


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Give a place beside `path` to write to; what is written takes its place at the end, or leaves no trace.

    A link stays, and what it points to is replaced; a file that was there hands on its permissions.

    Raises
    ------
    InputError
        If the file cannot be written, or what is there is no file.

    """
    if problem := target_problem(Path(path)):
        raise InputError(str(path), [problem])
    target = _followed(Path(path))
    try:
        with tempfile.TemporaryDirectory(prefix=".part-", dir=target.parent) as folder:
            part = Path(folder, target.name)
            yield part
            if target.exists():
                part.chmod(stat.S_IMODE(target.stat().st_mode))
            os.replace(part, target)
    except OSError as error:
        raise InputError(str(path), [f"cannot be written: {error.strerror or error}"]) from error


def _followed(path: Path) -> Path:
    return Path(os.path.realpath(path)) if path.is_symlink() else path
