"""A C compiler and a cache of what it made.

A library is kept in the user's cache folder, or in the folder that ``HALFSHAFT_CACHE`` names.  Its name holds a hash of
source and flags, one of the compiler, and one of its own content, by which damage is seen before it is loaded.  It is
built aside and moved into place, so several processes may fill the cache at once.  Without a compiler a library that
any compiler made of this source serves.  Where the cache cannot be written, or nothing in it may be executed, a private
temporary folder serves until the program ends.
"""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import importlib.util
import os
import shlex
import shutil
import stat
import subprocess
import sys
import sysconfig
import tempfile
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import platformdirs

from halfshaft.library.base.errors import CompileError

# No contraction: the same digits on every processor.  The compiler may take fmin, fmax and sqrt as instructions.
FLAGS = (
    "-O3", "-std=c99", "-fPIC", "-shared", "-fvisibility=hidden", "-fno-semantic-interposition",
    "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off",
)  # fmt: skip
#: A step is a long chain of choices that seldom change: a branch that is foreseen costs less than waiting for both sides.
GCC_FLAGS = ("-fno-if-conversion",)
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
#: Libraries go that were not used for so long [s], and the oldest ones of those that take more than this together [bytes].
OLDEST, LARGEST = 90 * 86400, 128 * 2**20
#: A folder for a build that is older than this was left by a program that was killed [s].
STALE = 3600


class SlowWarning(UserWarning):
    """The result is right, but getting it takes longer than it has to."""


class Compiler(NamedTuple):
    """Command that compiles C, and what tells this compiler from others."""

    command: tuple[str, ...]
    identity: str

    @property
    def flags(self) -> tuple[str, ...]:
        """Flags for this compiler."""
        return (*FLAGS, *GCC_FLAGS) if "Free Software Foundation" in self.identity else FLAGS


def find_compiler() -> Compiler:
    """Return the compiler that ``CC`` names, else cc, gcc, clang, or the one of the ziglang package.

    Raises
    ------
    CompileError
        If there is none.

    """
    return _find_compiler(os.environ.get("CC", "").strip(), os.environ.get("PATH", ""))


@cache
def _find_compiler(wanted: str, path: str) -> Compiler:
    try:
        commands = [shlex.split(wanted)] if wanted else [["cc"], ["gcc"], ["clang"]]
    except ValueError as error:
        raise CompileError(f"the environment variable CC is not a command ({error}): {wanted}") from None
    for command in commands:
        program = shutil.which(command[0], path=path)
        if program:
            return _identified((program, *command[1:]))
    if wanted:
        raise CompileError(f"the C compiler that the environment variable CC names was not found or is not executable: {wanted}")
    if importlib.util.find_spec("ziglang"):
        # The plainest processor, as the other compilers assume; zig would take the one of this machine.
        return _identified((sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"))
    raise CompileError("no C compiler found (tried $CC, cc, gcc, clang, ziglang); 'pip install halfshaft[compiler]' brings one")


def _identified(command: tuple[str, ...]) -> Compiler:
    answer = _call([*command, "--version"])
    if answer.returncode < 0:
        raise CompileError(f"the C compiler {command[0]} crashes (signal {-answer.returncode})")
    return Compiler(command, "\n".join([*command, answer.stdout]))


def _call(command: list[str], folder: str | None = None) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False)
    except OSError as error:
        raise CompileError(f"the C compiler {command[0]} cannot be run: {error.strerror or error}") from error


def shared_library(source: str, name: str, headers: Mapping[str, str] | None = None, flags: tuple[str, ...] = ()) -> Path:
    """Return a shared library made from C that can be loaded, compiled only if the cache does not have it.

    Symbols are hidden unless the source exports them.

    Parameters
    ----------
    source
        One translation unit of C99.
    name
        First part of the file's name.
    headers
        Files that the source includes, text by name.
    flags
        For the compiler, after those that it always gets; behind them stand those of the environment variable ``HALFSHAFT_CFLAGS``.

    Raises
    ------
    CompileError
        If there is no compiler and nothing in the cache, it refuses the source, or nothing that it makes can be loaded.

    """
    flags = (*flags, *shlex.split(os.environ.get("HALFSHAFT_CFLAGS", "")))
    files = {f"{name}.c": source, **(headers or {})}
    stem = f"{name}-{_hash(sysconfig.get_platform(), *FLAGS, *flags, *(text for item in sorted(files.items()) for text in item))}"
    folder = Path(os.environ.get("HALFSHAFT_CACHE") or platformdirs.user_cache_dir("halfshaft"))
    try:
        compiler = find_compiler()
    except CompileError as error:
        with suppress(OSError):
            if kept := _kept(folder, stem):
                if "CC" in os.environ:
                    _warn_once(Path("CC"), f"{error}; what the cache {folder} holds is used")
                return kept
        raise
    stem = f"{stem}-{_hash(compiler.identity, *compiler.flags)}"
    try:
        return _kept(folder, stem) or _compiled(compiler, files, name, folder, stem, flags)
    except OSError as error:
        text = f"the cache folder {folder} cannot be used ({error}): each program run compiles anew; set HALFSHAFT_CACHE to another folder"
        _warn_once(folder, text)
    try:
        folder = _private_folder()
        return _kept(folder, stem) or _compiled(compiler, files, name, folder, stem, flags)
    except OSError as error:
        raise CompileError(f"no place to compile {name} and load it: {error}") from error


def _hash(*parts: str | bytes) -> str:
    whole = b"\0".join(part if isinstance(part, bytes) else os.fsencode(part) for part in parts)
    return hashlib.sha256(whole).hexdigest()[:32]


def _kept(folder: Path, stem: str) -> Path | None:
    """Return the library of the folder whose name begins so; one whose content is not what its name says is removed."""
    for library in sorted(folder.glob(f"{stem}-*{SUFFIX}")):
        if _foreign(library):
            raise PermissionError(f"{library.name} belongs to another user in a folder where everybody may write")
        if library.stem.rpartition("-")[2] == _hash(library.read_bytes()):
            # Its date says when it was used last, to a day.
            with suppress(OSError):
                if time.time() - library.stat().st_mtime > 86400:
                    os.utime(library)
            return _loaded(library)
        _warn_once(library, f"the library {library} is damaged: compiled anew")
        with suppress(OSError):
            library.unlink()
    return None


def _foreign(library: Path) -> bool:
    """Return whether another user, who is not the administrator, may have put the library there uninvited."""
    if not hasattr(os, "geteuid") or library.stat().st_uid in (0, os.geteuid()):
        return False
    return any(folder.stat().st_mode & stat.S_IWOTH for folder in library.absolute().parents)


def _loaded(library: Path) -> Path:
    """Return a library that can be loaded: not every file system lets its files be executed."""
    ctypes.CDLL(str(library))
    return library


def _compiled(compiler: Compiler, files: Mapping[str, str], name: str, folder: Path, stem: str, flags: tuple[str, ...]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".build-", dir=folder) as build:
        for file_name, text in files.items():
            Path(build, file_name).write_text(text, encoding="utf-8", newline="\n")
        # File names without folders: nothing of this machine gets into the library.
        made = Path(build, f"{name}{SUFFIX}")
        done = _call([*compiler.command, *compiler.flags, *flags, "-o", made.name, f"{name}.c", "-lm"], build)
        if done.returncode or not made.is_file():
            said = (done.stderr or done.stdout).strip().splitlines()[:10]
            how = f"signal {-done.returncode}" if done.returncode < 0 else f"exit code {done.returncode}"
            raise CompileError("\n  ".join([f"{compiler.command[0]} failed on {name}.c:", *(said or [f"{how}, nothing said, no library"])]))
        with made.open("rb+") as file:
            library = folder / f"{stem}-{_hash(file.read())}{SUFFIX}"
            os.fsync(file.fileno())
        try:
            os.replace(made, library)
        except OSError:
            # Another process was first, and the file is in use (Windows).
            if not library.exists():
                raise
    _tidy(folder, library)
    return _loaded(library)


def _tidy(folder: Path, made: Path) -> None:
    """Remove builds that were left behind, and libraries that were not used for long or take too much room."""
    now = time.time()
    for build in folder.glob(".build-*"):
        with suppress(OSError):
            if now - build.stat().st_mtime > STALE:
                shutil.rmtree(build, ignore_errors=True)
    found = []
    for library in folder.glob(f"*-{'[0-9a-f]' * 32}{SUFFIX}"):
        with suppress(OSError):
            at = library.stat()
            found.append((at.st_mtime, at.st_size, library))
    room = LARGEST
    for used, size, library in sorted(found, reverse=True):
        room -= size
        if library != made and (room < 0 or now - used > OLDEST):
            with suppress(OSError):
                library.unlink()


@cache
def _private_folder() -> Path:
    folder = tempfile.mkdtemp(prefix="halfshaft-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _warn_once(about: Path, text: str) -> None:
    if about not in _warned:
        _warned.add(about)
        warnings.warn(text, SlowWarning, stacklevel=3)


_warned: set[Path] = set()
