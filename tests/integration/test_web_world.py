"""What the page draws besides vehicles, where one looks from, and what it does when things go wrong: in a real browser at a real server."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from chromium_rig import chromium_or_skip
from page_rig import PROBES, ready, served

from uwserver.cli.browser.chromium import Browser, Page, browsing

SCENARIO = """
schema = 1
title = "a world of many things"
seed = 4
[world]
rate_hz = 240
[environment.current]
velocity_ned_mps = [0.0, 0.3, 0.0]
[seabed]
kind = "flat"
depth_m = 6
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.autopilot]
start_position_ned_m = [0.0, 0.0, 5.0]
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
[vehicles.rov.sensors.leak]
kind = "leak"
rate_hz = 4
[vehicles.rov.sensors.sonar]
kind = "scanning_sonar"
profile = "ping360"
rate_hz = 10
[vehicles.rov.sensors.touch]
kind = "contact"
rate_hz = 60
[vehicles.rov.sensors.usbl]
kind = "usbl"
rate_hz = 0.5
[vehicles.rov.sensors.usbl.beacons.station]
position_ned_m = [300.0, 0.0, 5.0]
turn_around_s = 0.1
[vehicles.auv]
model = "remus100"
position_ned_m = [4.0, -2.0, 4.0]
[adapters.page]
kind = "web"
port = 0
[server]
metrics_port = 0
"""
EXTENSION = """
from uwserver.ports import BeamView, Field
from uwserver.sensors import IdealSensor, Pose, SensorTable, Traits


class FinderConfig(SensorTable, tag="range_finder", kw_only=True, frozen=True):
    message = "Range"

    def traits(self):
        return Traits(beams=(BeamView((0.0, 0.0, 1.0), 0.0, 0.1, 10.0),))

    def build(self, mount):
        return Finder()


class Finder(IdealSensor):
    doc = "Distance of the bottom."
    fields = (Field("range", "m", "distance of the bottom"),)

    def measure(self, scope):
        return True, [6.0 - scope.p_NB[2]]


SENSORS = (FinderConfig,)
"""
EXTENDED = """
schema = 1
extensions = ["finder.py"]
[seabed]
kind = "flat"
depth_m = 6
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 3.0]
[vehicles.rov.sensors.finder]
kind = "range_finder"
rate_hz = 10
[adapters.page]
kind = "web"
port = 0
[server]
metrics_port = 0
"""
SCENE = "uw.drawing.scene"
DRAW = "uw.drawing.draw(uw.app.timeline, null, 0.1)"
HELD = """
const real = window.fetch;
window.answers = [];
window.holds = false;
window.fetch = async (...given) => {
  const answer = await real(...given);
  if (!String(given[0]).endsWith("world.json") || !window.holds) return answer;
  const text = await answer.text();
  await new Promise((go) => window.answers.push(go));
  return new Response(text);
};
"""
NOTHING_KEPT = """
for (const name of ["localStorage", "sessionStorage"]) {
  Object.defineProperty(window, name, { get() { throw new DOMException("denied", "SecurityError"); } });
}
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browsing(chromium_or_skip(), tmp_path_factory.mktemp("profile"), PROBES.read_text()) as found:
        yield found


@pytest.fixture(scope="module")
def address(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("server")
    (folder / "dive.toml").write_text(SCENARIO)
    with served(folder / "dive.toml", folder) as (found, _):
        yield found


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    """A page over the world begun anew; nothing may have gone wrong in it at the end."""
    found = ready(browser.open(f"{address}?fps=5#quality=low&show=current"))
    breaks = found.ask("uw.app.timeline.breaks")
    found.ask("uw.app.link.call('world/resume').then(() => uw.app.link.call('world/reset'))")
    found.wait(f"uw.app.timeline.breaks > {breaks}", "the world begins anew")
    yield found
    found.ask("uw.app.link.call('web/stop')")
    assert found.faults == []
    assert found.ask("uw.errors") == []
    found.close()


def press(page: Page, code: str) -> None:
    page.key(code, True)
    page.key(code, False)


def test_current_is_shown_by_arrows_and_set_from_the_page(page: Page) -> None:
    ahead = f"""(() => {{
      const {{ flow }} = {SCENE}, m = flow.parts[0].instanceMatrix.array;
      const length = Math.hypot(m[0], m[1], m[2]);
      return flow.group.visible ? [m[0] / length, m[1] / length, m[2] / length] : null;
    }})()"""
    page.wait(f"{ahead} !== null", "arrows")
    assert page.ask(ahead) == pytest.approx([0, 1, 0], abs=1e-3), "an arrow's x is where the water goes: east"
    page.click("#tab-world")
    page.wait("probe.card('Current')")
    form = "probe.card('Current').querySelector('form')"
    page.ask(
        f"[...{form}.querySelectorAll('input')].forEach((input, k) => {{ input.value = [-0.4, 0, 0][k]; }}), {form}.requestSubmit()"
    )
    page.wait(f"({ahead} ?? [0])[0] < -0.99", "they turn with the current")
    page.ask("uw.app.link.call('world/set_current', { velocity_N: [0, 0.3, 0] })")
    page.wait(f"({ahead} ?? [0, 0])[1] > 0.99")


def test_beams_end_where_they_hit_and_touches_are_dots(page: Page) -> None:
    ends = f"""(() => {{
      {SCENE}.stage.scene.updateMatrixWorld(true);
      const at = (kind) => {SCENE}.beams.filter((b) => b.sensor.kind === kind).flatMap((b) => b.cones).map((cone) => {{
        const end = cone.position.clone().set(1, 0, 0).applyMatrix4(cone.matrixWorld);
        return -end.y;
      }});
      return [...at("dvl"), ...at("altimeter")];
    }})()"""
    page.wait(f"{ends}.length === 5", "the beams are drawn, which a paused world cannot bring about")
    page.ask("uw.app.link.call('world/pause')")
    page.wait(f"{ends}.every((depth) => Math.abs(depth - 6) < 0.1)", "all end on the seabed")
    assert page.ask(f"{SCENE}.beams.find((b) => b.sensor.kind === 'scanning_sonar').head !== null")
    page.ask("uw.app.link.call('world/resume')")
    dots = f"{SCENE}.touches.dots.filter((dot) => dot.visible).map((dot) => dot.position.z)"
    assert page.ask(dots) == []
    with page.holding("KeyF"):
        page.wait(f"{dots}.length === 4", "it stands on its four corners")
    assert page.ask(dots) == pytest.approx([0.157] * 4, abs=0.01)


def test_a_sensor_of_an_extension_is_shown_as_a_shipped_one_with_its_message(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "finder.py").write_text(EXTENSION)
    (tmp_path / "dive.toml").write_text(EXTENDED)
    with served(tmp_path / "dive.toml", tmp_path) as (address, _):
        page = ready(browser.open(f"{address}?fps=4#quality=low"))
        cone = f"{SCENE}.beams.find((b) => b.sensor.path === 'rov/finder').cones[0]"
        page.wait(f"Math.abs({cone}.scale.x + uw.vehicles.rov[2] - 6) < 0.1", "its beam ends on the seabed")
        assert page.ask(f"'#' + {cone}.material.color.getHexString()") == "#7dffb0", "as that of an altimeter"
        gauge = (
            "[...document.querySelectorAll('.reading')].map((e) => e.textContent).find((t) => t.startsWith('Altitude'))"
        )
        page.wait(f"/Altitude\\d\\.\\d\\d m/.test({gauge} ?? '')", "it has the gauge of an altimeter")
        assert page.ask("uw.errors") == []
        page.close()


def test_propellers_and_fins_do_what_the_actuators_do(page: Page) -> None:
    spun = f"{SCENE}.crafts[0].rotors.map((part) => part.rotor.rotation.x)"
    page.ask(f"globalThis.before = {spun}")
    with page.holding("KeyW"):
        page.wait(f"{spun}.slice(0, 4).every((angle, k) => Math.abs(angle - before[k]) > 1)", "four push ahead")
        turned = page.ask(f"{spun}.map((angle, k) => Math.abs(angle - before[k]))")
    assert min(turned[:4]) > 2 * max(turned[4:]), "those that hold it level turn less"
    page.ask("uw.app.choose(1), uw.pilot.take()")
    page.wait("uw.pilot.owns && uw.app.vehicle === 'auv'")
    fins = f"{SCENE}.crafts[1].fins.map((fin) => 2 * Math.asin(Math.hypot(...fin.turning.quaternion.toArray().slice(0, 3))))"
    with page.holding("KeyD"):
        page.wait(f"{fins}.some((angle) => angle > 0.15)", "the rudder is laid")
    page.wait(f"{fins}.every((angle) => angle < 0.02)", "and comes back")


def test_pings_go_out_and_come_back_as_fast_as_sound(page: Page) -> None:
    page.ask("uw.app.link.call('world/set_speed', { speed: 0.2 })")
    rings = f"{SCENE}.acoustics.rings"
    # To the station and back, 300 m each, are 0.2 s each and the 0.1 s that it takes to answer.
    caught = f"""(() => {{
      const found = {rings}.filter((ring) => ring.mesh.visible && ring.mesh.scale.x > 10);
      for (const r of found) seen[r.mesh.position.x > 100 ? "back" : "out"] ??= [r.mesh.scale.x, {SCENE}.t - r.born];
      return seen.out && seen.back;
    }})()"""
    page.ask("void (globalThis.seen = {})")
    page.wait(caught, "a ring from the vehicle, and one from the beacon")
    speed = page.ask("uw.app.world.water.sound_speed")
    for way in ("out", "back"):
        radius, age = page.ask(f"seen.{way}")
        assert radius == pytest.approx(speed * age, rel=1e-6)
    page.ask("uw.app.link.call('world/set_speed', { speed: 1 })")


def test_who_steers_switches_the_lamps_and_tilts_the_camera_of_the_vehicle(page: Page) -> None:
    lights = f"{SCENE}.crafts[0].lamps.every(({{ lamp }}) => lamp.visible && lamp.intensity > 0)"
    page.wait(f"!{lights}")
    press(page, "KeyL")
    page.wait(lights, "they shine in the picture")
    press(page, "KeyL")
    page.wait(f"!{lights}")
    page.ask("document.getElementById('scene').focus()")

    def steering(port: str, code: str, times: int = 1) -> object:
        """In one breath, as a lease is lost while a busy machine does something else."""
        keys = f"for (let k = 0; k < {times}; k += 1) dispatchEvent(new KeyboardEvent('keydown', {{ code: '{code}' }}))"
        told = f"uw.app.link.call('{port}/get').then((told) => told.value)"
        return page.ask(f"uw.pilot.take().then(() => {{ {keys}; return {told}; }})")

    assert steering("rov/lights", "KeyL") == {"levels": [1, 1]}
    page.wait(lights)
    limit = page.ask("uw.app.port('rov/camera_tilt').fields[0].maximum")
    assert steering("rov/camera_tilt", "ArrowUp", 12) == {"tilt": [limit]}
    assert page.ask("uw.pilot.tilt") == limit
    assert steering("rov/lights", "KeyL") == {"levels": [0, 0]}


def test_settings_are_shown_before_anybody_steers(page: Page) -> None:
    page.click("#tab-world")
    card = "probe.card('Settings of rov')"
    page.wait(card)
    one = f"[...{card}.querySelectorAll('details')].find((d) => d.firstChild.textContent === 'dvl')"
    page.ask(f"void ({one}.open = true)")
    given = f"[...{one}.querySelectorAll('input')].map((input) => input.value)"
    page.wait(f"{given}.includes('15')", "its rate is there")
    assert page.ask("uw.app.status.lease.rov") is None


def test_a_click_on_the_map_sends_it_there(page: Page) -> None:
    page.wait("uw.t > 3", "its AHRS has settled")
    page.ask("uw.chart.enlarge()")
    page.wait("uw.chart.canvas.width > 400 && uw.chart.canvas.clientWidth === uw.chart.canvas.width")
    x, y = page.ask(
        "(() => { const r = uw.chart.canvas.getBoundingClientRect(), [e, n] = uw.chart.at(2, 1.5);"
        " return [r.x + r.width / 2 + e, r.y + r.height / 2 + n]; })()"
    )
    for kind in ("mousePressed", "mouseReleased"):
        page.say("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    page.wait("uw.pilot.armed && uw.pilot.mode === 'guided' && uw.chart.goal", "armed, on its way")
    assert page.ask("uw.chart.goal") == pytest.approx([2.0, 1.5], abs=0.35)
    page.wait("uw.said.includes('Arrived')", "it arrives")
    assert page.ask("uw.vehicles.rov.slice(0, 2)") == pytest.approx(
        page.ask("uw.said.find((s) => s.startsWith('Going to')).match(/-?[\\d.]+/g).slice(0, 2).map(Number)"), abs=0.5
    )


def test_a_moment_is_kept_and_gone_back_to(page: Page) -> None:
    page.click("#header button[aria-label='Keep this moment']")
    page.wait("uw.said.includes('Moment kept')")
    kept = page.ask("uw.app.link.call('world/status').then((status) => status.t_s)")
    with page.holding("KeyW"):
        page.wait("uw.vehicles.rov[0] > 1", "it goes away")
    breaks = page.ask("uw.app.timeline.breaks")
    page.click("#header button[aria-label='Back to the moment kept']")
    page.wait(
        f"uw.app.timeline.breaks > {breaks} && Math.abs(uw.vehicles.rov[0]) < 0.4 && uw.t < {kept} + 3", "and is back"
    )


def test_one_looks_from_where_the_keys_say_and_a_link_shows_the_same(
    page: Page, browser: Browser, address: str
) -> None:
    eye = f"{SCENE}.stage.camera.position.toArray()"
    off = f"(() => {{ const p = uw.vehicles.rov, [x, y, z] = {eye}; return [-z - p[0], x - p[1], -y - p[2]]; }})()"
    page.ask("uw.app.link.call('world/pause')")
    press(page, "Digit2")
    page.wait(f"{off}[0] < -0.8 && Math.abs({off}[1]) < 0.5", "follow: from behind")
    press(page, "Digit4")
    page.wait(f"{off}[2] < -2 && Math.hypot({off}[0], {off}[1]) < 0.1", "top: from above")
    press(page, "Digit3")
    page.wait(f"Math.hypot(...{off}) < 0.6 && {off}[0] > 0.1", "on board: at the bow")
    press(page, "KeyN")
    assert page.ask("uw.app.vehicle") == "auv"
    link = page.ask("location.hash")
    other = ready(browser.open(f"{address}?fps=5{link}"))
    other.wait("uw.app.vehicle === 'auv' && uw.drawing.view === 'board'", "a friend sees the same")
    assert other.ask("[...uw.app.layers].includes('current')")
    other.close()
    page.ask("uw.app.link.call('world/resume')")


def test_the_camera_stays_where_one_has_put_it_when_others_come(page: Page) -> None:
    page.ask("uw.app.link.call('world/pause')")
    page.ask(f"void {SCENE}.stage.camera.position.x++")
    page.ask("uw.planner.add(1, 2)")
    page.wait("uw.frames > 5")
    seen = page.ask(f"{SCENE}.stage.camera.position.toArray()")
    page.ask("uw.app.link.call('world/spawn', { name: 'twin', like: 'rov', p_NB: [2, 2, 2] })")
    page.wait(f"{SCENE}.crafts.length === 3", "the newcomer is drawn")
    frames = page.ask("uw.frames")
    page.wait(f"uw.frames > {frames} + 2")
    assert page.ask(f"{SCENE}.stage.camera.position.toArray()") == pytest.approx(seen, abs=0.1)
    assert page.ask("uw.planner.waypoints.length") == 1, "and a mission that is being planned stays, too"
    page.ask("uw.app.link.call('world/remove', { name: 'twin' })")
    page.wait(f"{SCENE}.crafts.length === 2")


def test_a_world_that_changes_while_it_is_loaded_is_the_newest_at_last(browser: Browser, address: str) -> None:
    """The first answer comes behind the second, which is newer."""
    page = ready(browser.open(f"{address}?fps=5#quality=low", HELD))
    page.ask("void (holds = true)")
    page.ask("uw.app.link.call('world/spawn', { name: 'twin', like: 'rov', p_NB: [2, 2, 2] })")
    page.wait("answers.length === 1", "the world is asked for")
    page.ask("uw.app.link.call('world/remove', { name: 'twin' })")
    page.wait("answers.length === 2", "and again, before the first answer")
    page.ask("void (holds = false, answers[1]())")
    page.wait("uw.app.bodies.length === 2 && uw.app.world.revision === uw.app.timeline.newest.revision")
    page.ask("void answers[0]()")
    frames = page.ask("uw.frames")
    page.wait(f"uw.frames > {frames} + 3")
    assert page.ask("uw.app.bodies.length") == 2
    assert page.ask("uw.app.world.revision === uw.app.timeline.newest.revision")
    assert page.ask("uw.errors") == []
    page.close()


def test_what_is_nothing_is_shown_as_nothing(page: Page) -> None:
    """Sensors that know nothing say null; a state that is no longer finite is no place to look at."""
    page.click("#tab-data")
    for kind, path in (("values", "rov/dvl"), ("plot", "rov/altimeter:range"), ("sonar", "rov/sonar")):
        page.ask(
            f"uw.app.address.set('panels', (uw.app.address.get('panels') ?? '').split(',').concat('{kind}:{path}').join())"
        )
    hash_ = page.ask("location.hash")
    page.ask(f"location.hash = {hash_!r}, location.reload()")
    ready(page)
    page.wait("document.querySelectorAll('.card').length >= 3", "panels of three kinds")
    page.ask("uw.app.link.call('world/pause')")
    page.wait("uw.app.status.paused")
    nothing = """(() => {
      const t_ns = 1e9 * (uw.t + 1);
      for (const port of uw.app.description.ports.filter((p) => p.direction === "sensor")) {
        const value = Object.fromEntries(port.fields.map((f) => [f.name, f.shape.length ? Array(Math.max(1, f.shape[0])).fill(null) : null]));
        uw.app.link.sample({ port: port.path, seq: 1e6, t_ns, valid: false, value });
      }
      const readings = [...document.querySelectorAll(".reading:not(.narrow) b")].map((b) => b.textContent);
      const cells = [...probe.card("rov/dvl").querySelectorAll("dd")].map((dd) => dd.textContent);
      return [readings, cells];
    })()"""
    readings, cells = page.ask(nothing)
    assert readings
    assert {text.split(" ")[0] for text in readings} == {"–"}
    assert cells
    assert all(set(text.split()) <= {"–"} for text in cells)
    # Of the vehicle that is looked at: the camera must come back to it.
    page.ask(
        f"""(() => {{
          const last = uw.app.timeline.newest, none = {{ ...last, t: last.t + 1, poses: last.poses.map(() => NaN) }};
          uw.app.timeline.clear(), uw.app.timeline.add(none), uw.app.timeline.at(performance.now() / 1000);
          for (const view of ["orbit", "follow", "board", "top"]) uw.drawing.setView(view), {DRAW};
          uw.chart.draw(uw.app.timeline, 0);
          uw.drawing.setView("orbit");
        }})()"""
    )
    page.ask("uw.app.link.call('world/resume')")
    page.wait(f"Number.isFinite(uw.vehicles.rov[0]) && {SCENE}.stage.camera.position.toArray().every(Number.isFinite)")
    page.wait(
        f"(() => {{ const p = uw.vehicles.rov, c = {SCENE}.stage.camera.position; return Math.hypot(c.x - p[1], c.z + p[0]) < 5; }})()",
        "and looks at it",
    )


def test_figures_have_room_on_the_axis(page: Page) -> None:
    page.ask("location.hash = '#tab=data&panels=plot:rov/depth:depth', location.reload()")
    ready(page)
    left = "parseFloat(document.querySelector('.u-over').style.left)"
    page.wait("document.querySelector('.u-over')")
    page.ask("uw.app.link.call('world/pause')")
    page.wait("uw.app.status.paused")
    sample = "{ port: 'rov/depth', seq: k, t_ns: 1e12 + 1e8 * k, valid: true, value: { depth: 101325 + 1e-3 * k } }"
    page.ask(f"(() => {{ for (let k = 0; k < 9; k += 1) uw.app.link.sample({sample}); }})()")
    # As the font of the axis writes it; ticks and a gap stand beside it.
    pen = "const pen = document.createElement('canvas').getContext('2d'); pen.font = '11px system-ui';"
    wide = page.ask(f"(() => {{ {pen} return pen.measureText('101,325.002').width; }})()")
    page.wait(f"{left} >= {wide} + 10", "the axis has grown")
    page.ask("uw.app.link.call('world/resume')")


@pytest.mark.parametrize(("width", "height"), [(390, 844), (844, 390), (360, 640)])
def test_a_telephone_shows_all_that_one_watches(
    browser: Browser, address: str, width: int, height: int, tmp_path: Path
) -> None:
    page = browser.open(f"{address}?fps=4#quality=low", size=(width, height))
    page.say("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=True)
    ready(page)
    box = "(() => {{ const r = document.querySelector('{}').getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; }})()"
    for panels in (False, True):
        if panels:
            page.ask("document.querySelector('#header button[aria-label=Panels]').click()")
        assert page.ask("document.querySelector('#dock').checkVisibility()") is panels
        assert page.ask("document.documentElement.scrollWidth") <= width, "nothing is beside the screen"
        for part in ("#header .stop", "#header .group button", "#tools", "#map", "#footer"):
            left, top, right, bottom = page.ask(box.format(part))
            assert 0 <= left < right <= width, part
            assert 0 <= top < bottom <= height, part
        left, top, right, bottom = page.ask(box.format("#view"))
        assert bottom - top >= 240, "of a vehicle one sees enough, on its side too"
        assert right - left >= 0.5 * width
    page.picture(tmp_path / "telephone.png")
    assert page.faults == []
    page.close()


def test_a_page_that_may_keep_nothing_works_all_the_same(browser: Browser, address: str) -> None:
    """As in a frame of a page of another site, where browsers may forbid it."""
    page = ready(browser.open(f"{address}?fps=4#quality=low&token=unused", NOTHING_KEPT))
    assert page.ask("uw.app.address.token") == "unused"
    assert "unused" not in page.ask("location.href")
    page.click("#header button[aria-label='Light or dark']")
    page.ask("uw.pilot.pad.forget()")
    with page.holding("KeyF"):
        page.wait("uw.pilot.owns && uw.pilot.sticks[2] > 0.5")
    page.ask("uw.app.link.call('web/stop')")
    assert page.ask("uw.errors") == []
    page.close()


def test_a_server_that_says_nothing_is_given_up_and_found_again(browser: Browser, tmp_path: Path) -> None:
    """As when a network goes, or a laptop slept: nothing closes the connection."""
    (tmp_path / "dive.toml").write_text(SCENARIO)
    with served(tmp_path / "dive.toml", tmp_path, sys.executable) as (address, process):
        page = ready(browser.open(f"{address}?fps=4#quality=low"))
        assert page.ask("uw.pilot.take()")
        process.send_signal(signal.SIGSTOP)
        try:
            page.wait("!uw.app.connected && !document.querySelector('#notice').hidden", "it says so")
            assert "says nothing" in page.ask("document.querySelector('#notice').textContent")
            assert not page.ask("uw.pilot.owns")
        finally:
            process.send_signal(signal.SIGCONT)
        page.wait("uw.app.connected && document.querySelector('#notice').hidden", "and finds it again")
        page.wait("performance.now() / 1000 - uw.arrived < 1", "frames come")
        assert page.ask("uw.errors") == []
        page.close()


def test_ghosts_are_seen_through_and_named_so(browser: Browser, tmp_path: Path) -> None:
    with served("filter_review", tmp_path) as (address, _):
        page = ready(browser.open(f"{address}?fps=4#quality=low&view=top"))
        assert page.ask("uw.app.world.vehicles.map((body) => [body.name, Boolean(body.ghost)])") == [
            ["truth", False], ["sensors", True], ["filter", True],
        ]  # fmt: skip
        see_through = f"""{SCENE}.crafts.map((craft) => {{
          const found = [];
          craft.looks.traverse((part) => part.material && found.push(part.material.transparent && part.material.opacity < 0.9));
          return found.length > 3 && found.every(Boolean);
        }})"""
        page.wait(f"{see_through}.join() === 'false,true,true'", "two ghosts")
        names = "[...document.querySelectorAll('#labels .label')].map((e) => e.textContent)"
        assert page.ask(names) == ["truthexternal", "sensorsghost", "filterghost"]
        assert page.ask("uw.errors") == []
        page.close()
