"""Changes single places of the program and runs the tests: a change that no test notices shows what the tests do not hold.

``make mutate`` draws a sample of changes with a fixed seed from the Python and C of the packages, a swapped operator, a dropped
term, another number, a branch taken the other way, and runs the tests for each in a copy of the checkout.  The sample spreads over
the packages by their numbers of places.  It takes an hour or two, so it is no part of the suite.

A survey comes first: which lines does each file of tests execute, and how long does it take?  A change is then shown only to those
that execute its line, one after the other until one notices: cheap ones first, those of its name, and those that noticed others of
its kind.  Each runs in a process of its own, forked from one that has the large libraries, with the compiled code of the survey at
hand.  After a while, what is left is shown to the other files several at a time, and by halves if that is noticed.  What is known is
written as it comes, so a run that was stopped goes on.

mutmut and cosmic-ray were considered: neither changes C, and neither finds packages whose folders have other names.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import multiprocessing
import os
import random
import re
import shlex
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.context import ForkServerContext
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import NamedTuple, TypedDict

from halfshaft.fmu_build.compiler import find_compiler

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("library", "models", "fmu_build", "cosim", "studies", "app")
#: For so long on a processor [s] tests are shown a change alone, then with up to so many others.
ALONE, GROUP = 50, 8
#: A file of tests that takes so many times its time on a processor, and so much longer [s], hangs, which is noticed.
PATIENCE = (20, 60)
#: Libraries that most tests need and that no change touches.
LIBRARIES = [
    "casadi",
    "fmpy",
    "h5netcdf",
    "matplotlib.figure",
    "numpy",
    "pint",
    "pytest",
    "scipy.interpolate",
    "tomlkit",
    "typer",
    "xarray",
]
#: Writes each line of the program that is executed first to a file; as `sitecustomize` in the processes too that tests start.
RECORDER = """
import os, sys, threading
program, out = os.environ["MUTATE_PROGRAM"], os.open(os.environ["MUTATE_LINES"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
seen = set()
def line(frame, event, arg):
    at = frame.f_code.co_filename, frame.f_lineno
    if at not in seen:
        seen.add(at)
        os.write(out, f"{at[0].removeprefix(program)}:{at[1]}\\n".encode())
    return line
def call(frame, event, arg):
    return line(frame, event, arg) if frame.f_code.co_filename.startswith(program) else None
threading.settrace(call)
sys.settrace(call)
"""

_SWAPPED: dict[type[ast.AST], str] = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Pow: "*", ast.Lt: ">=", ast.GtE: "<", ast.Gt: "<=", ast.LtE: ">",
    ast.Eq: "!=", ast.NotEq: "==", ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in", ast.And: "or", ast.Or: "and",
}  # fmt: skip
_NAMES = {
    "fmin": "fmax",
    "fmax": "fmin",
    "logic_and": "logic_or",
    "logic_or": "logic_and",
    "max": "min",
    "min": "max",
    "any": "all",
    "all": "any",
}
_C_SWAPPED = {
    "<=": ">", ">=": "<", "==": "!=", "!=": "==", "&&": "||", "||": "&&", "<": ">=", ">": "<=", "+=": "-=", "-=": "+=", "+": "-", "-": "+",
    "*": "/", "/": "*",
}  # fmt: skip
_C_TOKEN = re.compile(
    r'"(?:\\.|[^"\\])*"|/\*.*?\*/|//[^\n]*|^[ \t]*#[^\n]*|->|\+\+|--|<<|>>|[-+*/<>=!]=|&&|\|\||[-+*/<>](?=\s)|\b\d+(?:\.\d+)?\b',
    re.M | re.S,
)


class Mutant(NamedTuple):
    """One change: the characters from `start` to `end` of a file become `text`."""

    path: str
    line: int
    column: int
    start: int
    end: int
    text: str
    was: str

    def __str__(self) -> str:
        """Return place and change on one line."""
        return f"{self.path}:{self.line}:{self.column}: {' '.join(self.was.split())} -> {' '.join(self.text.split()) or 'nothing'}"


def python_mutants(path: str, source: str) -> Iterator[Mutant]:
    """Yield the changes of a Python file, apart from texts, annotations and imports."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    data = source.encode()

    def place(line: int, column: int) -> int:
        return len(data[: starts[line - 1] + column].decode())

    def change(node: ast.expr | ast.stmt, start: int, end: int, text: str) -> Mutant:
        line = source.count("\n", 0, start) + 1
        return Mutant(path, line, start - source.rfind("\n", 0, start), start, end, text, source[start:end])

    def ends(node: ast.expr | ast.stmt) -> tuple[int, int]:
        return place(node.lineno, node.col_offset), place(node.end_lineno or 0, node.end_col_offset or 0)

    def operator(left: ast.expr, op: ast.AST, right: ast.expr) -> Iterator[Mutant]:
        if type(op) in _SWAPPED:
            start, end = ends(left)[1], ends(right)[0]
            between = source[start:end]
            word = {ast.And: "and", ast.Or: "or", ast.Is: "is", ast.IsNot: "is not", ast.In: "in", ast.NotIn: "not in"}.get(type(op))
            found = re.search(rf"\b{word}\b" if word else r"\*\*|[-+*/<>=!]=?", between)
            if found:
                yield change(left, start + found.start(), start + found.end(), _SWAPPED[type(op)])

    skipped: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation is not None:
            skipped |= {id(n) for n in ast.walk(node.annotation)}
        if isinstance(node, ast.FunctionDef) and node.returns is not None:
            skipped |= {id(n) for n in ast.walk(node.returns)}
        if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)):
            skipped |= {id(n) for n in ast.walk(node)}
        if id(node) in skipped:
            continue
        if isinstance(node, ast.BinOp) and not isinstance(node.left, ast.Constant | ast.JoinedStr):
            yield from operator(node.left, node.op, node.right)
            if isinstance(node.op, ast.Add | ast.Sub):
                yield change(node, *ends(node), source[slice(*ends(node.left))])
        elif isinstance(node, ast.Compare):
            for left, op, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
                yield from operator(left, op, right)
        elif isinstance(node, ast.BoolOp):
            yield from operator(node.values[0], node.op, node.values[1])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            yield change(node, *ends(node), source[slice(*ends(node.operand))])
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            other = str(not node.value) if isinstance(node.value, bool) else "1" if node.value == 0 else f"(2 * {node.value!r})"
            yield change(node, *ends(node), other)
        elif isinstance(node, ast.Attribute | ast.Name) and (name := getattr(node, "attr", None) or getattr(node, "id", "")) in _NAMES:
            end = ends(node)[1]
            yield change(node, end - len(name), end, _NAMES[name])
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield change(node, *ends(node), "pass")
        elif isinstance(node, ast.If | ast.IfExp):
            test = ends(node.test)
            yield change(node.test, *test, f"not ({source[slice(*test)]})")


def c_mutants(path: str, source: str) -> Iterator[Mutant]:
    """Yield the changes of a C file, apart from comments, texts and directives."""
    for found in _C_TOKEN.finditer(source):
        token = found[0]
        number = re.fullmatch(r"\d+(?:\.\d+)?", token)
        if token in _C_SWAPPED or number:
            other = _C_SWAPPED.get(token) or ("1" if float(token) == 0 else str(2 * (float(token) if "." in token else int(token))))
            start, end = found.span()
            yield Mutant(path, source.count("\n", 0, start) + 1, start - source.rfind("\n", 0, start), start, end, other, token)


def all_mutants(root: Path, folders: Sequence[str] = FOLDERS) -> list[Mutant]:
    """Return every change of the program's files, in the order of the files."""
    found: list[Mutant] = []
    for folder in folders:
        for path in sorted((root / folder).rglob("*")):
            make = {".py": python_mutants, ".c": c_mutants, ".h": c_mutants}.get(path.suffix)
            if make:
                found += make(str(path.relative_to(root)), path.read_text(encoding="utf-8"))
    return found


class Survey(TypedDict):
    """What is known of a file of tests: a hash of what it was made of, its time on a processor [s], the lines it executes."""

    made_of: str
    seconds: float
    lines: dict[str, list[int]]


def statement(source: str, line: int) -> range:
    """Return the lines of the innermost statement at a line; of one with a body, those before the body."""
    found = range(line, line + 1)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt):
            body: list[ast.stmt] = getattr(node, "body", [])
            last = max(node.lineno, body[0].lineno - 1) if body else node.end_lineno or node.lineno
            if node.lineno <= line <= last:
                found = range(node.lineno, last + 1)
    return found


class Checkout:
    """A copy of the checkout in which tests run."""

    def __init__(self, folder: Path, context: ForkServerContext):
        self.root, self.log, self.context = folder / "halfshaft", folder / "log", context
        ignored = shutil.ignore_patterns(".venv", ".git", "build", "__pycache__", ".*_cache", ".hypothesis")
        shutil.copytree(ROOT, self.root, symlinks=True, ignore=ignored)
        (folder / "sitecustomize.py").write_text(RECORDER)
        # Most of what is compiled runs for a second.
        (folder / "cc").write_text(f'#!/bin/sh\nexec {shlex.join(find_compiler().command)} "$@" -O0\n')
        (folder / "cc").chmod(0o755)

    def test(self, file: str, cache: Path, lines: Path | None = None, patience: float | None = None) -> str:
        """Return the first test of a file that fails; empty if none does.  The lines that were executed go into the file `lines`."""
        process = self.context.Process(target=_session, args=(self.root, self.log, file, cache, lines))
        process.start()
        process.join(patience)
        late = process.is_alive()
        with suppress(ProcessLookupError):  # together with those that the tests started
            os.killpg(process.pid or 0, signal.SIGKILL)
        process.join()
        if late or not process.exitcode:
            return "too slow" if late else ""
        failed = re.search(r"^(?:FAILED|ERROR) (\S+)", self.log.read_text(errors="replace"), re.M)
        return failed[1] if failed else f"{file} ended with {process.exitcode}"

    def survey(self, file: str, made_of: str, cache: Path) -> Survey:
        """Run a file of tests and record what it executes; what fails in that, for the time it takes, must pass without."""
        lines = self.log.with_name("lines")
        lines.write_text("")
        failed = self.test(file, cache, lines) and self.test(file, cache)
        if failed:
            raise RuntimeError(f"{failed} fails without any change:\n{self.log.read_text()}")
        seconds = float(self.log.read_text().split()[-1])
        found: dict[str, set[int]] = {}
        for path, line in (row.split(":") for row in lines.read_text().split()):
            found.setdefault(path, set()).add(int(line))
        return Survey(made_of=made_of, seconds=seconds, lines={path: sorted(at) for path, at in found.items()})

    def notice(self, mutants: Sequence[Mutant], files: dict[str, float], compiled: Path) -> tuple[str, list[str]]:
        """Return the first test that notices changes, empty if none does, and the files that ran, of those given with their times."""
        cache = self.log.with_name("cache")
        shutil.copytree(compiled, cache, copy_function=os.link)
        # Those behind keep their places.
        for mutant in sorted(mutants, key=lambda mutant: mutant.start, reverse=True):
            path = self.root / mutant.path
            source = path.read_text(encoding="utf-8")
            path.write_text(source[: mutant.start] + mutant.text + source[mutant.end :], encoding="utf-8")
        by, ran = "", []
        for file, seconds in files.items():
            ran.append(file)
            by = self.test(file, cache, patience=PATIENCE[0] * seconds + PATIENCE[1])
            if by:
                break
        for mutant in mutants:
            shutil.copyfile(ROOT / mutant.path, self.root / mutant.path)
        shutil.rmtree(cache)
        return by, ran


def _session(root: Path, log: Path, file: str, cache: Path, lines: Path | None) -> None:
    """Run a file of tests in a process that was just forked."""
    os.setsid()
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    os.chdir(root)
    # The links for type checkers make a package of the copy, before the installed one.
    links = f"{root}/.typing"
    sys.path.insert(0, links)
    sys.dont_write_bytecode = True
    os.environ |= {"PYTHONPATH": links, "HALFSHAFT_CACHE": str(cache), "CC": f"{root.parent}/cc", "PYTHONDONTWRITEBYTECODE": "1"}
    for name in [name for name in sys.modules if name.partition(".")[0] == "halfshaft"]:
        del sys.modules[name]
    if lines:
        os.environ |= {"PYTHONPATH": f"{links}:{root.parent}", "MUTATE_PROGRAM": f"{links}/halfshaft/", "MUTATE_LINES": str(lines)}
        exec(RECORDER, {})
    import pytest

    code = pytest.main(["-q", "--no-header", "-p", "no:cacheprovider", "--hypothesis-seed=0", *([] if lines else ["-x"]), file])
    print(sum(os.times()[:4]), flush=True)
    sys.exit(code)


def hashed(paths: Sequence[Path]) -> str:
    """Return a hash of files' content."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the sample, show each mutant to the tests, and print what was noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=200, help="size of the sample (200)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample (1)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="mutants at a time")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutate", help="folder of what is known; without it all begins anew")
    parser.add_argument("--again", action="store_true", help="try those again that survived")
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="packages to change")
    options = parser.parse_args(arguments)
    options.out = options.out.absolute()
    everything = all_mutants(ROOT, options.folders)
    sample = random.Random(options.seed).sample(everything, min(options.n, len(everything)))
    print(f"{len(sample)} of {len(everything)} changes, seed {options.seed}", flush=True)
    compiled, surveyed, judged = options.out / "compiled", options.out / "survey.json", options.out / "result.json"
    compiled.mkdir(parents=True, exist_ok=True)
    survey: dict[str, Survey] = json.loads(surveyed.read_text()) if surveyed.exists() else {}
    result: dict[str, str | None] = json.loads(judged.read_text()) if judged.exists() else {}
    if options.again:
        result = {mutant: by for mutant, by in result.items() if by != ""}
    noticed: Counter[tuple[str, str]] = Counter()
    alone: dict[Mutant, set[str]] = {}
    writing = Lock()

    def write(path: Path, known: dict[str, Survey] | dict[str, str | None]) -> None:
        with writing:
            path.write_text(json.dumps(known, indent=1 if known is result else None) + "\n")

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(LIBRARIES)
    with tempfile.TemporaryDirectory(dir=options.out) as folder, ThreadPoolExecutor(options.jobs) as pool:
        checkouts: SimpleQueue[Checkout] = SimpleQueue()
        for i in range(options.jobs):
            checkouts.put(Checkout(Path(folder, str(i)), context))

        def look(file: str, made_of: str) -> None:
            if file not in survey or survey[file]["made_of"] != made_of:
                checkout = checkouts.get()
                survey[file] = checkout.survey(file, made_of, compiled)
                checkouts.put(checkout)
                write(surveyed, survey)
                print(f"{survey[file]['seconds']:5.1f} s {file}", flush=True)

        def executing(mutant: Mutant) -> set[str]:
            if not mutant.path.endswith(".py"):
                return set(tests)
            lines = set(statement((ROOT / mutant.path).read_text(encoding="utf-8"), mutant.line))
            return {file for file in tests if not lines.isdisjoint(survey[file]["lines"].get(mutant.path, ()))}

        def show(mutants: Sequence[Mutant], files: Sequence[str]) -> tuple[str, list[str]]:
            checkout = checkouts.get()
            by, ran = checkout.notice(mutants, {file: survey[file]["seconds"] for file in files}, compiled)
            checkouts.put(checkout)
            return by, ran

        def kinds_of(mutant: Mutant) -> tuple[str, str]:
            return mutant.path, mutant.path.rpartition("/")[0]

        def judge(mutant: Mutant, by: str | None, last: str = "") -> None:
            result[str(mutant)] = by
            noticed.update((key, by.partition("::")[0]) for key in kinds_of(mutant) if by)
            write(judged, result)
            count = sum(str(m) in result for m in sample)
            what = "noticed " if by else "SURVIVED" if by == "" else "open    "
            print(f"{count:4} {what} {mutant}   [{by or last}]", flush=True)

        def first(mutant: Mutant) -> None:
            def price(file: str) -> float:
                named = Path(mutant.path).stem in file
                return survey[file]["seconds"] / (1 + 10 * named + sum(noticed[key, file] for key in kinds_of(mutant)))

            files: list[str] = []
            seconds = 0.0
            for file in sorted(executing(mutant), key=price):
                seconds += survey[file]["seconds"]
                if not files or seconds < ALONE:
                    files.append(file)
            by, ran = show([mutant], files)
            alone[mutant] = set(ran)
            judge(mutant, by or (None if executing(mutant) > alone[mutant] else ""), f"{len(ran)} of {len(executing(mutant))} files")

        def together(group: Sequence[Mutant], files: Sequence[str]) -> None:
            by, ran = show(group, files)
            if by and len(group) > 1:
                for half in (group[::2], group[1::2]):
                    together(half, files[len(ran) - 1 :])
            else:
                for mutant in group:
                    judge(mutant, by, f"{len(executing(mutant))} files")

        kinds = (".py", ".c", ".h", ".toml", ".csv")
        helpers = [p for top in (*FOLDERS, "validation", "tests") for p in sorted((ROOT / top).rglob("*")) if p.suffix in kinds]
        helpers = [path for path in helpers if not path.name.startswith("test_") and path != Path(__file__).resolve()]
        tests = [str(file.relative_to(ROOT)) for file in sorted((ROOT / "tests").rglob("test_*.py"))]
        list(pool.map(look, tests, [hashed([*helpers, ROOT / file]) for file in tests]))
        noticed.update((key, (result.get(str(m)) or "").partition("::")[0]) for m in sample for key in kinds_of(m))
        list(pool.map(first, [m for m in sample if str(m) not in result]))
        groups: list[list[Mutant]] = []
        for mutant in sorted(m for m in sample if result[str(m)] is None):
            apart = [g for g in groups if len(g) < GROUP and not any(mutant.path == m.path and mutant.start < m.end for m in g)]
            group = apart[0] if apart else []
            groups += [] if apart else [group]
            group.append(mutant)
        others = [{file for mutant in group for file in executing(mutant) - alone.get(mutant, set())} for group in groups]
        list(pool.map(together, groups, [sorted(files, key=lambda file: survey[file]["seconds"]) for files in others]))
    survivors = sorted(str(m) for m in sample if not result[str(m)])
    print(f"\n{len(sample) - len(survivors)} of {len(sample)} noticed: {1 - len(survivors) / len(sample):.1%}")
    print("\n".join(["survivors:", *survivors] if survivors else []))


if __name__ == "__main__":
    main()
