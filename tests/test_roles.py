"""Nothing above the library looks for a part by what a powertrain calls it."""

import ast
import re
from pathlib import Path
from typing import get_args

import pytest

from halfshaft.library.base.tags import Tag
from halfshaft.models.powertrain import powertrains

ROOT = Path(__file__).parents[1]
ROLES = sorted({role for powertrain in powertrains().values() for role in powertrain.roles})
SPELT = re.compile(rf"({'|'.join(ROLES)})(\.\w*)?")
#: Powertrains give the names.  Older results have no tags.
EXEMPT = {"models/powertrains", "cosim/older.py"}
#: ``wheel`` is also a side of a port, a rule has its own names for the parts that it looks at, a tag may be a role's word; and options of
#: tests say which kind of source rests (``resting``), or what ends a depleting test (``until``).
OTHER = {("models/model.py", "wheel"), ("models/wiring.py", "wheel"), *(("models/rules.py", role) for role in ROLES)}
OTHER |= {
    (path, word)
    for path in ("studies/acceleration.py", "studies/conditions.py", "studies/gradeability.py", "app/commands/test.py")
    for word in ("battery", "converter")
} | {("studies/procedure.py", "engine"), ("studies/procedure_file.py", "engine")}
FILES = [
    path.relative_to(ROOT)
    for folder in ("models", "fmu_build", "cosim", "studies", "app", "src")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in (".py", ".c", ".h") and not EXEMPT & {str(p) for p in (path.relative_to(ROOT), *path.relative_to(ROOT).parents)}
]


def texts(source, suffix):
    """Yield all texts of a source, those in the pieces of an f-string too."""
    if suffix != ".py":
        yield from re.findall(r'"([^"\n]*)"', source)
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def spelt(source, suffix=".py"):
    return [text for text in texts(source, suffix) if SPELT.fullmatch(text)]


@pytest.mark.parametrize("path", FILES, ids=str)
def test_no_role_is_spelt_above_the_library(path):
    found = [text for text in spelt((ROOT / path).read_text(), path.suffix) if (str(path), text) not in OTHER and text not in get_args(Tag)]
    assert not found, f"{path} looks for {', '.join(found)}; ask for a tag (halfshaft.library.base.tags)"


@pytest.mark.parametrize(
    "source", ['result["battery.soc"]', 'parts.get("engine")', 'f"motor.{name}"', "n.startswith('wheel.F_brake')"]
)  # fmt: skip
def test_the_search_finds_what_it_is_for(source):
    assert spelt(source)


def test_a_role_in_a_sentence_is_none():
    assert not spelt('"--set: must be NAME=VALUE, such as body.m=1500"')
    assert spelt('name = "body.v";', ".c") == ["body.v"]
