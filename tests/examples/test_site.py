"""The documentation as a site: pages are parted, and every link and picture leads somewhere."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site() -> ModuleType:
    spec = importlib.util.spec_from_file_location("site_tool", ROOT / "tools/site.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pages(site: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "pages"
    site.stage(ROOT, folder)
    return folder


def anchors(site: ModuleType, page: Path) -> set[str]:
    return {site._slug(title) for title in re.findall(r"^#+ (.*)$", site.FENCE.sub("", page.read_text()), re.M)}


def test_every_link_and_picture_of_the_site_leads_somewhere(site: ModuleType, pages: Path) -> None:
    lost, count = [], 0
    for page in pages.rglob("*.md"):
        for _, target, _ in site.LINK.findall(re.sub(r"`[^`\n]*`", "", site.FENCE.sub("", page.read_text()))):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            found = (page.parent / path).resolve() if path else page
            count += 1
            if not found.is_file() or (anchor and found.suffix == ".md" and anchor not in anchors(site, found)):
                lost.append(f"{page.relative_to(pages)}: {target}")
    assert count > 200
    assert not lost, "\n".join(lost)


def test_long_pages_are_parted_by_subject(site: ModuleType, pages: Path) -> None:
    for path in site.SPLIT:
        whole = (ROOT / path).read_text()
        parts = list((pages / path.removesuffix(".md")).glob("*.md"))
        assert len(parts) == len(re.findall(r"^## ", site.FENCE.sub("", whole), re.M)) > 2
        assert len((pages / path).read_text()) < 0.2 * len(whole)


def test_every_page_is_in_the_navigation_once(site: ModuleType, pages: Path) -> None:
    listed = [page for section in site.navigation(pages) for found in section.values() for page in found]
    assert len(listed) == len(set(listed))
    every = {str(page.relative_to(pages)) for page in pages.rglob("*.md")}
    assert {page for page in every if page.startswith(("docs/", "examples/", "clients/"))} <= set(listed)


def test_the_home_page_begins_with_pictures(pages: Path) -> None:
    assert len(re.findall(r"!\[", "\n".join((pages / "README.md").read_text().splitlines()[:6]))) == 4


def test_the_site_builds_without_a_warning() -> None:
    if importlib.util.find_spec("material") is None:
        pytest.skip("mkdocs-material is not installed: pip install 'uwserver[site]'")
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/site.py")], capture_output=True, text=True, timeout=240, cwd=ROOT
    )
    assert done.returncode == 0, done.stdout + done.stderr
