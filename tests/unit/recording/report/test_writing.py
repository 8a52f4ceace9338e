"""Reports as files, by the command line too. Also of uwserver.recording.report.drawing."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.unit.recording.report.conftest import HOSTILE
from uwserver.cli.recordings.plot import plot
from uwserver.ports import Event
from uwserver.recording.report import writing
from uwserver.recording.report.contents import Contents, VehicleSummary
from uwserver.recording.report.writing import page


def test_a_page_and_pictures(run: Path, contents: Contents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of lines, of lines with a band and of pictures one panel each: there are dozens."""
    from matplotlib.image import imread

    kinds = {(panel.picture is None, panel.band): panel for panel in contents.panels}
    assert kinds.keys() == {(True, True), (True, False), (False, False)}
    fewer = replace(contents, panels=tuple(kinds.values()))
    monkeypatch.setattr(writing, "report_of", lambda path, vehicles: fewer)
    file = tmp_path / "out.html"
    done = CliRunner().invoke(plot, [str(run), "-o", str(file), "--png", "--pdf"])
    assert done.exit_code == 0, done.output
    assert file.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert imread(file.with_suffix(".png")).shape[1] == 880
    assert file.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".html", ".pdf", ".png"]


def test_the_name_is_that_of_the_recording(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "dive.mcap"
    copy.write_bytes(run.read_bytes())
    done = CliRunner().invoke(plot, ["report", str(copy), "--vehicle", "other"])
    assert done.exit_code == 0, done.output
    assert f"wrote {tmp_path / 'dive.html'}" in done.output


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nothing.mcap"], "nothing.mcap: No such file"),
        (["x.mcap", "--vehicle", "rovv"], 'no vehicle "rovv"'),
        (["x.mcap", "-o", "x.mcap"], "would be overwritten"),
        (["x.mcap", "-o", "/dev/null/x.html"], "/dev/null: "),
    ],
)
def test_what_cannot_be_done_is_told(run: Path, arguments: list[str], told: str) -> None:
    given = [str(run) if argument == "x.mcap" else argument for argument in arguments]
    before = run.read_bytes()
    done = CliRunner().invoke(plot, given)
    assert done.exit_code == 1
    assert told in done.output
    assert "Traceback" not in done.output
    assert run.read_bytes() == before


def test_the_folder_is_made(run: Path, tmp_path: Path) -> None:
    file = tmp_path / "results" / "today" / "x.html"
    done = CliRunner().invoke(plot, [str(run), "-o", str(file), "--vehicle", "other"])
    assert done.exit_code == 0, done.output
    assert file.is_file()


def test_an_empty_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"")
    done = CliRunner().invoke(plot, [str(tmp_path / "x.mcap")])
    assert done.exit_code == 1
    assert "a recording is needed, and this is an empty file" in done.output
    assert not done.output.rstrip().endswith(":")


def test_a_failed_write_leaves_what_was_there(
    contents: Contents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "old.html"
    file.write_text("old")

    def full(path: Path, *_: object, **__: object) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        writing.write_page(contents, file)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


class Elements(HTMLParser):
    """What a browser would make of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None], str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs), ""))

    def handle_data(self, data: str) -> None:
        if not self.found:
            return
        tag, attributes, text = self.found[-1]
        self.found[-1] = (tag, attributes, text + data)

    def handle_endtag(self, tag: str) -> None:
        self.found.append(("", {}, ""))  # what follows is in no element that matters

    def texts(self, tag: str) -> list[str]:
        return [text for name, _, text in self.found if name == tag]


@pytest.fixture(scope="module")
def hostile(contents: Contents) -> Contents:
    panel = contents.panels[0]
    return replace(
        contents,
        events=(*contents.events, Event("fault", 1, 1_000_000_000, HOSTILE)),
        remarks=(HOSTILE,),
        panels=(replace(panel, title=HOSTILE, note=HOSTILE, unit=HOSTILE), *contents.panels[1:]),
        vehicles=(VehicleSummary("rov", HOSTILE, ((HOSTILE, HOSTILE),)), *contents.vehicles[1:]),
    )


def data_of(text: str) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(Elements(text).texts("script")[0])
    return told


def test_text_of_a_recording_never_becomes_markup(hostile: Contents) -> None:
    text = page(hostile)
    elements = Elements(text)
    assert [tag for tag, _, _ in elements.found if tag] == [
        "html",
        "head",
        "meta",
        "meta",
        "meta",
        "link",
        "title",
        "style",
        "body",
        "script",
        "script",
    ]
    assert "<img" not in text
    assert "\u2028" not in elements.texts("script")[0]
    told = data_of(text)
    assert told["remarks"] == [HOSTILE]
    assert told["panels"][0]["title"] == HOSTILE
    assert [1.0, "fault", HOSTILE] in told["events"]
    assert HOSTILE in elements.texts("title")[0]


def test_only_its_own_script_may_run(hostile: Contents) -> None:
    elements = Elements(page(hostile))
    policy = next(
        a["content"]
        for tag, a, _ in elements.found
        if tag == "meta" and a.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy is not None
    assert policy.startswith("default-src 'none'; ")
    script, style = elements.texts("script")[1], elements.texts("style")[0]
    for name, text in (("script-src", script), ("style-src", style)):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{name} 'sha256-{digest}'" in policy


def test_nothing_is_fetched(hostile: Contents) -> None:
    for tag, attributes, _ in Elements(page(hostile)).found:
        assert "src" not in attributes, tag
        assert attributes.get("href", "data:,") == "data:,"
    assert not re.search(r"@import|url\(", Elements(page(hostile)).texts("style")[0])


def test_numbers_come_back(contents: Contents) -> None:
    told = data_of(page(contents))
    depth = next(p for p in told["panels"] if p["title"] == "Depth" and p["vehicle"] == "rov")
    table, mine = depth["tables"][0], contents.panels[0].tables[0]
    np.testing.assert_allclose(np.frombuffer(base64.b64decode(table["t"]), "<f4"), mine.t, rtol=1e-6)
    np.testing.assert_allclose(
        np.frombuffer(base64.b64decode(table["lines"][0]["y"]), "<f4"), mine.lines[0].y, rtol=1e-6
    )
    assert {error["path"] for error in told["errors"]} >= {"rov/imu_exact", "rov/gps_noisy"}
    assert told["map"]["picture"]["png"].startswith("data:image/png;base64,")
