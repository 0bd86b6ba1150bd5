"""The tutorial runs, the commands in the documents exist, and so do the pages."""

import os
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
import typer.main

from halfshaft.app.cli import app
from halfshaft.library.files.catalog import component_kinds

ROOT = Path(__file__).parents[1]
COMMANDS = typer.main.get_command(app).commands
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"`(halfshaft [^`]*)`")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)")


def blocks(page, language):
    """Return the code blocks of a page in a language, each with empty lines before it so that errors name its lines."""
    text = page.read_text(encoding="utf-8")
    return ["\n" * (text[: m.start(2)].count("\n")) + m[2] for m in BLOCK.finditer(text) if m[1] == language]


def commands(page):
    """Return the command lines of halfshaft on a page: lines of shell blocks, and quoted ones with arguments."""
    lines = [line.strip() for block in blocks(page, "sh") for line in block.splitlines()]
    lines += COMMAND.findall(BLOCK.sub("", page.read_text(encoding="utf-8")))
    return [line for line in lines if re.match(r"halfshaft [a-z]", line)]


def anchor(heading):
    """Return the anchor that a heading gets."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading.strip().lower()))


PROGRAMS = {
    "tutorial": 11,
    "cycles": 3,
    "compare": 3,
    "sweeps": 5,
    "uncertainty": 4,
    "autosize": 5,
    "calibration": 6,
    "tests": 5,
    "gradients": 3,
    "optimal": 2,
    "smooth": 2,
}


@pytest.mark.parametrize(("name", "least"), PROGRAMS.items())
def test_page_runs_from_top_to_bottom(name, least, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = DOCS / f"{name}.md"
    space = {"__name__": name}
    found = blocks(page, "python")
    assert len(found) >= least
    for block in found:
        exec(compile(block, str(page), "exec"), space)


def test_example_of_the_readme_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = blocks(ROOT / "README.md", "python")
    space = {"__name__": "readme"}
    exec(compile(example, "README.md", "exec"), space)
    assert space["result"].summary["distance_m"] > 0
    assert (tmp_path / "car.fmu").stat().st_size > 0


@pytest.mark.parametrize(("page", "line"), [pytest.param(p, line, id=f"{p.stem}: {line}") for p in PAGES for line in commands(p)])
def test_command_exists_with_its_options(page, line):
    name, *arguments = shlex.split(line, comments=True)[1:]
    assert name in COMMANDS, f"{page.name} names a command that does not exist: {line}"
    options = {o for parameter in COMMANDS[name].params for o in (*parameter.opts, *parameter.secondary_opts)} | {"-h", "--help"}
    used = {a.partition("=")[0] for a in arguments if re.match(r"--?[a-z]", a)}
    assert used <= options, f"{page.name}: {line}"


def test_every_command_is_described():
    # The larger commands have a page of their own.
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for name, command in COMMANDS.items():
        assert f"halfshaft {name}" in text
        for parameter in command.params:
            long = [o for o in parameter.opts if o.startswith("--")]
            assert not long or f"`{long[0]}" in text, f"{name} {long[0]}"


def test_targets_named_are_those_of_the_makefile():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    named = {t for page in PAGES for t in re.findall(r"(?:^|`)make ([a-z]+)", page.read_text(encoding="utf-8"), re.MULTILINE)}
    assert {"demo", "test"} <= named <= targets


def test_navigation_has_every_page():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("nav:")[2]
    assert sorted(re.findall(r": (\S+\.md)$", nav, re.MULTILINE)) == sorted(p.name for p in DOCS.glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    for target, place in LINK.findall(text):
        goal = page.parent / target if target else page
        assert goal.exists(), f"{page.name} links to {target}"
        if place:
            headings = re.findall(r"^#+ (.*)$", BLOCK.sub("", goal.read_text(encoding="utf-8")), re.MULTILINE)
            assert place in {anchor(h) for h in headings}, f"{page.name} links to {target}#{place}"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the manual; a link or a name that leads nowhere fails."""
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(target)]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "MANUAL_DRAFT": "1"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return target


def test_the_manual_asks_nothing_of_the_network(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r'<(?:script|link|img|iframe)[^>]*(?:src|href)="?(?:https?:)?//[^>]*>', text), page.name
    for sheet in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import\s+)[\"']?(?:https?:)?//", sheet.read_text(encoding="utf-8")), sheet.name
    # The search starts its worker from a file too, by a script of ours.
    assert "iframe-worker.js" in (site / "components" / "motor.html").read_text(encoding="utf-8")
    assert "overtorque" in (site / "search" / "search_index.js").read_text(encoding="utf-8")


def test_the_manual_documents_every_kind_of_component(site):
    for kind, cls in component_kinds().items():
        text = (site / "components" / f"{kind}.html").read_text(encoding="utf-8")
        assert all(f"<code>{f.name}</code>" in text for f in fields(cls.parameters)), kind
        assert all(f"<code>{v.name}</code>" in text for v in cls.variables), kind


def test_the_manual_has_formulas_pictures_and_the_reference(site):
    index = (site / "index.html").read_text(encoding="utf-8")
    assert "<math" in index
    assert "arithmatex" not in index
    for page in site.rglob("*.html"):
        for picture in re.findall(r'<img[^>]* src="([^"]+\.png)"', page.read_text(encoding="utf-8")):
            assert (page.parent / picture).exists(), picture
    named = {name for page in DOCS.glob("*.md") for name in re.findall(r"<!-- picture: (\S+) -->", page.read_text(encoding="utf-8"))}
    assert {picture.stem for picture in site.glob("pictures/*.png")} == named != set()
    reference = (site / "reference.html").read_text(encoding="utf-8")
    assert 'id="halfshaft.cosim.simulate.run"' in reference
    assert "Length of the step" in reference
