"""A package beside halfshaft is installed, and what it brings is there: nothing of halfshaft is edited."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """Install the example package into a folder, and return the environment that sees it."""
    site, source = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("source")
    for path in (HERE / "example").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts and path.suffix in (".py", ".toml"):
            target = source / path.relative_to(HERE / "example")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())
    flags = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check", "--target", str(site)]
    subprocess.run([sys.executable, "-m", "pip", "install", *flags, str(source)], check=True, timeout=120)
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])}


def halfshaft(environment, *arguments):
    command = [sys.executable, "-m", "halfshaft", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)


def test_its_vehicle_runs_from_the_command_line(beside):
    done = halfshaft(beside, "run", "acme-van", "--cycle", "udds", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["trace_miss_max_mps"] < 0.1
    assert summary["energy_from_battery_J"] > 0
    # The shaft drags: the same car without it needs less.
    free = json.loads(halfshaft(beside, "run", "acme-van", "--cycle", "udds", "--json", "--set", "propshaft.tau_loss=0 N.m").stdout)
    assert free["energy_from_battery_J"] < summary["energy_from_battery_J"]


def test_its_component_and_powertrain_are_shown_and_listed(beside):
    assert "Steel shaft with one bearing" in halfshaft(beside, "show", "steel-propshaft").stdout
    assert "acme-van" in halfshaft(beside, "list", "vehicles").stdout


def test_without_it_nothing_is_known_of_it():
    done = halfshaft(dict(os.environ), "run", "acme-van", "--cycle", "udds")
    assert done.returncode != 0
    assert "not in the library" in done.stderr


def test_a_package_that_cannot_be_imported_is_named(beside, tmp_path):
    broken = tmp_path / "acme_broken-1.dist-info"
    broken.mkdir()
    (broken / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-broken\nVersion: 1\n")
    (broken / "entry_points.txt").write_text("[halfshaft.components]\nbroken = acme_broken\n")
    done = halfshaft({**beside, "PYTHONPATH": os.pathsep.join([str(tmp_path), beside["PYTHONPATH"]])}, "list", "components")
    assert done.returncode != 0
    assert "entry point halfshaft.components of acme-broken: No module named 'acme_broken'" in done.stderr + done.stdout
