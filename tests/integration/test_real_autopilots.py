"""ArduSub against a running server; test_real_px4.py is for PX4.

Opt-in: `UWSERVER_ARDUSUB` names an `ardusub` of a SITL build (its `Tools/autotest/default_params/sub.parm` is looked for in the tree around it,
or named by `UWSERVER_ARDUSUB_PARAMS`). Its numbers are those of its own autotests. It may listen on all interfaces, whatever it is told: run
these in a network namespace (``unshare -n``, loopback up).
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
from autopilot_server import PATIENCE_S, Server, ardusub_scenario, serving, until

ARDUSUB = os.environ.get("UWSERVER_ARDUSUB", "")

needs_ardusub = pytest.mark.skipif(not ARDUSUB, reason="UWSERVER_ARDUSUB is not set: an ardusub binary of a SITL build")


class Gcs:
    """The least of a ground station that can dive a submarine: heartbeats, pilot input, commands. An ArduSub comes to it."""

    NEUTRAL = 1500
    MODES: ClassVar[dict[str, int]] = {"STABILIZE": 0, "ALT_HOLD": 2, "GUIDED": 4, "POSHOLD": 16, "MANUAL": 19}

    def __init__(self, port: int = 0) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.port = int(self.socket.getsockname()[1])
        self.mav = ardupilotmega.MAVLink(None, 255, 190)
        self.mav.robust_parsing = True
        self.last: dict[str, Any] = {}
        self.texts: list[str] = []
        self.sticks: dict[int, int] = {}
        self._address: Any = None
        self._sent = 0.0
        self._asked = False

    def close(self) -> None:
        self.socket.close()

    def begin(self) -> None:
        """Another autopilot will come."""
        self.last.clear()
        self._address, self._asked = None, False

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
                    self.last[message.get_type()] = message
                    if message.get_type() == "STATUSTEXT":
                        self.texts.append(message.text)
        now = time.monotonic()
        if now - self._sent > 0.1:
            self._sent = now
            self.send(self.mav.heartbeat_encode(6, 8, 0, 0, 0))
            self.steer()

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

    @property
    def time_s(self) -> float:
        """Its time, that of the simulation."""
        return float(self.last["GLOBAL_POSITION_INT"].time_boot_ms) * 1e-3

    @property
    def altitude(self) -> float:
        """As it believes, m."""
        return float(self.last["GLOBAL_POSITION_INT"].alt) * 1e-3

    def hold(self, seconds: float, look: Callable[[], float]) -> list[float]:
        """What `look` said in so many seconds of simulation."""
        seen, end = [look()], self.time_s + seconds
        while self.time_s < end:
            self.turn()
            seen.append(look())
        return seen

    def command(self, number: int, *params: float, patience_s: float = PATIENCE_S) -> None:
        """COMMAND_LONG, again each second until it is accepted."""
        given = [*params, *[0.0] * (7 - len(params))]
        end = time.monotonic() + patience_s
        while True:
            self.last.pop("COMMAND_ACK", None)
            self.send(self.mav.command_long_encode(1, 1, number, 0, *given))
            again = time.monotonic() + 1.0
            while time.monotonic() < again:
                self.turn()
                answer = self.last.get("COMMAND_ACK")
                if answer is not None and answer.command == number and answer.result == 0:
                    return
            assert time.monotonic() < end, f"command {number} {params}: {answer}; it said {self.texts[-8:]}"

    def mode(self, name: str) -> None:
        self.command(176, 1.0, float(self.MODES[name]))
        self.until(lambda: self.last["HEARTBEAT"].custom_mode == self.MODES[name], f"mode {name}")

    def arm(self) -> None:
        self.command(400, 1.0)


def params_beside(binary: Path) -> Path:
    named = os.environ.get("UWSERVER_ARDUSUB_PARAMS")
    if named:
        return Path(named)
    found = [folder / "Tools/autotest/default_params/sub.parm" for folder in binary.resolve().parents]
    return next(file for file in found if file.is_file())


@contextlib.contextmanager
def ardusub(folder: Path, server: Server, gcs: Gcs, *options: str, params: str = "") -> Iterator[None]:
    """A real one, killed with the test: it hears no SIGTERM while it waits for a simulator."""
    extra = folder / "extra.parm"
    extra.write_text(f"FRAME_CONFIG 2\nRNGFND1_TYPE 100\nRNGFND1_MAX 50\n{params}")
    command = [
        ARDUSUB, "--model", "JSON:127.0.0.1", "--sim-port-out", str(server.addresses["autopilot"][1]), "--speedup", "1",
        "--home", "33.810313,-118.393867,0,0", "--defaults", f"{params_beside(Path(ARDUSUB))},{extra}",
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
    north, east, down = server.last("rov/truth/pose")["p_NB"]
    return north, east, down


@pytest.fixture
def gcs() -> Iterator[Gcs]:
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    with contextlib.closing(Gcs()) as station:
        yield station


PACED_BY_US = 'no_time_sync = true\nrangefinders = ["altimeter"]'
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


@needs_ardusub
def test_ardusub_holds_depth_and_position(tmp_path: Path, gcs: Gcs) -> None:
    """The numbers of ArduPilot's own autotests AltitudeHold and PositionHold."""
    text = ardusub_scenario(depth=0.2, clock="max_speed = 3.0", adapter=PACED_BY_US, sensors=SENSORS)
    with serving(tmp_path, text) as server, ardusub(tmp_path, server, gcs):
        server.follow("rov/truth/pose")
        gcs.until(lambda: gcs.last.get("GLOBAL_POSITION_INT"), "a position", 180)
        gcs.until(
            lambda: gcs.last.get("EKF_STATUS_REPORT") and gcs.last["EKF_STATUS_REPORT"].flags & 0x10,
            "absolute position",
            180,
        )
        gcs.mode("ALT_HOLD")
        gcs.arm()
        for target, down in ((-5.0, True), (-19.0, True), (-13.0, False), (-4.0, False)):
            gcs.sticks[3] = 1000 if down else 2000
            gcs.until(lambda: (gcs.altitude < target) == down, f"{target} m", 180)  # noqa: B023
            gcs.sticks[3] = Gcs.NEUTRAL
            gcs.hold(3.0, lambda: gcs.altitude)
            believed = gcs.hold(5.0, lambda: gcs.altitude)
            assert max(abs(altitude - believed[0]) for altitude in believed) < 0.3
            truth = gcs.hold(5.0, lambda: place(server)[2])
            spread = max(truth) - min(truth)
            print(
                f"at {target} m: believed within {max(abs(a - believed[0]) for a in believed):.3f} m, truth within {spread:.3f} m"
            )
            assert spread < 0.3
            assert abs(place(server)[2] + gcs.altitude) < 0.5, "its depth is the world's"
        gcs.mode("POSHOLD")
        gcs.hold(3.0, lambda: 0.0)
        north, east, _ = place(server)
        gcs.hold(10.0, lambda: 0.0)
        n, e, _ = place(server)
        print(f"POSHOLD: {math.hypot(n - north, e - east):.3f} m in 10 s")
        assert math.hypot(n - north, e - east) < 1.0
        gcs.sticks[5] = 1600
        gcs.hold(10.0, lambda: 0.0)
        gcs.sticks[5] = Gcs.NEUTRAL
        moved = place(server)
        print(f"forward 1600 us: {moved[0] - n:.2f} m north, {moved[1] - e:.2f} m east in 10 s")
        assert moved[0] - n > 2.0
        details = server.stats()["details"]
        print(details)
        assert (details["duplicates"], details["lost"], details["restarts"]) == (0, 0, 0)


@needs_ardusub
def test_ardusub_in_real_time(tmp_path: Path, gcs: Gcs) -> None:
    """1200 frames a second, none lost, none repeated."""
    seconds = float(os.environ.get("UWSERVER_ARDUSUB_SECONDS", "20"))
    text = ardusub_scenario(clock="max_speed = 1.0", adapter=PACED_BY_US, sensors=SENSORS)
    with serving(tmp_path, text) as server, ardusub(tmp_path, server, gcs):
        gcs.until(lambda: gcs.last.get("HEARTBEAT"), "a heartbeat")
        before, begun = server.stats()["details"], time.monotonic()
        end = begun + seconds
        while time.monotonic() < end:
            gcs.turn()
        after, took = server.stats()["details"], time.monotonic() - begun
        print(f"{(after['frames'] - before['frames']) / took:.1f} frames/s for {took:.0f} s: {after}")
        assert (after["duplicates"], after["lost"], after["restarts"]) == (0, 0, 0)
        assert after["frames"] > before["frames"]


@needs_ardusub
def test_ardusub_restarts_on_a_living_world(tmp_path: Path, gcs: Gcs) -> None:
    with serving(tmp_path, ardusub_scenario(adapter=PACED_BY_US, sensors=SENSORS)) as server:
        for start in range(2):
            gcs.begin()
            with ardusub(tmp_path, server, gcs):
                gcs.until(lambda: gcs.last.get("HEARTBEAT"), f"a heartbeat of start {start}")
                frames = server.stats()["details"]["frames"]
                until(lambda: server.stats()["details"]["frames"] > frames + 2000, "frames")  # noqa: B023
        assert server.stats()["details"]["restarts"] == 1


@needs_ardusub
def test_ardusub_as_fast_as_it_goes(tmp_path: Path, gcs: Gcs) -> None:
    """Free-running with all sensors: how fast is printed; that the autopilot lives, and no frame is lost, is checked."""
    with (
        serving(tmp_path, ardusub_scenario(adapter=PACED_BY_US, sensors=SENSORS)) as server,
        ardusub(tmp_path, server, gcs),
    ):
        gcs.until(lambda: gcs.last.get("HEARTBEAT"), "a heartbeat")
        before, begun = server.stats()["details"]["frames"], time.monotonic()
        while time.monotonic() < begun + 10.0:
            gcs.turn()
        details, took = server.stats()["details"], time.monotonic() - begun
        print(f"free-running: {(details['frames'] - before) / took:.0f} frames/s, {details}")
        assert (details["duplicates"], details["lost"]) == (0, 0)


WITHOUT_GPS = """
GPS1_TYPE 0
VISO_TYPE 1
EK3_SRC1_POSXY 6
EK3_SRC1_VELXY 6
EK3_SRC1_POSZ 1
EK3_SRC1_VELZ 0
EK3_SRC1_YAW 1
"""


@needs_ardusub
def test_ardusub_holds_position_by_the_dvl(tmp_path: Path, gcs: Gcs) -> None:
    """Without GPS: the simulated DVL is all that it knows of its movement over ground."""
    seabed = '[seabed]\nkind = "flat"\ndepth_m = 20.0\n'
    adapter = f'{PACED_BY_US}\n[adapters.autopilot.dvl]\nport = "dvl"\naddress = "tcp:127.0.0.1:5762"'
    text = ardusub_scenario(depth=2.0, clock="max_speed = 2.0", adapter=adapter, sensors=SENSORS + seabed)
    with serving(tmp_path, text) as server, ardusub(tmp_path, server, gcs, params=WITHOUT_GPS):
        server.follow("rov/truth/pose")
        gcs.until(lambda: gcs.last.get("EKF_STATUS_REPORT"), "an estimator", 180)
        origin = gcs.mav.set_gps_global_origin_encode(1, 338103130, -1183938670, 0)
        gcs.until(lambda: any("fusing odometry" in text for text in gcs.texts), "EKF3 is fusing odometry", 180)
        for _ in range(3):
            gcs.send(origin)
            gcs.until(lambda: True, "")
            gcs.turn()
        gcs.until(lambda: gcs.last["EKF_STATUS_REPORT"].flags & 0x8, "relative position", 180)
        gcs.arm()
        gcs.mode("POSHOLD")
        gcs.until(lambda: gcs.last.get("GLOBAL_POSITION_INT"), "a position", 60)
        gcs.hold(5.0, lambda: 0.0)
        north, east, _ = place(server)
        gcs.hold(10.0, lambda: 0.0)
        n, e, _ = place(server)
        print(f"POSHOLD by DVL: {math.hypot(n - north, e - east):.3f} m in 10 s; {gcs.texts[-4:]}")
        assert math.hypot(n - north, e - east) < 1.0
