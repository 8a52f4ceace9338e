"""The page: whatever a recording says stays text, and nothing is fetched."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from tests.unit.recording.report.conftest import HOSTILE
from uwserver.ports import Event
from uwserver.recording.report.contents import Contents
from uwserver.recording.report.page import page
from uwserver.recording.report.summary import VehicleSummary


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
