"""The page of the web view, in a real browser at a real server: what it draws, how it steers, and what it does when things go wrong."""

from __future__ import annotations

import contextlib
import os
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium_rig import chromium_or_skip
from page_rig import PROBES, ready, served

from uwserver.cli.browser.chromium import Browser, Page, browsing
from uwserver.recording.replay import replay

PICTURES = "UWSERVER_PAGE_PICTURES"
"""Variable: the folder where a picture of each test's end is kept."""
TITLE = '<img src=x onerror=\\"uw.errors.push(1)\\"> & <b>pool</b>'
SCENARIO = f"""
schema = 1
title = "{TITLE}"
seed = 4
[world]
rate_hz = 240
[environment.waves]
significant_height_m = 0.3
peak_period_s = 4
components = 20
[seabed]
kind = "flat"
depth_m = 8
[structures.pile]
kind = "cylinder"
radius_m = 0.3
length_m = 8
position_ned_m = [4.0, 3.0, 4.0]
attitude_rpy_deg = [0.0, 90.0, 0.0]
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 2.0]
[vehicles.rov.autopilot]
start_position_ned_m = [0.0, 0.0, 2.0]
[vehicles.rov.sensors.ahrs]
kind = "attitude"
profile = "mems_ahrs"
rate_hz = 40
[vehicles.rov.sensors.altimeter]
kind = "altimeter"
profile = "ping1d"
rate_hz = 10
[vehicles.rov.sensors.dvl]
kind = "dvl"
profile = "a50"
rate_hz = 15
[vehicles.rov.sensors.training]
kind = "training"
rate_hz = 20
collision_points = 0
[vehicles.rov.sensors.training.tasks.away]
kind = "reach"
position_ned_m = [1.4, 0.0, 2.0]
size_m = [2.0, 20.0, 20.0]
[vehicles.auv]
model = "remus100"
position_ned_m = [6.0, -4.0, 3.0]
[adapters.tcp]
kind = "sockets"
port = 0
[adapters.page]
kind = "web"
port = PORT
[server]
metrics_port = 0
"""
GAMEPAD = """
window.axes = [0, 0, 0, 0];
window.pressed = -1;
Object.defineProperty(navigator, "getGamepads", { value: () => [{ id: "test pad", index: 0, connected: true, mapping: "standard",
  axes: window.axes, buttons: Array.from({ length: 17 }, (_, k) => ({ pressed: k === window.pressed, value: 0 })), timestamp: performance.now() }] });
"""
BUSY = """
const real = window.fetch;
window.refused = 0;
window.fetch = async (...given) => {
  if (!String(given[0]).endsWith("world.json") || window.refused >= 2) return real(...given);
  window.refused += 1;
  return new Response("busy", { status: 503 });
};
"""
HELD = """
const real = window.fetch;
window.held = 0;
const go = new Promise((resolve) => { window.release = resolve; });
window.fetch = async (...given) => {
  const answer = await real(...given);
  if (!String(given[0]).startsWith("mesh/")) return answer;
  const data = await answer.arrayBuffer();
  if (data.byteLength > 1e6) {
    window.held += 1;
    await go;
  }
  return new Response(data);
};
"""
NO_GL = """
const real = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) { return kind.startsWith("webgl") ? null : real.call(this, kind, ...rest); };
"""


@contextlib.contextmanager
def server(folder: Path, port: int = 0, scenario: str = SCENARIO) -> Iterator[str]:
    """A server of a scenario; gives the address of its page."""
    file = folder / "dive.toml"
    file.write_text(scenario.replace("PORT", str(port)))
    with served(file, folder) as (address, _):
        yield address


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browsing(chromium_or_skip(), tmp_path_factory.mktemp("profile"), PROBES.read_text()) as found:
        yield found


@pytest.fixture(scope="module")
def address(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with server(tmp_path_factory.mktemp("server")) as found:
        yield found


@pytest.fixture
def opened(browser: Browser, address: str, request: pytest.FixtureRequest) -> Iterator[Page]:
    """A page that shows the world, begun anew; nothing may have gone wrong in it at the end."""
    page = ready(browser.open(f"{address}?fps=4#quality=low", getattr(request, "param", "")))
    breaks = page.ask("uw.app.timeline.breaks")
    page.ask("uw.app.link.call('world/resume').then(() => uw.app.link.call('world/reset'))")
    page.wait(f"uw.app.timeline.breaks > {breaks}", "the world begins anew")
    frames = page.ask("uw.frames")
    page.wait(f"uw.frames > {frames + 2}", "what is shown is of the new run")
    yield page
    kept = os.environ.get(PICTURES)
    if kept:
        Path(kept).mkdir(parents=True, exist_ok=True)
        page.picture(Path(kept) / f"{re.sub(r'[^a-z0-9]+', '_', request.node.name.lower()).strip('_')}.png")
    page.ask("uw.app.link.call('web/stop')")
    assert page.faults == []
    assert page.ask("uw.errors") == []
    page.close()


def test_each_vehicle_is_drawn_where_it_is(opened: Page) -> None:
    opened.ask("uw.app.link.call('world/pause')")
    for name in ("rov", "auv"):
        found = opened.ask(f"probe.drawn('{name}')")
        assert found["n"] > 200, found
        # A vehicle's middle on the screen is near its origin: a hull is up to 0.1 m about it, seen from 2 to 6 m.
        assert abs(found["x"] - found["at"][0]) < 0.04, found
        assert abs(found["y"] - found["at"][1]) < 0.06, found
    opened.ask("uw.app.link.call('world/resume')")


def test_texts_of_the_scenario_are_texts(opened: Page) -> None:
    assert opened.ask("document.querySelector('#header .title').textContent") == TITLE.replace("\\", "")
    assert opened.ask("document.querySelectorAll('#header .title img, #header .title b').length") == 0


def test_keys_steer_a_square(opened: Page, tmp_path: Path) -> None:
    # Ahead, to starboard, astern, to port: each leg half a metre or more, as the vehicle really moves.
    for code, axis, sign in (("KeyW", 0, 1), ("KeyE", 1, 1), ("KeyS", 0, -1), ("KeyQ", 1, -1)):
        start = opened.ask("uw.vehicles.rov")
        with opened.holding(code):
            opened.wait(f"{sign} * (uw.vehicles.rov[{axis}] - {start[axis]}) > 0.5", f"{code} moves the vehicle")
    assert opened.ask("uw.pilot.owns")
    assert opened.ask("uw.app.status.lease.rov.page === uw.app.link.session")
    opened.wait("uw.pilot.sticks.every((stick) => stick === 0)")
    opened.picture(tmp_path / "square.png")


def test_a_training_is_flown_scored_and_watched_again(opened: Page) -> None:
    opened.wait("uw.training.state.state === 'ready' && uw.training.goal?.[0] === 1.4", "the task is told")
    opened.wait("uw.drawing.scene.aim.group.visible && uw.chart.aim", "and shown")
    with opened.holding("KeyW"):
        opened.wait("uw.training.state.state === 'done'", "0.4 m ahead it is done")
    assert opened.ask("uw.training.best.score") > 100
    card = "probe.card('Training')"
    assert "All done" in opened.ask(f"{card}.textContent")
    opened.wait("uw.vehicles.rov[0] > 1", "it goes on")
    opened.ask(f"[...{card}.querySelectorAll('button')].find((b) => b.textContent === 'Watch the last try').click()")
    # From where the thrusters first pushed to the task's edge, and not beyond.
    opened.wait("uw.training.rerun?.playing && uw.vehicles.rov[0] < 0.35", "the try from its begin")
    opened.wait("!uw.training.rerun.playing && uw.vehicles.rov[0] > 0.3", "to its end")
    assert opened.ask("uw.vehicles.rov[0]") < 0.9
    slider = f"{card}.querySelector('input[type=range]')"
    opened.ask(f"{slider}.value = '0', {slider}.dispatchEvent(new Event('input'))")
    opened.wait("uw.vehicles.rov[0] < 0.2 && uw.t === uw.training.rerun.from", "back to its begin")
    opened.ask(f"[...{card}.querySelectorAll('button')].find((b) => b.textContent === 'Back to the present').click()")
    opened.wait("!uw.training.rerun && uw.vehicles.rov[0] > 1", "the present")


LESSON = """
schema = 1
start = "held"
[world]
rate_hz = 240
[environment]
density_kgpm3 = 1007.5
[structures.anode]
kind = "box"
size_m = [0.2, 0.8, 0.8]
position_ned_m = [2.0, 0.0, 2.0]
material = "zinc"
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 2.0]
[vehicles.rov.autopilot]
[vehicles.rov.sensors.ahrs]
kind = "attitude"
profile = "mems_ahrs"
rate_hz = 40
[vehicles.rov.sensors.training]
kind = "training"
mount = "camera"
rate_hz = 60
[vehicles.rov.sensors.training.tasks.look]
kind = "inspect"
structures = ["anode"]
max_speed_mps = 1.0
[vehicles.rov.sensors.training.tasks.follow]
kind = "follow"
path_ned_m = [[-1.0, 0.0, 3.4], [9.0, 0.0, 3.4]]
findings = {dent = {position_ned_m = [2.0, 0.0, 3.4]}}
wrong_mark_points = 25
[adapters.page]
kind = "web"
port = PORT
"""


def test_a_pilot_inspects_and_marks_with_the_camera(browser: Browser, tmp_path: Path) -> None:
    """The anode ahead is inspected as time begins; a mark counts once the camera is tilted to the dent, which the vehicle's own one is too."""
    with server(tmp_path, scenario=LESSON) as address:
        page = ready(browser.open(f"{address}?fps=4#quality=low&tab=pilot"))
        page.wait("uw.training.state.state === 'ready' && uw.training.goal?.[0] === 2", "the anode is the goal")
        banner = "document.querySelector('#hud .banner')"
        page.wait(f"!{banner}.hidden && {banner}.textContent === 'rov · held until the first command'", "it waits")
        card = "probe.card('Training')"
        assert "keep looking" in page.ask(f"{card}.textContent")
        assert "0 of 1" in page.ask(f"{card}.textContent")
        mark = f"[...{card}.querySelectorAll('button')].find((b) => b.textContent === 'Mark')"
        assert page.ask(f"{mark}.hidden")
        assert page.ask("uw.vehicles.rov.slice(0, 3)") == [0.0, 0.0, 2.0]
        page.ask("uw.pilot.setMode('depth_hold')")
        page.wait(f"{banner}.textContent === 'You steer rov · depth hold'", "it is let go")
        page.ask("void (uw.pilot.gain = 0.2)")
        page.ask("document.getElementById('scene').focus()")
        page.key("KeyW", True)
        page.wait("uw.training.state.state !== 'ready'", "time begins with the push")
        page.key("KeyW", False)
        page.wait("uw.training.state.number === 2", "it is looked at for 3 s")
        page.wait("uw.said.includes('Done: look')", "which is told")
        page.wait(f"!{mark}.hidden && !{mark}.disabled", "the next task has marks")
        assert page.ask("uw.training.state.score") == pytest.approx(100.0, abs=21.0)  # and the first metres
        page.ask("document.getElementById('scene').focus()")
        for down in (True, False):
            page.key("KeyX", down)
        page.wait("uw.said.includes('There is nothing to mark here: -25 points')", "it looks level: the dent is below")
        for _ in range(4):
            for down in (True, False):
                page.key("ArrowDown", down)
        page.wait("Math.abs(uw.pilot.turned + 0.4) < 1e-6", "the vehicle's mount turns with the view")
        page.wait("uw.training.state.hint !== 'turn the camera to it'", "the judge sees it")
        page.ask(f"{mark}.click()")
        page.wait("uw.said.includes('Dent: marked')", "now it counts")
        page.wait(f"{card}.textContent.includes('1 of 1: Dent')", "and stands among what was found")
        assert page.ask("uw.training.state.lost") == 25
        page.ask(f"[...{card}.querySelectorAll('button')].find((b) => b.textContent === 'Begin anew').click()")
        page.wait("uw.app.status.held.join() === 'rov' && uw.training.state.state === 'ready'", "it is held again")
        page.wait("uw.vehicles.rov.slice(0, 3).join() === '0,0,2'", "at the start")
        page.picture(tmp_path / "lesson.png")
        assert page.ask("uw.errors") == []
        page.close()


def test_all_stop_ends_thrust_and_lease(opened: Page) -> None:
    with opened.holding("KeyW"):
        opened.wait("uw.app.timeline.achieved[2] > 30", "thrusters turn")
        opened.key("Space", True)
        opened.key("Space", False)
    opened.wait("uw.app.timeline.achieved.every((part) => Math.abs(part) < 5) && !uw.app.status.lease.rov", "all stop")


def test_sticks_are_neutral_without_the_focus(opened: Page) -> None:
    opened.key("KeyW", True)
    opened.wait("uw.pilot.sticks[0] > 0.5")
    opened.ask("dispatchEvent(new Event('blur'))")
    opened.wait("uw.pilot.sticks[0] === 0")
    opened.wait("uw.app.timeline.achieved.every((part) => Math.abs(part) < 5)", "thrust ends")
    opened.key("KeyW", False)


@pytest.mark.parametrize("opened", [GAMEPAD], indirect=True)
def test_a_gamepad_steers_and_is_mapped_anew(opened: Page) -> None:
    opened.ask("axes[3] = -1")
    opened.wait("uw.vehicles.rov[0] > 0.5", "the right stick, pushed ahead, moves it ahead")
    opened.ask("axes.fill(0)")
    opened.wait("uw.pilot.sticks.every((stick) => stick === 0)")
    opened.ask("axes[0] = 0.05, axes[3] = -1")
    opened.wait("uw.pilot.pad.values[0] === 1")
    assert opened.ask("uw.pilot.pad.values[5]") == 0, "within the dead band"
    opened.ask("axes.fill(0), uw.pilot.pad.begin(0)")
    opened.ask("void (axes[2] = 1)")
    opened.wait("uw.pilot.pad.learning === -1")
    assert opened.ask("JSON.parse(localStorage.getItem('uwserver.gamepad.test pad')).axes[0]") == [2, 1]
    opened.ask("axes.fill(0)")


@pytest.mark.parametrize("opened", [GAMEPAD], indirect=True)
def test_a_gamepad_tilts_the_camera_on_board(opened: Page) -> None:
    opened.wait("uw.pilot.pad.id === 'test pad'")
    for button, sign in ((12, 1), (13, -1)):
        before = opened.ask("uw.pilot.tilt")
        opened.ask(f"void (pressed = {button})")
        opened.wait(f"{sign} * (uw.pilot.tilt - {before}) > 0.3", "it goes on while the button is held")
        opened.wait(
            f"Math.abs(uw.pilot.tilt - {sign} * Math.PI / 4) < 1e-6", "and ends at the range of the vehicle's mount"
        )
        opened.ask("void (pressed = -1)")


def test_the_autopilot_holds_a_depth_from_the_page(opened: Page) -> None:
    opened.wait("uw.t > 3", "its AHRS has settled")
    opened.click('button[data-mode="depth_hold"]')
    opened.wait("uw.pilot.armed && uw.pilot.mode === 'depth_hold'", "armed in the mode")
    with opened.holding("KeyF"):
        opened.wait("uw.vehicles.rov[2] > 2.5", "down")
    opened.key("Space", True)
    opened.key("Space", False)
    opened.wait("!uw.pilot.armed", "all stop disarms")


def test_time_stands_still_steps_goes_on_and_begins_anew(opened: Page) -> None:
    opened.click("#header button[aria-label='Pause']")
    opened.wait("uw.app.status.paused")
    before = opened.ask("uw.app.link.call('world/status').then((status) => status.t_s)")
    opened.click("#header button[aria-label='One tick']")
    # The step is under way, and the status is answered beside it.
    after = "uw.app.link.call('world/status').then((status) => status.t_s)"
    done = next(t_s for t_s in iter(lambda: opened.ask(after), None) if t_s != before)
    assert done - before == pytest.approx(1 / 240, abs=1e-6)
    assert opened.ask(after) == done
    opened.click("#header button[aria-label='Go on']")
    opened.wait(f"!uw.app.status.paused && uw.t > {before + 1}", "time goes on")
    breaks = opened.ask("uw.app.timeline.breaks")
    opened.click("#header button[aria-label='Reset the world']")
    opened.wait(
        f"uw.t < {before + 1} && uw.app.timeline.breaks > {breaks}", "the world begins anew, and trails with it"
    )


def test_a_recording_is_begun_and_ended_by_the_button(opened: Page) -> None:
    assert opened.ask("document.querySelector('#header .rec').textContent") == "REC"
    opened.click("#header .rec")
    opened.wait(
        "uw.app.status.recording && /^REC .+mcap [0-9.]+ [kM]B$/.test(document.querySelector('#header .rec').textContent)",
        "it tells name and size",
    )
    opened.wait("document.querySelector('#header .rec').getAttribute('aria-pressed') === 'true'")
    opened.wait("uw.app.status.recorder.bytes > 30000", "it grows")
    opened.click("#tab-world")
    opened.wait("document.querySelector('.recorded')?.textContent.startsWith('Recording ')", "the card tells it, too")
    opened.click("#header .rec")
    opened.wait(
        "!uw.app.status.recording && document.querySelector('#header .rec').textContent === 'REC'", "it has ended"
    )
    recorder = opened.ask("uw.app.status.recorder")
    assert isinstance(recorder, dict)
    assert recorder["error"] == ""
    toast = f"[...document.querySelectorAll('.toast')].some((each) => each.textContent.endsWith({recorder['path']!r}))"
    opened.wait(toast, "where it is")
    opened.wait("document.querySelector('.recorded').textContent.startsWith('Recorded ')", "and the card")
    found = replay(Path(recorder["path"]))
    assert (found.truncated, found.difference) == (False, None)


def test_two_pages_contend_for_a_vehicle(opened: Page, browser: Browser, address: str) -> None:
    assert opened.ask("uw.pilot.take()")
    other = ready(browser.open(f"{address}?fps=2&gl=off"))
    owner = opened.ask("uw.app.link.name")
    other.wait(
        f"document.querySelector('.owner .who').textContent.includes('{owner} steers rov')", "the other sees who steers"
    )
    refused = other.ask(
        "uw.app.link.command('rov/thrusters', { u: Array(8).fill(1) }).then(() => '', (error) => error.code)"
    )
    assert refused == "denied"
    assert not other.ask("uw.pilot.take()")
    assert other.ask("uw.pilot.take(true)")
    opened.wait("!uw.pilot.owns", "the first one is told")
    assert not opened.ask("uw.pilot.take()")
    other.close()
    opened.wait("!uw.app.status.lease.rov", "a page that has gone steers nothing")


def test_a_world_that_changes_is_drawn_anew(opened: Page) -> None:
    opened.ask("uw.app.link.call('world/spawn', { name: 'twin', like: 'rov', p_NB: [2, 2, 2] })")
    opened.wait("uw.vehicles.twin && uw.drawing.scene.crafts.length === 3", "the newcomer is drawn")
    assert opened.ask("uw.vehicles.twin.slice(0, 2)") == pytest.approx([2, 2], abs=0.3)
    opened.ask("uw.app.link.call('world/remove', { name: 'twin' })")
    opened.wait("uw.drawing.scene.crafts.length === 2")


def test_a_hidden_page_gets_no_frames(opened: Page) -> None:
    opened.ask(
        "Object.defineProperty(document, 'hidden', { value: true, configurable: true }), document.dispatchEvent(new Event('visibilitychange'))"
    )
    opened.wait("performance.now() / 1000 - uw.arrived > 2", "frames stop")
    opened.ask("delete document.hidden, document.dispatchEvent(new Event('visibilitychange'))")
    opened.wait("performance.now() / 1000 - uw.arrived < 0.5", "frames come again")


def test_panels_show_ports_and_call_services(opened: Page, tmp_path: Path) -> None:
    opened.click("#tab-data")
    opened.wait("document.querySelector('.card canvas') && document.querySelector('.values')", "a plot and values")
    opened.ask(
        "[...document.querySelectorAll('.port button')].find((b) => b.closest('.port').textContent.includes('rov/imu')).click()"
    )
    opened.wait("probe.card('rov/imu')")
    opened.wait("probe.card('rov/imu').querySelector('dd').textContent.includes('.')")
    assert "values%3Arov%2Fimu" in opened.ask("location.hash")
    opened.click("#tab-services")
    opened.ask(
        "(() => { const find = document.querySelector('#page input'); find.value = 'world/set_speed'; find.dispatchEvent(new Event('input')); })()"
    )
    opened.wait("document.querySelector('#page details details summary')")
    opened.ask("document.querySelector('#page details details').open = true")
    opened.wait("document.querySelector('form.service')")
    form = "document.querySelector('form.service')"
    opened.ask(f"{form}.querySelector('input').value = '5000', {form}.requestSubmit()")
    opened.wait(
        f"{form}.querySelector('pre').textContent.includes('above 1000')", "limits hold before anything is sent"
    )
    opened.ask(f"{form}.querySelector('input').value = '1', {form}.requestSubmit()")
    opened.wait(f"{form}.querySelector('pre').textContent.startsWith('Done at')")
    opened.click("#tab-world")
    opened.wait("probe.card('Faults')")
    opened.picture(tmp_path / "panels.png")


def test_a_tether_has_a_gauge_where_there_is_one(opened: Page) -> None:
    gauges = "[...document.querySelectorAll('.reading span')].map((e) => e.textContent)"
    assert "Tether" not in opened.ask(gauges)
    tether = "{ path: 'rov/tether', kind: 'tether', direction: 'sensor', fields: [{ name: 'tension' }] }"
    opened.ask(f"uw.app.description.ports.push({tether}), uw.app.emit('described')")
    opened.wait(f"{gauges}.includes('Tether')", "a gauge")
    opened.ask("uw.app.link.sample({ port: 'rov/tether', seq: 0, t_ns: 0, valid: true, value: { tension: 41.6 } })")
    shown = "[...document.querySelectorAll('.reading')].find((e) => e.textContent.startsWith('Tether')).textContent"
    assert opened.ask(shown) == "Tether42 N"


def test_numbers_of_a_page(opened: Page) -> None:
    """Interpolation, allocation and sonar counts by their closed forms."""
    found = opened.ask("probe.numbers()")
    period = 0.1 + 0.1 * (0.1 - 0.1)
    part = (10.2 - 1.5 * period - 10) / 0.1
    assert found["half"] == pytest.approx([0.4 * part, 1 + 0.1 * part], abs=1e-5)
    assert found["late"] == pytest.approx(0.4), "never beyond the last frame"
    assert found["jump"] == 7, "a jump is shown as one"
    assert found["none"]
    assert found["breaks"] == 1, "time that goes back clears"
    surge, heave = found["surge"], found["heave"]
    assert surge[0] == pytest.approx(2 * 2**0.5, rel=0.02)
    assert abs(surge[1]) + abs(surge[2]) < 1e-6
    assert heave[2] == pytest.approx(4, rel=0.02)
    assert abs(heave[0]) + abs(heave[1]) < 0.3
    assert found["most"] <= 1


def test_a_mission_is_planned_flown_and_kept(opened: Page) -> None:
    opened.click("#tab-mission")
    opened.click("#page input[type=checkbox]")
    at = opened.ask(
        "(() => { const r = document.querySelector('#map canvas').getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    for n, (dx, dy) in enumerate(((0, -20), (30, -20)), 1):
        for kind in ("mousePressed", "mouseReleased"):
            opened.say("Input.dispatchMouseEvent", type=kind, x=at[0] + dx, y=at[1] + dy, button="left", clickCount=1)
        opened.wait(f"uw.planner.waypoints.length === {n}", "a click on the map is a way-point")
    scale = opened.ask("20 / uw.chart.scale")
    first, second = opened.ask("uw.planner.waypoints")
    assert (first["north"], first["east"]) == pytest.approx((scale, 0), abs=0.4)
    assert second["east"] - first["east"] == pytest.approx(1.5 * scale, abs=0.1)
    opened.wait("uw.t > 3", "its AHRS has settled")
    opened.ask("[...document.querySelectorAll('#page button')].find((b) => b.textContent === 'Send and start').click()")
    opened.wait("uw.pilot.mode === 'mission'", "the mission has begun")
    opened.wait("uw.vehicles.rov[0] > 0.5", "it goes north")
    kept = opened.ask("uw.app.link.call('rov/autopilot/get_mission').then((told) => JSON.stringify(told))")
    assert f"{first['north']}" in kept
    assert "waypoint" in kept


def test_a_waypoint_has_a_depth_or_an_altitude_in_table_map_and_mission(opened: Page) -> None:
    """The bottom is 8 m deep, and the ROV begins at 2 m."""
    opened.click("#tab-mission")
    opened.ask("uw.planner.add(1, 0)")
    opened.ask("probe.choose('depth of way-point 1', '2')")
    opened.ask("uw.planner.add(2, 0)")
    opened.ask("probe.choose('Depth or altitude of way-point 2', 'altitude')")
    assert opened.ask("uw.planner.waypoints.map((w) => [w.height, w.metres])") == [["depth", 2], ["altitude", 3]]
    opened.ask("probe.choose('altitude of way-point 2', '-1')")
    assert opened.ask("uw.planner.waypoints[1].metres") == 3, "nothing is below the bottom"
    opened.ask("probe.choose('altitude of way-point 2', '2.5')")
    assert opened.ask("uw.chart.route.map((place) => [place.above, place.text])") == [
        [False, "2 m"],
        [True, "2.5 m up"],
    ]
    opened.ask("uw.planner.add(3, 1)")
    assert opened.ask("uw.planner.waypoints[2].height") == "altitude", "as the one before"
    opened.wait("uw.t > 3", "its AHRS has settled")
    opened.ask("[...document.querySelectorAll('#page button')].find((b) => b.textContent === 'Send and start').click()")
    opened.wait("uw.pilot.mode === 'mission'", "the mission has begun")
    opened.wait("uw.vehicles.rov[2] > 5", "it dives to 2.5 m above the bottom")
    opened.ask("uw.planner.set([], null)")
    opened.ask("[...document.querySelectorAll('#page button')].find((b) => b.textContent === 'Get').click()")
    opened.wait("uw.planner.waypoints.length === 3", "what was sent is shown again")
    assert opened.ask("uw.planner.waypoints.map((w) => [w.height, w.metres])") == [
        ["depth", 2], ["altitude", 2.5], ["altitude", 2.5],
    ]  # fmt: skip


def test_plans_of_qgroundcontrol(opened: Page) -> None:
    found = opened.ask("probe.plans()")
    (first, second, third), back = found["back"]["waypoints"], found["back"]
    assert (first["north"], first["east"], first["metres"], first["hold"]) == pytest.approx((1000, 0, 5, 3), abs=1e-6)
    assert (second["north"], second["east"], second["metres"]) == pytest.approx((-2, 500, 0), abs=1e-6)
    assert (third["north"], third["east"], third["metres"]) == pytest.approx((3, 4, 2.5), abs=1e-6)
    assert [waypoint["height"] for waypoint in (first, second, third)] == ["depth", "depth", "altitude"]
    assert found["asked"][1]["position_ned_m"] == [1000, 0, 5]
    assert found["asked"][3] == {"kind": "waypoint", "position_ne_m": [3, 4], "altitude_m": 2.5}
    assert [(w["height"], w["metres"]) for w in found["again"]] == [("depth", 5), ("depth", 0), ("altitude", 2.5)]
    assert (found["ne"]["height"], found["ne"]["metres"]) == ("depth", 7)
    # MAVLink's frames: above the sea and above home (the surface), which is a depth; above the ground.
    assert found["frames"] == [["depth", 4]] * 4 + [["altitude", 4]] * 2
    # QGroundControl's AltitudeMode: 1 relative, 4 terrain frame; 0 of a plan with both.
    depth, above = [3, 1, -2.5, -2.5], [10, 4, 2.5, 2.5]
    assert found["modes"] == [[1, *depth], [4, *above], [0, *depth, *above]]
    assert (back["speed"], back["left"]) == (0.7, 0)
    # At 63.43 N a minute of latitude is 1857.8 m (WGS84: radius of the meridian 6386.7 km).
    assert (found["latitude"] - 63.43) * 60 * 1857.8 == pytest.approx(1000, rel=1e-3)
    assert found["faults"] == [
        "this is no plan: it is no JSON",
        "this is no plan of QGroundControl",
        "a plan has at most 1 MiB",
        "item 1: latitude, longitude and altitude must be numbers",
        "item 2: it is 180 km from this world's origin",
        "item 1: its altitude must be relative to home, to the sea or to the ground (frame 3, 0 or 10), not of frame 8",
        "item 3: 0 m is no altitude above the ground",
        1,
        "a mission has at most 700 items, this one has 704",
    ]


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_everything_can_be_read_and_reached_by_keyboard(
    browser: Browser, address: str, theme: str, tmp_path: Path
) -> None:
    page = ready(browser.open(f"{address}?fps=2#quality=low&theme={theme}", size=(1280, 720)))
    for tab in ("pilot", "mission", "data", "world", "services", "events"):
        page.click(f"#tab-{tab}")
        assert page.ask("probe.faint()") == [], tab
        assert page.ask("probe.nameless()") == [], tab
    page.click("#tab-pilot")
    for _ in range(page.ask("probe.watchFocus()") + 12):
        page.key("Tab", True)
        page.key("Tab", False)
    assert page.ask("probe.unreached()") == []
    page.picture(tmp_path / f"{theme}.png")
    assert page.faults == []
    page.close()


def test_a_world_that_is_not_described_at_first_is_asked_for_again(browser: Browser, address: str) -> None:
    page = ready(browser.open(f"{address}?fps=4#quality=low", BUSY))
    page.wait("uw.app.bodies.length === 2 && refused === 2", "the world, asked for a third time")
    page.wait("uw.vehicles.rov", "it is drawn")
    page.close()


@pytest.mark.slow
def test_a_seabed_of_a_million_triangles_is_shown_coarse_first(browser: Browser, tmp_path: Path) -> None:
    """What is fine is held back here until the coarse seabed was seen and the vehicle steered over it."""
    depth = 12.0 + np.random.default_rng(1).normal(0.0, 0.05, (720, 720))
    np.save(tmp_path / "hills.npy", depth)
    seabed = 'kind = "grid"\nfile = "hills.npy"\nspacing_m = [0.5, 0.5]'
    scenario = SCENARIO.replace('kind = "flat"\ndepth_m = 8', seabed)
    with server(tmp_path, scenario=scenario) as address:
        page = ready(browser.open(f"{address}?fps=4#quality=low", HELD))
        counted = "uw.drawing.scene.solids.children.reduce((sum, mesh) => sum + (mesh.name === 'seabed' ? mesh.geometry.index.count / 3 : 0), 0)"
        page.wait(f"window.held > 0 && {counted} > 10000", "the coarse seabed")
        assert page.ask(counted) < 200_000
        with page.holding("KeyW"):
            page.wait("uw.vehicles.rov[0] > 0.3", "it steers meanwhile")
        page.ask("release()")
        page.wait(f"{counted} === {2 * 719 * 719}", "all of it, and nothing coarse any more")
        assert page.ask("uw.errors") == []
        page.close()


def test_without_webgl_there_are_map_and_panels(browser: Browser, address: str) -> None:
    page = ready(browser.open(f"{address}?fps=4#tab=world", NO_GL))
    page.wait("document.querySelector('#page').textContent.includes('no WebGL 2')", "the reason is told")
    page.wait("probe.colours() > 20", "the map is drawn")
    with page.holding("KeyW"):
        page.wait("uw.pilot.owns && uw.app.timeline.achieved[2] > 30", "it steers all the same")
    page.ask("uw.app.link.call('web/stop')")
    assert page.faults == []
    page.close()


def test_the_page_finds_its_server_again(browser: Browser, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with server(tmp_path, port) as address:
        page = ready(browser.open(f"{address}?fps=4#quality=low"))
    page.wait("!uw.app.connected && !document.querySelector('#notice').hidden", "it says that the server is gone")
    frames = page.ask("uw.app.timeline.breaks")
    with server(tmp_path, port):
        page.wait(f"uw.app.connected && document.querySelector('#notice').hidden && uw.app.timeline.breaks > {frames}")
        page.wait("performance.now() / 1000 - uw.arrived < 1 && uw.t < 60", "frames of the new one")
        assert page.ask("uw.errors") == []
        page.close()


IMAGING = """
[vehicles.rov.sensors.imaging]
kind = "multibeam"
rate_hz = 4
range_m = 10
beams = 64
bins = 128
field_deg = 90
beam_width_horizontal_deg = 2
rays_vertical = 64
processing_s = 0.5
rpy_deg = [0.0, -10.0, 0.0]
position_frd_m = [0.4, 0.0, 0.0]
[vehicles.rov.sensors.sides]
kind = "side_scan"
profile = "starfish_452f"
rate_hz = 4
range_m = 12
bins = 200
processing_s = 0.5
"""


def test_an_imaging_sonar_is_a_fan(browser: Browser, tmp_path: Path) -> None:
    """The pile to starboard is bright where it stands, and the edges of the picture are dark."""
    scenario = SCENARIO.replace("[vehicles.auv]", f"{IMAGING}\n[vehicles.auv]")
    with server(tmp_path, scenario=scenario) as address:
        page = ready(browser.open(f"{address}?fps=4#quality=low&tab=data"))
        page.wait("probe.card('rov/imaging')", "where nothing was asked for, what the vehicle sees is shown")
        fan = "document.querySelector('canvas[aria-label^=\"Echoes of the imaging sonar\"]')"
        page.wait(fan, "a picture is drawn")
        looks = f"""(() => {{
          const data = {fan}.getContext("2d").getImageData(0, 0, 480, 300).data;
          const of = (x, y) => data[4 * (y * 480 + x)] + data[4 * (y * 480 + x) + 1] + data[4 * (y * 480 + x) + 2];
          let most = 0;
          for (let y = 0; y < 300; y += 1) for (let x = 300; x < 400; x += 1) most = Math.max(most, of(x, y));
          return [most, of(2, 2), of(477, 2)];
        }})()"""
        page.wait(f"{looks}[0] > 450", "the pile is bright")
        assert page.ask(looks)[1:] == [25, 25]
        # Ranges stand beside the fan, not on its echoes: no count has the colour of the ink, nor has a ring.
        ink = f"""(() => {{
          const {{ data }} = {fan}.getContext("2d").getImageData(0, 0, 480, 300);
          const found = [0, 0];
          for (let k = 0; k < 480 * 300; k += 1) {{
            const [dx, dy] = [(k % 480) + 0.5 - 240, 296 - Math.floor(k / 480) - 0.5];
            const inside = Math.abs(Math.atan2(dx, dy)) < 0.78 && Math.hypot(dx, dy) < 291;
            if (data[4 * k] > 150 && data[4 * k] < 230 && data[4 * k + 2] > 190) found[inside ? 0 : 1] += 1;
          }}
          return found;
        }})()"""
        on_echoes, beside = page.ask(ink)
        assert (on_echoes, beside > 100) == (0, True)
        page.picture(tmp_path / "imaging.png")
        assert page.ask("uw.errors") == []
        # Of the side-scan sonar newer pings push older ones down; echoes of the bottom 6 m below begin half way out.
        page.ask("uw.app.link.call('world/reset')")
        page.ask(
            "[...document.querySelectorAll('.port')].find((p) => p.textContent.includes('rov/sides')).querySelectorAll('button')[1].click()"
        )
        page.wait("document.querySelector('canvas[aria-label^=\"Echoes of the side-scan sonar\"]')", "a waterfall")
        bright = """(x, y) => { const { data } = document.querySelector('canvas[aria-label^="Echoes of the side-scan sonar"]').getContext("2d")
          .getImageData(x, y, 60, 8); return data.reduce((sum, value, k) => sum + (k % 4 === 3 ? 0 : value), 0) / (60 * 8); }"""
        page.wait(f"({bright})(380, 60) > 120", "twenty pings have come down to here")
        assert page.ask(f"({bright})(40, 60)") > 120, "to port, too"
        assert page.ask(f"({bright})(200, 60)") < 60, "there is nothing in the water below"
        page.picture(tmp_path / "sides.png")
        assert page.ask("uw.errors") == []
        page.close()


TALK = (
    "schema = 1\n"
    + "".join(
        f"""
[vehicles.{name}]
model = "lauv"
position_ned_m = [{x}, {y}, 30.0]
[vehicles.{name}.sensors.modem]
kind = "acoustic_modem"
rate_hz = 1
address = {k}
bits_per_s = 5000
"""
        for k, (name, x, y) in enumerate((("west", 0.0, 0.0), ("east", 0.0, 900.0), ("north", 700.0, 300.0)), 1)
    )
    + """
[adapters.page]
kind = "web"
port = PORT
"""
)


def test_messages_of_modems_are_told_and_their_sound_is_drawn(browser: Browser, tmp_path: Path) -> None:
    """A ring goes from the sender to who has heard it, as quick as sound; what was said stands among the events."""
    with server(tmp_path, scenario=TALK) as address:
        page = ready(browser.open(f"{address}?fps=15#quality=low&view=top&tab=events"))
        page.click("#tab-events")
        send = "uw.app.link.call('web/lease/take', {{ vehicle: '{0}' }}).then(() => uw.app.link.command('{0}/modem/send', {1}))"
        page.ask(send.format("west", "{ destination: 2, data: { base64: btoa('12.5 m of sand') } }"))
        rings = "uw.drawing.scene.acoustics.rings"
        # It lives for half a second: looked at while it is there.
        grows = """(() => {
          const r = uw.drawing.scene.acoustics.rings.find((ring) => ring.mesh.visible && ring.mesh.scale.x > 200);
          if (r) globalThis.ring = [r.mesh.scale.x, uw.drawing.scene.t - r.born, r.far, r.mesh.position.toArray()];
          return Boolean(r);
        })()"""
        page.wait(grows, "a ring grows")
        ring = page.ask("ring")
        assert ring[0] == pytest.approx(ring[1] * page.ask("uw.app.world.water.sound_speed"), rel=1e-6)
        assert ring[2] == pytest.approx(900.0 * 1.05, rel=0.02)
        assert ring[3][:2] == pytest.approx([0.0, 0.0], abs=5.0)
        page.wait(f"{rings}.length === 0 && uw.chart.pulses.length === 0", "it ends where it was heard")
        page.ask("uw.chart.enlarge(), uw.chart.scale = 0.2, uw.app.link.call('world/set_speed', { speed: 0.25 })")
        page.ask(send.format("west", "{ destination: 2, data: { base64: btoa('again') } }"))
        green = """(() => {
          const { canvas } = uw.chart, { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
          let n = 0;
          for (let k = 0; k < data.length; k += 4) if (data[k + 1] > 140 && data[k] < 150 && data[k + 2] < 150) n += 1;
          return n;
        })()"""
        page.wait("uw.chart.pulses.some((pulse) => uw.t - pulse.born > 0.25)", "it grows on the map too")
        assert page.ask(green) > 200
        page.picture(tmp_path / "message.png")
        page.ask("uw.app.link.call('world/set_speed', { speed: 1 })")
        page.ask(send.format("north", "{ destination: 1, acknowledge: 1, data: { base64: 'AP8Q' } }"))
        page.ask(send.format("east", "{ destination: 77, acknowledge: 1 }"))
        page.wait("uw.app.told.some((told) => told.event === 'no_answer')", "nobody answers")
        told = page.ask("[...document.querySelectorAll('.events li')].map((li) => li.textContent).reverse()")
        said = [re.sub(r"^[\d.]+ s", "", line) for line in told]
        assert "messageeast/modem: from 1 to 2, 14 bytes: “12.5 m of sand”" in said
        assert "messagewest/modem: from 3 to 1, 3 bytes: 00 ff 10" in said
        assert "no answereast/modem: no answer of 77" in said
        with page.holding("KeyP"):
            pass
        page.picture(tmp_path / "events.png")
        (answered,) = [line for line in said if "has answered" in line]
        assert re.fullmatch(r"messagenorth/modem: 1 has answered, 7\d\d\.\d m away", answered)
        assert page.ask("uw.errors") == []
        page.close()
