"""The least of a ground station, and a real ArduSub for it to dive: for the opt-in tests `test_real_*.py`.

`UWSERVER_ARDUSUB` names an `ardusub` of a SITL build; its `Tools/autotest` is looked for in the tree around it, or named by
`UWSERVER_ARDUSUB_AUTOTEST`.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
from autopilot_server import PATIENCE_S, PRESSURE_50_HZ, Server, ardusub_scenario, serving

ARDUSUB = os.environ.get("UWSERVER_ARDUSUB", "")

needs_ardusub = pytest.mark.skipif(not ARDUSUB, reason="UWSERVER_ARDUSUB is not set: an ardusub binary of a SITL build")

HOME = (33.810313, -118.393867)
"""Latitude and longitude of N's origin, deg: that of ArduPilot's own tests."""

NED_FRAME, ABOVE_HOME, ABOVE_GROUND = 1, 6, 11
"""MAV_FRAME: local NED, altitude over home and over ground, both with latitude and longitude as integers."""


SENSORS = """
[vehicles.rov.sensors.altimeter]
kind = "altimeter"
profile = "ping1d"
rate_hz = 10
[vehicles.rov.sensors.dvl]
kind = "dvl"
profile = "a50"
rate_hz = 8
"""
"""Of a vehicle `rov`, beside an IMU."""


Items = list[tuple[int, int, tuple[float, float, float, float], float, float, float]]
"""A mission: frame, command, four parameters, latitude and longitude (deg), altitude (m) of each item; the first is home."""


class Gcs:
    """Heartbeats, pilot input, commands, missions. An ArduSub comes to it."""

    NEUTRAL = 1500
    MODES: ClassVar[dict[str, int]] = {
        "STABILIZE": 0, "ALT_HOLD": 2, "AUTO": 3, "GUIDED": 4, "POSHOLD": 16, "MANUAL": 19, "SURFTRAK": 21,
    }  # fmt: skip

    def __init__(self, port: int = 0) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.port = int(self.socket.getsockname()[1])
        self.mav = ardupilotmega.MAVLink(None, 255, 190)
        self.mav.robust_parsing = True
        self.last: dict[str, Any] = {}
        self.texts: list[str] = []
        self.reached: list[int] = []
        self.sticks: dict[int, int] = {}
        self._address: Any = None
        self._sent = 0.0
        self._asked = False

    def close(self) -> None:
        self.socket.close()

    def begin(self) -> None:
        """Another autopilot will come."""
        self.last.clear()
        self.texts.clear()
        self._address, self._asked = None, False

    # -- what is said and heard -----------------------------------------------------------------------------------------------------

    def send(self, message: Any) -> None:
        if self._address is not None:
            with contextlib.suppress(ConnectionRefusedError):
                self.socket.sendto(message.pack(self.mav), self._address)
            self.mav.seq = (self.mav.seq + 1) % 256

    def turn(self) -> None:
        """Hear what there is, say what is due."""
        with contextlib.suppress(TimeoutError, BlockingIOError, ConnectionRefusedError):
            for patience_s in (0.02, *[0.0] * 50):
                self.socket.settimeout(patience_s)
                data, self._address = self.socket.recvfrom(65536)
                for message in self.mav.parse_buffer(data) or []:
                    self._take(message)
        now = time.monotonic()
        if now - self._sent > 0.02:
            self._sent = now
            self.send(self.mav.heartbeat_encode(6, 8, 0, 0, 0))
            self.steer()

    def _take(self, message: Any) -> None:
        self.last[message.get_type()] = message
        if message.get_type() == "STATUSTEXT":
            self.texts.append(message.text)
        elif message.get_type() == "MISSION_ITEM_REACHED":
            self.reached.append(message.seq)

    def steer(self) -> None:
        """Pilot input."""
        sticks = [self.sticks.get(channel, self.NEUTRAL) for channel in range(1, 9)]
        self.send(self.mav.rc_channels_override_encode(1, 1, *sticks))
        if not self._asked and "HEARTBEAT" in self.last:
            self._asked = True
            self.send(self.mav.request_data_stream_encode(1, 1, 0, 20, 1))

    def until(self, condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
        end = time.monotonic() + patience_s
        while not (value := condition()):
            assert time.monotonic() < end, f"not within {patience_s:g} s: {what}; it said {self.texts[-8:]}"
            self.turn()
        return value

    @contextlib.contextmanager
    def says(self, text: str) -> Iterator[None]:
        """It will, in the block or some time after."""
        before = len(self.texts)
        yield
        self.until(lambda: any(text in said for said in self.texts[before:]), f'"{text}"')

    @property
    def time_s(self) -> float:
        """Its time, that of the simulation."""
        return float(self.last["GLOBAL_POSITION_INT"].time_boot_ms) * 1e-3

    @property
    def altitude(self) -> float:
        """As it believes, m."""
        return float(self.last["GLOBAL_POSITION_INT"].alt) * 1e-3

    @property
    def heading(self) -> float:
        """As it believes, deg, -180 to 180."""
        return math.degrees(self.last["ATTITUDE"].yaw)

    def hold(self, seconds: float, look: Callable[[], Any] = lambda: None) -> list[Any]:
        """What `look` said in so many seconds of simulation."""
        seen, end = [look()], self.time_s + seconds
        while self.time_s < end:
            self.turn()
            seen.append(look())
        return seen

    # -- what it is told ------------------------------------------------------------------------------------------------------------

    def accepted(self, message: Any, number: int, patience_s: float = PATIENCE_S) -> None:
        """Send a command, again each second until it is accepted."""
        end = time.monotonic() + patience_s
        while True:
            self.last.pop("COMMAND_ACK", None)
            self.send(message)
            again = time.monotonic() + 1.0
            while time.monotonic() < again:
                self.turn()
                answer = self.last.get("COMMAND_ACK")
                if answer is not None and answer.command == number and answer.result == 0:
                    return
            assert time.monotonic() < end, f"{message}: {answer}; it said {self.texts[-8:]}"

    def command(self, number: int, *params: float, patience_s: float = PATIENCE_S) -> None:
        given = [*params, *[0.0] * (7 - len(params))]
        self.accepted(self.mav.command_long_encode(1, 1, number, 0, *given), number, patience_s)

    def mode(self, name: str) -> None:
        self.command(176, 1.0, float(self.MODES[name]))
        self.until(lambda: self.last["HEARTBEAT"].custom_mode == self.MODES[name], f"mode {name}")

    def arm(self) -> None:
        self.command(400, 1.0)

    def disarm(self) -> None:
        self.command(400, 0.0)
        self.until(lambda: not self.last["HEARTBEAT"].base_mode & 128, "disarmed")

    def locate(self) -> None:
        """Wait until it knows where it is."""
        self.until(lambda: self.last.get("GLOBAL_POSITION_INT"), "a position", 180)
        status = "EKF_STATUS_REPORT"
        self.until(lambda: status in self.last and self.last[status].flags & 0x10, "absolute position", 180)

    def locate_by_odometry(self) -> None:
        """The same without GPS: it is told an origin, and takes the rest from a DVL."""
        self.until(lambda: self.last.get("EKF_STATUS_REPORT"), "an estimator", 180)
        self.until(lambda: any("fusing odometry" in text for text in self.texts), "EKF3 is fusing odometry", 180)
        lat, lon = HOME
        for _ in range(3):
            self.send(self.mav.set_gps_global_origin_encode(1, round(lat * 1e7), round(lon * 1e7), 0))
            self.turn()
        self.until(lambda: self.last["EKF_STATUS_REPORT"].flags & 0x8, "relative position", 180)
        self.until(lambda: self.last.get("GLOBAL_POSITION_INT"), "a position", 60)

    def dive(self, altitude: float, stick: int, patience_s: float = 180) -> None:
        """By the throttle to an altitude, m, and the stick back to neutral."""
        down = self.altitude > altitude
        self.sticks[3] = stick
        self.until(lambda: (self.altitude < altitude) == down, f"{altitude} m", patience_s)
        self.sticks[3] = self.NEUTRAL

    def upload(self, items: Items) -> None:
        """Give it a mission."""
        self.last.pop("MISSION_ACK", None)
        self.send(self.mav.mission_count_encode(1, 1, len(items)))

        def served() -> bool:
            for kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                if (request := self.last.pop(kind, None)) is not None:
                    frame, command, params, lat, lon, alt = items[request.seq]
                    position = round(lat * 1e7), round(lon * 1e7), alt
                    self.send(
                        self.mav.mission_item_int_encode(1, 1, request.seq, frame, command, 0, 1, *params, *position)
                    )
            return "MISSION_ACK" in self.last

        self.until(served, "the mission is taken")
        assert self.last["MISSION_ACK"].type == 0, self.last["MISSION_ACK"]
        self.reached.clear()


def degrees_at(north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude of a place near HOME, on the sphere that ArduPilot reckons with."""
    per_metre = 0.011131884502145034
    lat = HOME[0] + north / per_metre * 1e-7
    return lat, HOME[1] + east / per_metre / math.cos(math.radians(HOME[0])) * 1e-7


def autotest() -> Path:
    """ArduPilot's `Tools/autotest`."""
    named = os.environ.get("UWSERVER_ARDUSUB_AUTOTEST")
    if named:
        return Path(named)
    found = [folder / "Tools/autotest" for folder in Path(ARDUSUB).resolve().parents]
    return next(folder for folder in found if folder.is_dir())


def defaults(frame: int) -> Path:
    """Those of a FRAME_CONFIG: `sub.parm` gives output 8 to a camera, so that its Heavy has seven thrusters."""
    return autotest() / "default_params" / {1: "sub.parm", 2: "sub-6dof.parm"}[frame]


SETTLE_S = 6.0
"""After a dive at full stick, 1 m/s: ALT_HOLD, at its default gains, comes back from half a metre too deep. ArduPilot's vehicle needs less."""

DEEP = '[seabed]\nkind = "flat"\ndepth_m = 60.0\n'
"""A seabed."""


@contextlib.contextmanager
def ardusub(
    folder: Path, server: Server, gcs: Gcs, *options: str, params: str = "", frame: int = 2, speedup: float = 1
) -> Iterator[None]:
    """A real one, killed with the test: it hears no SIGTERM while it waits for a simulator."""
    extra = folder / "extra.parm"
    extra.write_text(f"FRAME_CONFIG {frame}\nRNGFND1_TYPE 100\nRNGFND1_MAX 50\nBARO_SPEC_GRAV 1.024\n{params}")
    command = [
        ARDUSUB, "--model", "JSON:127.0.0.1", "--sim-port-out", str(server.addresses["autopilot"][1]),
        "--speedup", f"{speedup:g}", "--home", f"{HOME[0]},{HOME[1]},0,0", "--defaults", f"{defaults(frame)},{extra}",
        "--serial0", f"udpclient:127.0.0.1:{gcs.port}", "-w", *options,
    ]  # fmt: skip
    with (folder / "ardusub.log").open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, cwd=folder)
        try:
            yield
        finally:
            process.kill()
            process.wait()


def place(server: Server) -> tuple[float, float, float]:
    """Where the vehicle is in truth: north, east, down; m."""
    north, east, down = server.last("rov/truth/pose")["p_NB"]
    return north, east, down


def kept(gcs: Gcs, server: Server, what: str, allowed: float = 0.3, seconds: float = 5.0) -> None:
    """`watch_altitude_maintained` of ArduPilot's autotests: the depth, believed and true, stays within `allowed` of what it is now."""
    seen = gcs.hold(seconds, lambda: (gcs.altitude, place(server)[2]))
    believed = max(abs(altitude - seen[0][0]) for altitude, _ in seen)
    true = max(abs(down - seen[0][1]) for _, down in seen)
    print(f"{what}: at {seen[0][0]:.2f} m, believed within {believed:.3f} m, true within {true:.3f} m in {seconds:g} s")
    assert max(believed, true) < allowed


def yaw_of(server: Server) -> float:
    """Its true heading, rad."""
    w, x, y, z = server.last("rov/truth/pose")["q_NB"]
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def settled(details: dict[str, Any]) -> tuple[int, int, int]:
    """What must be nothing after a flight: repeated frames, lost ones, restarts."""
    return details["duplicates"], details["lost"], details["restarts"]


@contextlib.contextmanager
def diving(
    folder: Path, gcs: Gcs, *, depth: float = 0.2, seabed: str = DEEP, model: str = "bluerov2_heavy", frame: int = 2,
    params: str = "", adapter: str = "",
) -> Iterator[Server]:  # fmt: skip
    """A vehicle under ArduSub at six times real time; no frame may be repeated or lost."""
    text = ardusub_scenario(
        rate=400,
        depth=depth,
        clock="max_speed = 6.0",
        adapter=f'no_time_sync = true\nrangefinders = ["altimeter"]\n{adapter}',
        sensors=PRESSURE_50_HZ + SENSORS + seabed,
    ).replace('"bluerov2_heavy"', f'"{model}"')
    with (
        serving(folder, text) as server,
        ardusub(folder, server, gcs, "--rate", "400", params=params, frame=frame),
    ):
        server.follow("rov/truth/pose")
        yield server
        details = server.stats()["details"]
        assert settled(details) == (0, 0, 0), details
