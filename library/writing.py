"""Writes files whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from halfshaft.library.errors import InputError


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Give a place beside `path` to write to; what is written takes its place at the end, or leaves no trace.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    target = Path(path)
    try:
        with tempfile.TemporaryDirectory(prefix=".part-", dir=target.parent) as folder:
            part = Path(folder, target.name)
            yield part
            os.replace(part, target)
    except OSError as error:
        raise InputError(str(target), [f"cannot be written: {error.strerror or error}"]) from error
