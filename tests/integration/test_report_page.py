"""The report in a real browser, from its file: it draws, zooms and changes its theme, and what a recording says never runs."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator

import numpy as np
import pytest
from chromium_rig import chromium_or_skip
from nursery import python

from uwserver.cli.browser.chromium import Page, browsing

TITLE = "</script><script>report.errors.push(1)</script><img src=x onerror='report.errors.push(2)'>"
SCENARIO = f"""
schema = 1
title = "{TITLE}"
[seabed]
kind = "grid"
file = "floor.npy"
spacing_m = [4.0, 4.0]
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0, 0, 4]
velocity_frd_mps = [1.0, 0.0, 0.0]
[vehicles.rov.truth]
rate_hz = 20
[vehicles.rov.sensors.sonar]
kind = "scanning_sonar"
rate_hz = 30
range_m = 15
bins = 60
[vehicles.rov.sensors.noisy]
kind = "pressure"
output = "depth"
rate_hz = 20
[vehicles.rov.sensors.noisy.modifiers.noise]
kind = "white_noise"
field = "depth"
sigma = 0.02
[vehicles.other]
model = "bluerov2"
position_ned_m = [8, 5, 3]
[faults.lame]
kind = "thruster_weak"
target = "rov/thrusters"
members = ["t2"]
factor = 0.5
at_s = 2
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    program, folder = chromium_or_skip(), tmp_path_factory.mktemp("report")
    (folder / "x.toml").write_text(SCENARIO)
    np.save(folder / "floor.npy", 10.0 + 0.1 * np.arange(900.0).reshape(30, 30) / 30.0)
    for command in (["run", "x.toml", "--mode", "freerun", "--until", "4", "--record", "x.mcap"], ["plot", "x.mcap"]):
        done = subprocess.run(
            [python(), "-m", "uwserver", *command], cwd=folder, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
    # Alone in its folder: nothing beside it is needed.
    alone = folder / "alone"
    alone.mkdir()
    shutil.move(folder / "x.html", alone / "report.html")
    with browsing(program, tmp_path_factory.mktemp("profile")) as browser:
        found = browser.open(f"file://{alone / 'report.html'}", size=(1200, 900))
        found.wait("window.report && document.readyState === 'complete'")
        yield found
        assert found.faults == []
        assert found.ask("report.errors") == []


def show(page: Page, group: str) -> None:
    """Scroll to a group of plots, until they are drawn."""
    page.ask(f"[...document.querySelectorAll('h2')].find((h) => h.textContent === '{group}').scrollIntoView()")
    page.wait("[...document.querySelectorAll('.plot')].filter((b) => b.getBoundingClientRect().top < 500"
              " && b.getBoundingClientRect().bottom > 0).every((b) => report.plots.has(b))")  # fmt: skip


def press(page: Page, name: str) -> None:
    page.ask(f"[...document.querySelectorAll('header button')].find((b) => b.textContent === '{name}').click()")


def test_texts_are_texts(page: Page) -> None:
    assert page.ask("document.title").startswith(TITLE)
    assert page.ask("document.querySelector('h1').textContent").startswith(TITLE)
    assert page.ask("document.querySelectorAll('img, script').length") == 2  # the data and its own script


def test_tracks_lie_over_the_floor(page: Page) -> None:
    page.ask("scrollTo(0, 0)")
    page.wait("report.data.map.picture && document.querySelector('canvas.map').width > 100")
    colours = page.ask(
        "(() => { const c = document.querySelector('canvas.map'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        " const seen = new Set(); for (let i = 0; i < d.length; i += 4) seen.add(d[i] * 65536 + d[i + 1] * 256 + d[i + 2]);"
        " return [seen.size, seen.has(0x0b6e99)]; })()"
    )
    assert colours[0] > 50  # the floor is shaded
    assert colours[1]  # the first vehicle's track


def test_a_drag_zooms_all_plots_and_a_button_goes_back(page: Page) -> None:
    press(page, "Whole run")
    show(page, "rov: Motion")
    x, y, w, h = page.ask(
        "(() => { const r = [...report.plots.values()].map((p) => p.over.getBoundingClientRect()).find((r) => r.top > 60);"
        " return [r.left, r.top, r.width, r.height]; })()"
    )
    for kind, part, buttons in (
        ("mouseMoved", 0.25, 0),
        ("mousePressed", 0.25, 1),
        ("mouseMoved", 0.75, 1),
        ("mouseReleased", 0.75, 0),
    ):
        button = "none" if kind == "mouseMoved" and not buttons else "left"
        page.say(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x + part * w,
            y=y + h / 2,
            button=button,
            buttons=buttons,
            clickCount=1,
        )
    page.wait("report.state.begin > 0.5")
    begin, end = page.ask("[report.state.begin, report.state.end]")
    assert begin == pytest.approx(1.0, abs=0.05)
    assert end == pytest.approx(3.0, abs=0.05)
    # A plot sets its scale with the next microtask.
    page.wait(
        "[...report.plots.values()].every((p) => p.scales.x.min === report.state.begin && p.scales.x.max === report.state.end)"
    )
    page.say("Input.dispatchMouseEvent", type="mouseMoved", x=x + 0.5 * w, y=y + h / 2, button="none")
    page.wait(
        "document.getElementById('status').textContent.startsWith('t = 2.0') || document.getElementById('status').textContent.startsWith('t = 1.9')"
    )
    assert "fault" in page.ask("document.getElementById('status').textContent")
    press(page, "Whole run")
    assert page.ask("report.state.begin") == 0


def test_sonar_and_errors_are_drawn(page: Page) -> None:
    show(page, "rov: Sonar")
    page.wait("[...report.plots].some(([box, plot]) => box.panel.picture && plot.bbox.width > 100)")
    show(page, "rov: Errors against the truth")
    notes = page.ask("[...document.querySelectorAll('.note')].map((n) => n.textContent)")
    assert any("within 3 sigma" in note for note in notes)


def test_both_themes_and_one_vehicle_alone(page: Page) -> None:
    before = page.ask("document.documentElement.dataset.theme")
    press(page, "Light or dark")
    after = page.ask("document.documentElement.dataset.theme")
    assert {before, after} == {"light", "dark"}
    press(page, "other")
    assert page.ask("[...document.querySelectorAll('[data-vehicle=other]')].every((n) => n.hidden)")
    assert page.ask("[...document.querySelectorAll('[data-vehicle=rov]')].some((n) => !n.hidden)")
    press(page, "other")
    press(page, "Light or dark")
