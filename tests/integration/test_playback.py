"""A recording served by its command: to a client on a socket as if live, and to a real browser with a line of time."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import uwclient
from chromium_rig import chromium_or_skip
from mcap.reader import make_reader
from nursery import python
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from uwserver.cli.browser.chromium import PATIENCE_S, Browser, Page, browsing
from uwserver.cli.serving.play import play
from uwserver.recording.player.world import PLAYBACK_SERVICES

PROBES = Path(__file__).parents[1] / "page_probes.js"
SCENARIO = """
schema = 1
title = "a recorded pool"
seed = 4
[world]
rate_hz = 240
[seabed]
kind = "flat"
depth_m = 8
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 2.0]
[adapters.tcp]
kind = "sockets"
[adapters.page]
kind = "web"
[adapters.viewer]
kind = "foxglove"
[server]
metrics_port = 0
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A free-running dive of twenty seconds, by the command."""
    folder = tmp_path_factory.mktemp("recording")
    (folder / "dive.toml").write_text(SCENARIO)
    command = [python(), "-m", "uwserver", "run", str(folder / "dive.toml"), "--port", "0", "--mode", "freerun"]
    command += ["--until", "20", "--record", str(folder / "run.mcap"), "--log-level", "error"]
    subprocess.run(command, check=True, timeout=PATIENCE_S, stdout=subprocess.DEVNULL)
    return folder / "run.mcap"


@contextlib.contextmanager
def playing(path: Path, *options: str) -> Iterator[tuple[int, str]]:
    """`uwserver play`: the port of its sockets, and the address of its page."""
    with playing_said(path, *options) as said:
        port, page = re.search(r"tcp: 127\.0\.0\.1:(\d+)", said), re.search(r"http://127\.0\.0\.1:\d+/", said)
        assert port is not None, said
        assert page is not None, said
        yield int(port[1]), page[0]


@contextlib.contextmanager
def playing_said(path: Path, *options: str) -> Iterator[str]:
    """`uwserver play`: what it says at its start."""
    command = [python(), "-m", "uwserver", "play", str(path), "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            said = ""
            for line in process.stdout:
                said += line
                if line.startswith("Ctrl-C"):
                    break
            yield said
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()


def test_the_play_bar_of_foxglove_steers_it(recording: Path) -> None:
    with playing_said(recording, "--paused") as said:
        address = re.search(r"viewer: (ws://127\.0\.0\.1:\d+)", said)
        assert address is not None, said
        with connect(address[1], subprotocols=[Subprotocol("foxglove.sdk.v1")]) as viewer:
            info = json.loads(viewer.recv(PATIENCE_S))
            assert "playbackControl" in info["capabilities"]
            assert (info["dataStartTime"]["sec"], info["dataEndTime"]["sec"]) == (0, 20)

            def state() -> tuple[int, int, float, int, bytes]:
                while not isinstance(message := viewer.recv(PATIENCE_S), bytes) or message[0] != 5:
                    pass
                return (*struct.unpack_from("<BQfB", message, 1), message[19:])

            first = state()
            assert (first[0], *first[2:]) == (1, 1.0, 0, b"")
            viewer.send(struct.pack("<BBfBQI", 3, 1, 2.0, 1, 3_500_000_000, 2) + b"id")
            while (told := state())[-1] != b"id":
                pass
            assert (told[0], told[2], told[3]) == (1, 2.0, 1)
            assert abs(told[1] - 3_500_000_000) < 100_000_000


def recorded_samples(path: Path, topic: str) -> list[dict[str, object]]:
    with path.open("rb") as file:
        return [json.loads(m.data) for _, _, m in make_reader(file).iter_messages(topics=[topic], log_time_order=False)]


def test_a_client_gets_what_was_recorded_and_may_only_steer_time(recording: Path) -> None:
    with playing(recording, "--paused", "--speed", "max") as (port, _), uwclient.connect(port=port) as client:
        assert client.services.keys() >= {"playback/seek", "world/pause", "world/reset"}
        client.subscribe("rov/depth", delivery="reliable")
        client.call("world/run_until", t_s=5.0)
        found = [client.read("rov/depth", timeout=PATIENCE_S)]
        while found[-1].t_sent_ns < 4_900_000_000:
            found.append(client.read("rov/depth", timeout=PATIENCE_S))
        there = {entry["seq"]: entry for entry in recorded_samples(recording, "rov/depth")}
        assert len(found) > 50
        for sample in found:
            assert sample.t_ns == there[sample.seq]["t_ns"]
            assert dict(sample.value) == there[sample.seq]["value"]
        for refused in (lambda: client.call("world/reset"), lambda: client.send("rov/thrusters", u=[0.0] * 8)):
            with pytest.raises(uwclient.CallRefused, match="playback") as fault:
                refused()
            assert fault.value.code == "denied"
        state = client.call("playback/state")
        assert state["file"] == "run.mcap"
        assert 19.9 < state["to_s"] <= 20.0


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browsing(chromium_or_skip(), tmp_path_factory.mktemp("profile"), PROBES.read_text()) as found:
        yield found


@pytest.fixture(scope="module")
def address(browser: Browser, recording: Path) -> Iterator[str]:
    with playing(recording, "--paused") as (_, page):
        yield page


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    found = browser.open(f"{address}?fps=4#quality=low")
    found.wait("window.uw && uw.frames > 2 && uw.app.description && uw.app.status.playback", "the page plays")
    found.ask("uw.app.link.call('playback/pause').then(() => uw.app.link.call('playback/seek', { t_s: 0 }))")
    found.wait("uw.app.status.paused && uw.playback.t < 1", "at the begin")
    yield found
    assert found.faults == []
    assert found.ask("uw.errors") == []
    found.close()


def test_the_line_of_time_is_there_and_what_steers_a_vehicle_is_not(page: Page) -> None:
    assert page.ask("document.getElementById('playback').hidden") is False
    assert page.ask("getComputedStyle(document.querySelector('#header .stop')).display") == "none"
    assert page.ask("uw.app.status.playback.to_s") == pytest.approx(20.0, abs=0.1)
    page.wait("document.querySelectorAll('#playback .ticks i').length > 0", "events are marks on it")


def test_space_plays_and_arrows_go_by_frames(page: Page) -> None:
    page.key("Space", True)
    page.key("Space", False)
    page.wait("!uw.app.status.paused && uw.playback.t > 0.5", "it plays")
    page.key("Space", True)
    page.key("Space", False)
    page.wait("uw.app.status.paused", "it stands")
    begin = page.ask("uw.app.status.playback.t_s")
    page.key("ArrowRight", True)
    page.key("ArrowRight", False)
    page.wait(f"uw.app.status.playback.t_s > {begin}", "one frame on")
    assert page.ask("uw.app.status.playback.t_s") - begin < 0.2
    page.key("BracketRight", True)
    page.key("BracketRight", False)
    page.wait("uw.app.status.playback.speed === 2", "twice as fast")
    page.ask("uw.app.link.call('playback/speed', { speed: 1 })")


def test_a_click_on_the_bar_goes_there_and_the_vehicle_with_it(page: Page, recording: Path) -> None:
    box = page.ask(
        "(() => { const b = document.querySelector('#playback .bar').getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; })()"
    )
    x, y = box[0] + 0.75 * box[2], box[1] + 0.5 * box[3]
    for kind in ("mousePressed", "mouseReleased"):
        page.say("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    page.wait("Math.abs(uw.app.status.playback.t_s - 15) < 0.3", "there")
    page.wait("Math.abs(uw.t - 15) < 0.3", "the picture, too")
    depth = page.ask("uw.vehicles.rov[2]")
    near = min(recorded_samples(recording, "rov/depth"), key=lambda entry: abs(entry["t_ns"] - 15e9))  # type: ignore[operator]
    assert abs(depth - near["value"]["depth"]) < 0.3  # type: ignore[index,call-overload]


def test_a_range_is_shown_and_kept(page: Page) -> None:
    page.ask("uw.app.link.call('playback/loop', { on: true, from_s: 5, to_s: 10 })")
    page.wait("uw.app.status.playback.loop && !document.querySelector('#playback .range').hidden", "a range")
    left = page.ask("parseFloat(document.querySelector('#playback .range').style.left)")
    assert left == pytest.approx(25.0, abs=0.5)
    page.ask("uw.app.link.call('playback/loop', { on: false, from_s: 0, to_s: 1e9 })")
    page.wait("!uw.app.status.playback.loop", "once")


def test_the_page_of_a_recording_offers_no_control(page: Page) -> None:
    page.wait("!document.querySelector('#header .plays').hidden", "the badge")
    assert page.ask("document.querySelector('#header .plays').textContent") == "plays run.mcap"
    page.wait("document.querySelector('.owner .who').textContent.startsWith('A recording plays')", "the pilot's panel")
    assert page.ask("document.querySelector('.owner button').disabled") is True
    assert "play, pause" in str(page.ask("document.querySelector('dl.keys').textContent"))
    assert page.ask("uw.pilot.take()") is False


def test_what_changes_the_world_is_inactive_and_says_why(page: Page) -> None:
    page.ask("document.getElementById('tab-world').click()")
    forms = "[...document.querySelectorAll('.card')].filter((c) => ['Current', 'Moments'].includes(c.querySelector('h2').textContent))"
    page.wait(f"{forms}.length === 2", "the cards")
    page.wait(
        f"{forms}.every((c) => [...c.querySelectorAll('button')].every((b) => b.matches(':disabled')))", "inactive"
    )
    assert (
        page.ask(f"{forms}.map((c) => c.querySelector('fieldset').title)")
        == ["A recording plays: nothing in it can be changed."] * 2
    )


def test_the_page_names_options_and_services_that_there_are() -> None:
    """docs/how-to/playback.md: its listings need logs of the reader's own."""
    page = (Path(__file__).parents[2] / "docs/how-to/playback.md").read_text()
    options = {name for parameter in play.params for name in parameter.opts} | {"--mapping", "--record"}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", page)) <= options
    there = {service.path for service in PLAYBACK_SERVICES}
    assert set(re.findall(r"playback/[a-z]+", page)) <= there
