"""Ground stations that others wrote, against a running server with a vehicle, its sensors and its autopilot.

pymavlink always; MAVProxy and MAVSDK when they are installed (``pip install MAVProxy mavsdk``); the first messages of QGroundControl and Cockpit
from a script, in their order.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nursery import python
from uwserver_bench.processes import Served, serving
from uwserver_bench.server import STATUS

mavutil = pytest.importorskip("pymavlink.mavutil", reason="pymavlink is not installed")

PATIENCE_S = 60.0
MAVPROXY = shutil.which("mavproxy.py") or shutil.which("mavproxy.py", path=str(Path(sys.executable).parent))
needs_mavproxy = pytest.mark.skipif(MAVPROXY is None, reason="MAVProxy is not installed")
needs_mavsdk = pytest.mark.skipif(importlib.util.find_spec("mavsdk") is None, reason="mavsdk is not installed")

SCENARIO = """\
schema = 1
title = "ground stations"
[server]
metrics = false
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.autopilot]
[vehicles.rov.sensors.ahrs]
kind = "attitude"
rate_hz = 60
[vehicles.rov.sensors.cameras]
kind = "motion_capture"
rate_hz = 30
[adapters.tcp]
kind = "sockets"
port = 0
[adapters.gcs]
kind = "mavlink"
links = ["tcpin:127.0.0.1:0", "udpin:127.0.0.1:0"]
origin_deg = [63.44, 10.39]
"""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    file = tmp_path_factory.mktemp("mavlink") / "tank.toml"
    file.write_text(SCENARIO)
    with serving(file, python=python()) as running:
        yield running


@pytest.fixture(scope="module")
def tank(served: Served) -> dict[str, int]:
    """Ports of a running server: tcp and udp."""
    address = served.ask(STATUS)["value"]["adapters"]["gcs"]["address"]
    tcp, udp = (int(text.rpartition(":")[2]) for text in address.split(", "))
    return {"tcp": tcp, "udp": udp}


@pytest.fixture
def hurried(served: Served) -> Iterator[None]:
    """Four times real time, for what takes long."""
    faster, back = (
        json.dumps(
            {
                "jsonrpc": "2.0",
                "id": 1,
                "method": "call",
                "params": {"service": "world/set_speed", "args": {"speed": speed}},
            }
        )
        for speed in (4.0, 1.0)
    )
    served.ask(faster)
    yield
    served.ask(back)


class Station:
    """A ground station by pymavlink."""

    def __init__(self, url: str, system: int = 255) -> None:
        self.link = mavutil.mavlink_connection(url, dialect="ardupilotmega", source_system=system, source_component=190)
        self.mav = self.link.mav
        self._beat_at = 0.0
        self._beat()

    def _beat(self) -> None:
        """Once a second, as ground stations do: without, the vehicle disarms (FS_GCS_ENABLE)."""
        if time.monotonic() - self._beat_at >= 1.0:
            self._beat_at = time.monotonic()
            self.mav.heartbeat_send(6, 8, 0, 0, 4)

    def until(
        self, name: str, condition: Callable[[Any], bool] = lambda _: True, beat: Callable[[], None] = lambda: None
    ) -> Any:
        """The first message of a kind for which the condition holds; `beat` is called some ten times a second."""
        end = time.monotonic() + PATIENCE_S
        last = None
        while time.monotonic() < end:
            beat()
            self._beat()
            message = self.link.recv_match(type=name, blocking=True, timeout=0.1)
            last = message or last
            if message is not None and condition(message):
                return message
        raise AssertionError(f"no {name} that fits; the last one: {last}")

    def command(self, number: int, *p: float) -> int:
        self.mav.command_long_send(1, 1, number, 0, *(*p, *(0.0,) * 7)[:7])
        return int(self.until("COMMAND_ACK", lambda m: m.command == number).result)

    def mode(self, number: int) -> None:
        """Set a mode; for the second after the start in which the AHRS settles, the vehicle refuses."""
        end = time.monotonic() + PATIENCE_S
        while self.command(176, 1.0, number) != 0:
            assert time.monotonic() < end, f"mode {number} is refused"
            time.sleep(0.1)
        self.until("HEARTBEAT", lambda m: m.custom_mode == number)


@contextlib.contextmanager
def station(url: str, system: int = 255) -> Iterator[Station]:
    made = Station(url, system)
    try:
        yield made
    finally:
        made.command(400, 0.0, 21196.0)
        made.link.close()


@pytest.mark.parametrize("url", ["tcp:127.0.0.1:{tcp}", "udpout:127.0.0.1:{udp}"])
def test_a_dive(tank: dict[str, int], url: str) -> None:
    with station(url.format(**tank)) as gcs:
        gcs.mode(2)
        assert gcs.command(400, 1.0) == 0
        gcs.until("HEARTBEAT", lambda m: m.base_mode & 128)
        start = gcs.until("GLOBAL_POSITION_INT").relative_alt
        gcs.until(
            "GLOBAL_POSITION_INT",
            lambda m: m.relative_alt < start - 700,
            lambda: gcs.mav.manual_control_send(1, 0, 0, 0, 0, 0),  # the heave stick right down
        )
        gcs.until("VFR_HUD", lambda m: m.alt < start / 1e3 - 0.7)
        gcs.until("SERVO_OUTPUT_RAW", lambda m: m.servo5_raw != 1500 != m.servo8_raw)


def test_guided_and_a_mission(tank: dict[str, int], hurried: None) -> None:
    with station(f"tcp:127.0.0.1:{tank['tcp']}") as gcs:
        gcs.mode(4)
        assert gcs.command(400, 1.0) == 0
        gcs.mav.set_position_target_local_ned_send(0, 1, 1, 1, 0xDF8, 1.0, 1.0, 5.0, 0, 0, 0, 0, 0, 0, 0, 0)
        gcs.until("LOCAL_POSITION_NED", lambda m: math.dist((m.x, m.y, m.z), (1.0, 1.0, 5.0)) < 0.3)
        items = [(0, 0, 0), (0, 1, 5), (0, 0, 5)]
        gcs.mav.mission_count_send(1, 1, len(items), 0)
        for seq, (x, y, z) in enumerate(items):
            gcs.until("MISSION_REQUEST_INT", lambda m, seq=seq: m.seq == seq)
            gcs.mav.mission_item_int_send(1, 1, seq, 1, 16, 0, 1, 0, 0.5, 0, math.nan, x * 10_000, y * 10_000, z, 0)
        assert gcs.until("MISSION_ACK").type == 0
        reached: list[int] = []  # the first perhaps while the mode is still waited for
        gcs.link.message_hooks.append(
            lambda _, m: reached.append(m.seq) if m.get_type() == "MISSION_ITEM_REACHED" else None
        )
        gcs.mode(3)
        gcs.until("HEARTBEAT", lambda _: len(reached) >= 2)
        assert reached[:2] == [1, 2]


# -- the first messages of ground stations, in their order ---------------------------------------------------------------------------


def test_how_qgroundcontrol_connects(tank: dict[str, int]) -> None:
    """Version, modes, metadata, streams, parameters, mission, fence, rally points: nothing of it may wait for a time-out."""
    with station(f"udpout:127.0.0.1:{tank['udp']}") as gcs:
        heartbeat = gcs.until("HEARTBEAT")
        assert (heartbeat.type, heartbeat.autopilot, heartbeat.get_srcComponent()) == (12, 3, 1)
        assert gcs.command(512, 148.0) == 0
        assert gcs.until("AUTOPILOT_VERSION").capabilities & 4
        assert gcs.command(512, 435.0) == 0
        assert gcs.command(512, 397.0) == 4
        for group, rate in ((1, 2), (2, 2), (3, 2), (6, 3), (10, 20), (11, 10), (12, 3)):
            gcs.mav.request_data_stream_send(1, 1, group, rate, 1)
        name = b"@PARAM/param.pck"
        opened = bytes((1, 0, 0, 4, len(name), 0, 0, 0, 0, 0, 0, 0)) + name
        gcs.mav.file_transfer_protocol_send(0, 1, 1, list(opened.ljust(251, b"\0")))
        assert gcs.until("FILE_TRANSFER_PROTOCOL").payload[3] == 128
        gcs.mav.param_request_list_send(1, 0)
        first = gcs.until("PARAM_VALUE")
        seen = {first.param_index}
        gcs.until("PARAM_VALUE", lambda m: seen.add(m.param_index) or len(seen) == first.param_count)  # type: ignore[func-returns-value]
        for kind in (0, 1, 2):
            gcs.mav.mission_request_list_send(1, 1, kind)
            count = gcs.until("MISSION_COUNT", lambda m, kind=kind: m.mission_type == kind).count
            assert kind == 0 or count == 0
        assert gcs.command(410) == 0
        gcs.until("HOME_POSITION")
        for name in (
            "ATTITUDE",
            "GLOBAL_POSITION_INT",
            "VFR_HUD",
            "SYS_STATUS",
            "SCALED_PRESSURE2",
            "NAMED_VALUE_FLOAT",
        ):
            gcs.until(name)


def test_how_cockpit_connects(tank: dict[str, int]) -> None:
    """One SET_MESSAGE_INTERVAL for each message that it shows; the latency by TIMESYNC."""
    with station(f"udpout:127.0.0.1:{tank['udp']}") as gcs:
        assert gcs.until("HEARTBEAT").base_mode
        gcs.mav.param_request_list_send(1, 1)
        for number, hz in (
            (30, 16),
            (178, 16),
            (74, 16),
            (33, 3),
            (1, 2),
            (147, 2),
            (137, 2),
            (36, 2),
            (65, 2),
            (251, 2),
            (42, 2),
        ):
            assert gcs.command(511, number, 1e6 / hz) == 0
        gcs.mav.timesync_send(0, 987_654_321)
        assert gcs.until("TIMESYNC").ts1 == 987_654_321
        times = []
        gcs.until("ATTITUDE", lambda m: times.append(m.time_boot_ms) or len(times) == 17)  # type: ignore[func-returns-value]
        assert times[-1] - times[0] == pytest.approx(1000, abs=50)
        for name in ("AHRS2", "VFR_HUD", "SYS_STATUS", "SCALED_PRESSURE2", "RC_CHANNELS", "SERVO_OUTPUT_RAW"):
            gcs.until(name)


# -- programs ------------------------------------------------------------------------------------------------------------------------


def converse(process: subprocess.Popen[str], steps: list[tuple[str, str]], log: Path) -> None:
    """Write a line, wait for its answer, and so on."""
    assert process.stdin is not None
    for line, answer in steps:
        before = len(log.read_bytes()) if line else 0
        if line:
            process.stdin.write(line + "\n")
            process.stdin.flush()
        end = time.monotonic() + PATIENCE_S
        while answer.encode() not in log.read_bytes()[before:]:
            text = log.read_text(errors="replace")
            assert process.poll() is None, text
            assert time.monotonic() < end, f'no "{answer}" after "{line}":\n{text[-3000:]}'
            time.sleep(0.1)


@needs_mavproxy
def test_mavproxy(tank: dict[str, int], tmp_path: Path) -> None:
    """Headless: connect, parameters (it takes them by FTP), mode, arm, rc, wp, disarm."""
    assert MAVPROXY is not None
    waypoints = tmp_path / "way.txt"
    rows = [
        "QGC WPL 110",
        "0\t1\t0\t16\t0\t0\t0\t0\t63.44\t10.39\t0\t1",
        "1\t0\t3\t16\t0\t1\t0\t0\t63.4401\t10.39\t-5\t1",
    ]
    waypoints.write_text("\n".join(rows) + "\n")
    log = tmp_path / "mavproxy.log"
    command = [
        MAVPROXY,
        f"--master=tcp:127.0.0.1:{tank['tcp']}",
        "--source-system=255",
        "--default-modules=link,param,mode,arm,rc,wp,ftp,misc,cmdlong",
    ]
    env = {**os.environ, "HOME": str(tmp_path), "PYTHONUNBUFFERED": "1", "PYTHONWARNINGS": "ignore"}
    with log.open("w") as output, subprocess.Popen(
        command, cwd=tmp_path, stdin=subprocess.PIPE, stdout=output, stderr=subprocess.STDOUT, text=True, env=env
    ) as process:  # fmt: skip
        try:
            converse(
                process,
                [
                    ("", "Detected vehicle 1:1"),
                    ("", "Received 467 parameters"),
                    ("param show JS_GAIN_DEFAULT", "0.5"),
                    ("param set JS_GAIN_DEFAULT 0.6", ""),
                    ("mode ALT_HOLD", "Mode ALT_HOLD"),
                    (f"wp load {waypoints}", "MISSION_ACK: TYPE_MISSION: ACCEPTED"),
                    ("wp list", "Requesting 2 waypoints"),
                    ("", "Saved 2 waypoints"),
                    ("arm throttle", "ARMED"),
                    ("rc 3 1400", ""),
                    ("disarm", "DISARMED"),
                ],
                log,
            )
        finally:
            process.kill()
    assert (tmp_path / "mav.tlog").stat().st_size > 1000


MAVSDK = """
import asyncio, sys
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

async def main():
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(f"tcpout://127.0.0.1:{sys.argv[1]}")
        system = await mavsdk.first_autopilot(timeout_s=30.0)
        print("found", system is not None, flush=True)
        telemetry = TelemetryAsync(system)
        async for attitude in telemetry.subscribe_attitude_euler():
            print("attitude", flush=True)
            break
        print("gain", await ParamAsync(system).get_param_float("JS_THR_GAIN"), flush=True)
        action = ActionAsync(system)
        await action.arm()
        async for armed in telemetry.subscribe_armed():
            if armed:
                print("armed", flush=True)
                break
        await action.disarm()
        print("disarmed", flush=True)

asyncio.run(asyncio.wait_for(main(), 90))
"""


@needs_mavsdk
def test_mavsdk(tank: dict[str, int]) -> None:
    """In a process of its own: the library is native and starts threads."""
    command = [sys.executable, "-c", MAVSDK, str(tank["tcp"])]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=2 * PATIENCE_S, env={**os.environ, "PYTHONWARNINGS": "ignore"}
    )
    for word in ("found True", "attitude", "gain 1.0", "armed", "disarmed"):
        assert word in done.stdout.splitlines() or word in done.stdout, done.stdout + done.stderr[-3000:]


def test_several_stations_at_once(tank: dict[str, int]) -> None:
    with contextlib.ExitStack() as stack:
        urls = [f"tcp:127.0.0.1:{tank['tcp']}", f"udpout:127.0.0.1:{tank['udp']}"] * 2
        stations = [stack.enter_context(station(url, 255 - k)) for k, url in enumerate(urls)]
        for gcs in stations:
            assert gcs.command(520, 1.0) == 0
            gcs.until("ATTITUDE")
        # Each hears the heartbeats of the others.
        heard = stations[3].until(
            "HEARTBEAT",
            lambda m: m.get_srcSystem() in (253, 254),
            lambda: stations[1].mav.heartbeat_send(6, 8, 0, 0, 4),
        )
        assert heard.type == 6
