"""What pages name is there: targets, links, files, rooms. tests/integration/test_pages.py follows what pages say, tools/ write the generated ones."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from click import Context
from sources import ROOT

from uwserver.cli import main

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PAGES = ("README.md", "docs/tutorial.md", "clients/python/README.md")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.S | re.M)
MAKE = re.compile(r"^make (\w[\w-]*)", re.M)


def test_every_make_target_that_is_named_exists():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))
    for page in (*PAGES, "CONTRIBUTING.md"):
        if (ROOT / page).exists():
            named = set(MAKE.findall((ROOT / page).read_text())) | set(
                re.findall(r"`make ([\w-]+)`", (ROOT / page).read_text())
            )
            assert named <= targets, page


def test_every_link_between_pages_leads_somewhere():
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", BLOCK.sub("", page.read_text())):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_every_extra_that_is_named_exists():
    """``pip install 'uwserver[x]'`` takes an x that is none without a word but a warning."""
    extras = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    named: dict[str, str] = {}
    for folder, ends in (
        ("docs", ("md",)),
        ("examples", ("md", "py")),
        ("clients/python", ("md", "py")),
        ("uwserver", ("py",)),
        ("adapters", ("py",)),
    ):
        for path in (path for end in ends for path in (ROOT / folder).rglob(f"*.{end}")):
            named |= _extras(path)
    for page in (*PAGES, "CONTRIBUTING.md"):
        named |= _extras(ROOT / page)
    assert len(named) > 5
    assert not {extra: where for extra, where in named.items() if extra not in extras}


def _extras(path: Path) -> dict[str, str]:
    """Those that a file names, each with its name."""
    found = re.findall(r"uwserver\[([a-z0-9_, -]+)\]", path.read_text(encoding="utf-8"))
    return {extra.strip(): path.name for each in found for extra in each.split(",")}


def test_every_file_that_is_named_is_there():
    """A page that leads through the source has to lead somewhere; a path begins at the top, so that it can be looked up."""
    top = {path.name for path in ROOT.iterdir() if path.is_dir()}
    for page in ("docs/explanation/architecture.md", "docs/explanation/paths.md", "CONTRIBUTING.md"):
        text = (ROOT / page).read_text()
        named = re.findall(r"`([\w.-]+/[\w./-]*|[\w./-]+\.py)`", text)
        assert len(named) > 20, page
        listed = set(re.findall(r"`([\w./-]+\.py)`\.\n```python", text))  # which a newcomer writes
        lost = [
            path
            for path in named
            if path not in listed and (path.split("/")[0] not in top or not (ROOT / path).exists())
        ]
        assert not lost, f"{page}: {lost}"


def test_readme_names_every_command():
    named = re.search(r"`uwserver --help` lists the commands: ([\w, -]+)\.", (ROOT / "README.md").read_text())
    assert named is not None
    assert set(named[1].split(", ")) == set(main.list_commands(Context(main)))


def test_every_room_is_in_the_table_of_rooms():
    text = (ROOT / "docs/explanation/architecture.md").read_text()
    rooms = [path.parent for path in (ROOT / "uwserver").glob("*/__init__.py")]
    assert len(rooms) > 10
    assert not [room.name for room in rooms if f"`uwserver/{room.name}/`" not in text]
    inner = [
        path.parent for path in (ROOT / "uwserver").glob("*/*/__init__.py") if path.parts[-3] in ("scenario", "physics")
    ]
    assert not [room.name for room in inner if f"`{room.name}`" not in text]
