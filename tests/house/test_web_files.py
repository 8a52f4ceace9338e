"""The files of the web page: those of others as published, small enough, without scripts in the text, and clean for the type checker."""

from __future__ import annotations

import gzip
import importlib.util
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from sources import ROOT

PAGE = ROOT / "clients/web"
OWN = sorted(path for path in PAGE.rglob("*.js") if "vendor" not in path.parts)
LARGEST = 700_000
"""Bytes of all that a browser may load, by gzip."""
NPM = ("typescript@7.0.2", "@types/three@0.187.0", "uplot@1.6.32")


@pytest.fixture(scope="module")
def vendoring() -> ModuleType:
    spec = importlib.util.spec_from_file_location("vendor_web", ROOT / "tools/vendor_web.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_vendored_files_are_as_published(vendoring: ModuleType) -> None:
    assert vendoring.faults() == []
    for name, (version, _, files) in vendoring.PACKAGES.items():
        assert all((PAGE / "vendor" / f"{name}-{version}" / file).is_file() for file in files)


def test_a_changed_missing_or_strange_vendored_file_is_told(vendoring: ModuleType, tmp_path: Path) -> None:
    folder = tmp_path / "uplot-1.6.32"
    shutil.copytree(PAGE / "vendor/uplot-1.6.32", folder)
    (folder / "dist/uPlot.esm.js").write_text("other")
    (folder / "LICENSE").unlink()
    (folder / "more.js").write_text("")
    said = vendoring.faults(tmp_path)
    assert said == [
        "uplot-1.6.32/more.js: not in VENDOR.toml",
        "uplot-1.6.32/LICENSE: missing",
        "uplot-1.6.32/dist/uPlot.esm.js: not the published bytes",
    ]


def test_the_page_is_small() -> None:
    loaded = [path for path in PAGE.rglob("*") if path.suffix in (".js", ".css", ".html", ".svg")]
    assert sum(len(gzip.compress(path.read_bytes(), 9)) for path in loaded) < LARGEST
    assert {
        str(path.relative_to(PAGE)): lines for path in OWN if (lines := len(path.read_text().splitlines())) > 400
    } == {}


def test_no_script_stands_in_the_text_and_no_text_becomes_markup() -> None:
    index = (PAGE / "index.html").read_text()
    inline = re.findall(r"<script(?![^>]*\bsrc=)([^>]*)>", index)
    assert inline == [' type="importmap"']
    assert not re.search(r"\son\w+=|javascript:", index)
    for path in OWN:
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function", path.read_text()
        ), path


def test_imports_lead_to_files() -> None:
    names = json.loads(re.findall(r'<script type="importmap">(.*?)</script>', (PAGE / "index.html").read_text())[0])[
        "imports"
    ]
    for path in OWN:
        for name in re.findall(r'(?:from|import) "([^"]+)"|import\("([^"]+\.js)"\)', path.read_text()):
            found = name[0] or name[1]
            prefix = next((key for key in names if found == key or (key.endswith("/") and found.startswith(key))), None)
            target = path.parent / found if prefix is None else PAGE / (names[prefix] + found.removeprefix(prefix))
            assert target.is_file(), (path, found)


def test_modules_are_asked_for_at_once() -> None:
    """Else a browser finds them one behind the other, in as many journeys as imports are deep."""
    index = (PAGE / "index.html").read_text()
    preloaded = set(re.findall(r'<link rel="modulepreload" href="([^"]+)">', index))
    assert {str(path.relative_to(PAGE)) for path in OWN} - preloaded == {"main.js"}
    assert {Path(path).name for path in preloaded if path.startswith("vendor/")} == {
        "uPlot.esm.js",
        "three.module.js",
        "three.core.js",
        "OrbitControls.js",
    }
    assert all((PAGE / path).is_file() for path in preloaded)


@pytest.mark.slow
def test_types_are_clean(tmp_path: Path) -> None:
    """By TypeScript of npm, in a folder outside the tree; UWSERVER_NODE_MODULES names one that is there already."""
    modules = Path(os.environ.get("UWSERVER_NODE_MODULES", tmp_path / "node_modules"))
    if not modules.is_dir():
        npm = shutil.which("npm")
        if npm is None:
            pytest.skip("no npm is installed")
        command = [npm, "install", "--prefix", str(tmp_path), "--no-audit", "--no-fund", "--ignore-scripts", *NPM]
        if subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=300).returncode:
            pytest.skip("npm cannot install TypeScript here")
    types = modules / "@types/three"
    paths = {
        "three": [str(types)],
        "three/addons/*": [f"{types}/examples/jsm/*"],
        "uplot": [f"{modules}/uplot/dist/uPlot.d.ts"],
    }
    own = json.loads((PAGE / "tsconfig.json").read_text())
    include = [str(PAGE / part) for part in own["include"]]
    config = {"extends": str(PAGE / "tsconfig.json"), "compilerOptions": {"paths": paths}, "include": include}
    (tmp_path / "tsconfig.json").write_text(json.dumps(config))
    command = [str(modules / ".bin/tsc"), "-p", str(tmp_path / "tsconfig.json")]
    checked = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert checked.returncode == 0, checked.stdout
