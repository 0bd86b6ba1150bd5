"""Changes single places of the program and runs the tests: a change that no test notices shows what the tests do not hold.

``make mutate`` draws a sample of changes with a fixed seed from the Python and C of the packages, a swapped operator, a dropped
term, another number, a branch taken the other way, and runs the tests for each in a copy of the checkout.  The sample spreads over
the packages by their numbers of places.  It takes hours, so it is no part of the suite.  mutmut and cosmic-ray were considered: neither
changes C, and neither finds packages whose folders have other names.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("library", "models", "fmu_build", "cosim", "studies", "app")
#: A mutant whose tests take longer than this hangs, which is noticed [s].
PATIENCE = 900

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
    start: int
    end: int
    text: str
    was: str

    def __str__(self) -> str:
        """Return place and change on one line."""
        return f"{self.path}:{self.line}: {' '.join(self.was.split())} -> {' '.join(self.text.split()) or 'nothing'}"


def python_mutants(path: str, source: str) -> Iterator[Mutant]:
    """Yield the changes of a Python file, apart from texts, annotations and imports."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    data = source.encode()

    def place(line: int, column: int) -> int:
        return len(data[: starts[line - 1] + column].decode())

    def change(node: ast.expr | ast.stmt, start: int, end: int, text: str) -> Mutant:
        return Mutant(path, node.lineno, start, end, text, source[start:end])

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
            yield Mutant(path, source.count("\n", 0, found.start()) + 1, found.start(), found.end(), other, token)


def all_mutants(root: Path, folders: Sequence[str] = FOLDERS) -> list[Mutant]:
    """Return every change of the program's files, in the order of the files."""
    found: list[Mutant] = []
    for folder in folders:
        for path in sorted((root / folder).rglob("*")):
            make = {".py": python_mutants, ".c": c_mutants, ".h": c_mutants}.get(path.suffix)
            if make:
                found += make(str(path.relative_to(root)), path.read_text(encoding="utf-8"))
    return found


def notice(mutant: Mutant, copy: Path, cache: Path) -> str:
    """Return the first test that notices a change in a copy of the checkout; empty if none does."""
    path = copy / mutant.path
    source = path.read_text(encoding="utf-8")
    path.write_text(source[: mutant.start] + mutant.text + source[mutant.end :], encoding="utf-8")
    # The links for type checkers make a package of the copy, before the installed one.
    environment = {**os.environ, "PYTHONPATH": str(copy / ".typing"), "HALFSHAFT_CACHE": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    # Those that are likely to notice come first: the package's own, and the vehicles by hand.
    likely = (f"tests/{mutant.path.split('/')[0]}", "tests/models")
    first = [folder for folder in dict.fromkeys(likely) if (copy / folder).is_dir()]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", "-p", "no:randomly", *first, "tests"]
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        return "too slow"
    finally:
        path.write_text(source, encoding="utf-8")
    if done.returncode == 0:
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.M)
    return failed[1] if failed else f"pytest ended with {done.returncode}"


def main() -> None:
    """Draw the sample, run the tests for each mutant, and print what was noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=200, help="size of the sample (200)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample (1)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="mutants at a time")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutants.json", help="where the result goes")
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="packages to change")
    options = parser.parse_args()
    everything = all_mutants(ROOT, options.folders)
    sample = random.Random(options.seed).sample(everything, min(options.n, len(everything)))
    print(f"{len(sample)} of {len(everything)} changes, seed {options.seed}", flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    result: dict[str, str] = {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(options.jobs) as pool:
        copies: SimpleQueue[Path] = SimpleQueue()
        for i in range(options.jobs):
            copy = Path(folder, f"copy-{i}")
            ignored = shutil.ignore_patterns(".venv", ".git", "build", "__pycache__", ".*_cache", ".hypothesis")
            shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
            copies.put(copy)

        def tried(mutant: Mutant) -> None:
            copy = copies.get()
            try:
                by = notice(mutant, copy, copy / "cache")
            finally:
                copies.put(copy)
            result[str(mutant)] = by
            print(f"{len(result):4} {'noticed ' if by else 'SURVIVED'} {mutant}{f'   [{by}]' if by else ''}", flush=True)
            options.out.write_text(json.dumps(result, indent=1) + "\n")

        list(pool.map(tried, sample))
    survivors = sorted(m for m, by in result.items() if not by)
    print(f"\n{len(result) - len(survivors)} of {len(result)} noticed: {1 - len(survivors) / len(result):.1%}")
    print("\n".join(["survivors:", *survivors] if survivors else []))


if __name__ == "__main__":
    main()
