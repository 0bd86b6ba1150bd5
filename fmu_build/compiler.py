"""A C compiler and a cache of what it made.

A library is kept in the user's cache folder, or in the folder that ``HALFSHAFT_CACHE`` names, under a hash of its
source, the compiler and the flags.  It is built aside and moved into place, so several processes may fill the cache
at once.  Where the cache cannot be written, a private temporary folder serves until the program ends.
"""

from __future__ import annotations

import atexit
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import platformdirs

from halfshaft.library.errors import CompileError

# No contraction: the same digits on every processor.  The compiler may take fmin, fmax and sqrt as instructions.
FLAGS = (
    "-O3", "-std=c99", "-fPIC", "-shared", "-fvisibility=hidden", "-fno-semantic-interposition",
    "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off",
)  # fmt: skip
#: A step is a long chain of choices that seldom change: a branch that is foreseen costs less than waiting for both sides.
GCC_FLAGS = ("-fno-if-conversion",)
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


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
    for command in [shlex.split(wanted)] if wanted else [["cc"], ["gcc"], ["clang"]]:
        program = shutil.which(command[0], path=path)
        if program:
            return _identified((program, *command[1:]))
    if wanted:
        raise CompileError(f"the C compiler that the environment variable CC names was not found: {wanted}")
    if importlib.util.find_spec("ziglang"):
        # The plainest processor, as the other compilers assume; zig would take the one of this machine.
        return _identified((sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"))
    raise CompileError("no C compiler found (tried $CC, cc, gcc, clang, ziglang); 'pip install halfshaft[compiler]' brings one")


def _identified(command: tuple[str, ...]) -> Compiler:
    answer = subprocess.run([*command, "--version"], capture_output=True, text=True, errors="replace", check=False)
    return Compiler(command, "\n".join([*command, answer.stdout]))


def shared_library(source: str, name: str, headers: Mapping[str, str] | None = None) -> Path:
    """Return a shared library made from C, compiled only if the cache does not have it.

    Symbols are hidden unless the source exports them.

    Parameters
    ----------
    source
        One translation unit of C99.
    name
        First part of the file's name.
    headers
        Files that the source includes, text by name.

    Raises
    ------
    CompileError
        If there is no compiler or it refuses the source.

    """
    compiler = find_compiler()
    files = {f"{name}.c": source, **(headers or {})}
    content = "\0".join([compiler.identity, *compiler.flags, *(text for item in sorted(files.items()) for text in item)])
    file_name = f"{name}-{hashlib.sha256(content.encode()).hexdigest()[:32]}{SUFFIX}"
    folder = Path(os.environ.get("HALFSHAFT_CACHE") or platformdirs.user_cache_dir("halfshaft"))
    try:
        return _kept(folder / file_name, compiler, files, name)
    except OSError as error:
        _warn_once(folder, str(error))
    try:
        return _kept(_private_folder() / file_name, compiler, files, name)
    except OSError as error:
        raise CompileError(f"no place to compile {name}: {error}") from error


def _kept(target: Path, compiler: Compiler, files: Mapping[str, str], name: str) -> Path:
    if not target.exists():
        _compile(compiler, files, name, target)
    return target


def _compile(compiler: Compiler, files: Mapping[str, str], name: str, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".build-", dir=target.parent) as build:
        for file_name, text in files.items():
            Path(build, file_name).write_text(text, encoding="utf-8", newline="\n")
        command = [*compiler.command, *compiler.flags, "-o", target.name, f"{name}.c", "-lm"]
        # File names without folders: nothing of this machine gets into the library.
        done = subprocess.run(command, cwd=build, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode:
            said = "\n  ".join((done.stderr or done.stdout).strip().splitlines()[:10])
            raise CompileError(f"{compiler.command[0]} failed on {name}.c:\n  {said}")
        try:
            os.replace(Path(build, target.name), target)
        except OSError:
            # Another process was first, and the file is in use (Windows).
            if not target.exists():
                raise


@cache
def _private_folder() -> Path:
    folder = tempfile.mkdtemp(prefix="halfshaft-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


@cache
def _warn_once(folder: Path, reason: str) -> None:
    warnings.warn(
        f"the cache folder {folder} cannot be written ({reason}): each program run compiles anew; set HALFSHAFT_CACHE to another folder",
        SlowWarning,
        stacklevel=3,
    )
