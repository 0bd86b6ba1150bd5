import ast
import random

from halfshaft.validation.mutate import ROOT, all_mutants, c_mutants, python_mutants


def changed(source, make):
    return {source[: m.start] + m.text + source[m.end :] for m in make("file", source)}


def test_each_kind_of_change_is_made():
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


def test_c_is_changed_outside_of_comments_texts_and_directives():
    source = '#define N 3\n/* a < b */ if (a < b && p->x) s += "1 < 2"[0]; // c - d\n'
    assert changed(source, c_mutants) == {
        source.replace("(a < b", "(a >= b"),
        source.replace("&&", "||"),
        source.replace("+=", "-="),
        source.replace("[0]", "[1]"),
    }


def test_changed_programs_are_programs():
    mutants = [m for m in all_mutants(ROOT) if m.path.endswith(".py")]
    assert len(mutants) > 1000
    for m in random.Random(0).sample(mutants, 150):
        source = (ROOT / m.path).read_text(encoding="utf-8")
        assert ast.dump(ast.parse(source[: m.start] + m.text + source[m.end :])) != ast.dump(ast.parse(source)), str(m)
