"""The changes that `mutate` makes, and that it shows each to the tests that execute it."""

import ast
import json
import random
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from halfshaft.validation import mutate
from halfshaft.validation.mutate import ROOT, all_mutants, c_mutants, python_mutants, statement


def changed(source: str, make: Callable[[str, str], Iterable[mutate.Mutant]]) -> set[str]:
    return {source[: m.start] + m.text + source[m.end :] for m in make("file", source)}


def test_each_kind_of_change_is_made() -> None:
    source = "def f(x: int | None = 0):\n    if x < 2 and not x:\n        return -x + g(x)\n    send(x)\n"
    assert changed(source, python_mutants) == {
        source.replace("= 0", "= 1"),
        source.replace("<", ">="),
        source.replace("2", "(2 * 2)"),
        source.replace("and", "or"),
        source.replace("not x", "x"),
        source.replace("x < 2 and not x", "not (x < 2 and not x)"),
        source.replace("-x", "x"),
        source.replace("+", "-"),
        source.replace("-x + g(x)", "-x"),
        source.replace("send(x)", "pass"),
    }


def test_c_is_changed_outside_of_comments_texts_and_directives() -> None:
    source = '#define N 3\n/* a < b */ if (a < b && p->x) s += "1 < 2"[0]; // c - d\n'
    assert changed(source, c_mutants) == {
        source.replace("(a < b", "(a >= b"),
        source.replace("&&", "||"),
        source.replace("+=", "-="),
        source.replace("[0]", "[1]"),
    }


def test_changed_programs_are_programs() -> None:
    mutants = [m for m in all_mutants(ROOT) if m.path.endswith(".py")]
    assert len(mutants) > 1000
    for m in random.Random(0).sample(mutants, 90):
        source = (ROOT / m.path).read_text(encoding="utf-8")
        assert ast.dump(ast.parse(source[: m.start] + m.text + source[m.end :])) != ast.dump(ast.parse(source)), str(m)


def test_a_statement_ends_where_its_body_begins() -> None:
    source = "x = (1,\n     2)\nif (x and\n    y):\n    z = 1\nelse:\n    z = 2\n"
    assert [statement(source, line) for line in (1, 2, 4, 5, 7)] == [range(1, 3), range(1, 3), range(3, 5), range(5, 6), range(7, 8)]


PROGRAM = """
def double(x):
    return 2 * x

def unsung(x):
    return not x

def opposite(x):
    return -x

def contrary(x):
    return not x
"""
TESTS = {
    "tests/test_double.py": "from halfshaft.library.sums import double\n\ndef test_double():\n    assert double(3) == 6\n",
    "tests/test_opposite.py": """import subprocess, sys

def test_opposite():
    subprocess.run([sys.executable, "-c", "from halfshaft.library.sums import *; opposite(1); contrary(1)"], check=True)
""",
}


def test_a_change_is_shown_to_the_tests_that_execute_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "root"
    for path, text in {"library/sums.py": PROGRAM, ".typing/halfshaft/__init__.py": "", "pyproject.toml": "", **TESTS}.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    (root / ".typing/halfshaft/library").symlink_to("../../library")
    monkeypatch.setattr(mutate, "ROOT", root)
    monkeypatch.setattr(mutate, "LIBRARIES", ["pytest"])
    options = ["--jobs", "1", "--out", str(tmp_path / "out"), "library"]
    mutate.main(options)
    out = capfd.readouterr().out
    assert "noticed  library/sums.py:3:12: 2 -> (2 * 2)   [tests/test_double.py::test_double]" in out
    assert "SURVIVED library/sums.py:6:12: not x -> x   [0 of 0 files]" in out
    assert "SURVIVED library/sums.py:9:12: -x -> x   [1 of 1 files]" in out
    assert "SURVIVED library/sums.py:12:12: not x -> x   [1 of 1 files]" in out
    assert "1 of 4 noticed: 25.0%" in out
    known = tmp_path / "out" / "survey.json"
    survey = json.loads(known.read_text())
    assert survey["tests/test_opposite.py"]["lines"] == {"__init__.py": [0], "library/sums.py": [0, 2, 5, 8, 9, 11, 12]}

    # What is known is not tried again, unless it is wished for.  Here a dear test looks at two, which are shown to it together first.
    (root / "tests/test_seen.py").write_text("""from halfshaft.library.sums import contrary, opposite

def test_seen():
    assert contrary(0)
    assert opposite(1) == -1
""")
    mutate.main(options)
    assert "SURVIVED" not in capfd.readouterr().out.partition("survivors")[0]
    survey = json.loads(known.read_text())
    survey["tests/test_seen.py"]["seconds"] = 100
    known.write_text(json.dumps(survey))
    mutate.main([*options, "--again"])
    out = capfd.readouterr().out
    for place in ("9:12: -x -> x", "12:12: not x -> x"):
        assert f"open     library/sums.py:{place}   [1 of 2 files]" in out
        assert f"noticed  library/sums.py:{place}   [tests/test_seen.py::test_seen]" in out
    assert "3 of 4 noticed: 75.0%" in out
