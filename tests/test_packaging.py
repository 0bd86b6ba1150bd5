"""What is installed is what lies in the folders, and imports go one way."""

import ast
import tomllib
from importlib.util import resolve_name
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
TOPS = {name: ROOT / folder for name, folder in SETUPTOOLS["package-dir"].items()}
#: The folder of each package; those below the tops lie where their names say.
FOLDERS = {name: TOPS.get(name) or TOPS[".".join(name.split(".")[:2])].joinpath(*name.split(".")[2:]) for name in SETUPTOOLS["packages"]}

#: Lowest first: each may import itself and those before it.
ORDER = ("library", "models", "fmu_build", "cosim", "studies", "validation", "app")


def package_of(file):
    """Return the folder of the package that a file belongs to: the nearest one above with an ``__init__.py``."""
    return next(folder for folder in file.parents if (folder / "__init__.py").is_file() or folder == ROOT)


def files(folder):
    """Return all files under a folder that belong to the package there."""
    found = (f for f in folder.rglob("*") if f.is_file() and "__pycache__" not in f.parts)
    return {f for f in found if package_of(f) == folder}


def imported(tree, package):
    """Yield the full name and the line of every import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((a.name, node.lineno) for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module
            yield from ((f"{source}.{a.name}", node.lineno) for a in node.names)


def against_the_order(code, path):
    """Return the imports in a file, given by its text and its place, that the order of the packages forbids."""
    home = path.split("/")[0]
    bad = []
    for name, line in imported(ast.parse(code), f"halfshaft.{home}"):
        parts = name.split(".")
        if parts[0] != "halfshaft":
            continue
        target = parts[1] if len(parts) > 1 else ""
        if target not in (*ORDER[: ORDER.index(home) + 1], "__version__"):
            bad.append(f"{path}:{line}: {home} imports {name}")
    return bad


def test_every_package_is_installed():
    tops = [ROOT / "src", *(f for f in ROOT.iterdir() if f.is_dir() and f.name not in {"src", "tests", "build", "dist"})]
    found = {init.parent for top in tops if not top.name.startswith(".") for init in top.rglob("__init__.py")}
    assert set(FOLDERS.values()) == found
    assert list(TOPS) == [name for name in FOLDERS if name.count(".") < 2]


def test_packages_are_named_as_their_folders():
    for name, folder in FOLDERS.items():
        start = ROOT / "src" if name == "halfshaft" else ROOT
        assert folder.relative_to(start).parts == tuple(name.split("."))[-len(folder.relative_to(start).parts) :]


def test_links_for_type_checkers_lead_to_the_packages():
    links = ROOT / ".typing" / "halfshaft"
    expected = {FOLDERS["halfshaft"] / name for name in ("__init__.py", "__main__.py", "py.typed")} | {
        FOLDERS[f"halfshaft.{name}"] for name in ORDER
    }
    assert {link.resolve() for link in links.iterdir()} == expected


@pytest.mark.parametrize("package", FOLDERS)
def test_every_data_file_is_installed(package):
    folder = FOLDERS[package]
    data = {f for f in files(folder) if f.suffix != ".py"}
    covered = {f for pattern in SETUPTOOLS["package-data"]["*"] for f in folder.glob(pattern)}
    assert package.count(".") > 1 or folder / "py.typed" in data
    assert sorted(map(str, data - covered)) == []


@pytest.mark.parametrize("package", FOLDERS)
def test_every_module_lies_in_a_package(package):
    folder = FOLDERS[package]
    assert sorted(str(f) for f in files(folder) if f.suffix == ".py" and f.parent != folder) == []


@pytest.mark.parametrize("package", ORDER)
def test_imports_go_one_way(package):
    modules = FOLDERS[f"halfshaft.{package}"].rglob("*.py")
    assert [bad for m in modules for bad in against_the_order(m.read_text(), m.relative_to(ROOT).as_posix())] == []


@pytest.mark.parametrize(
    ("path", "code", "count"),
    [
        ("library/electric/motor.py", "from halfshaft.models.model import Model", 1),
        ("library/electric/motor.py", "from halfshaft import cosim, library", 1),
        ("library/electric/motor.py", "from ..models import model", 1),
        ("library/electric/motor.py", "from .ports import Shaft", 0),
        ("library/electric/motor.py", "from halfshaft import Vehicle", 1),
        ("models/model.py", "import halfshaft.library.electric.motor, halfshaft.app.cli", 1),
        ("fmu_build/code.py", "def f():\n    from halfshaft.app import cli", 1),
        ("app/cli.py", "from halfshaft.validation import paper", 0),
        ("validation/paper.py", "def f():\n    from halfshaft.app import output", 1),
        ("cosim/run.py", "def f():\n    from halfshaft.validation import paper", 1),
        ("validation/paper.py", "from halfshaft.cosim import run", 0),
    ],
)
def test_a_wrong_import_is_found(path, code, count):
    assert len(against_the_order(code, path)) == count
