"""PX4 against a running server, by the scenario that comes with it.

Opt-in: `UWSERVER_PX4` names a `px4` of a SITL build. It listens on all interfaces and speaks to UDP 14550: run these in a network namespace
(``unshare -n``, loopback up). Figures are printed (``pytest -s``).
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest
import uwserver_scenarios
from autopilot_server import Server, serving, until
from ground_station import Gcs

from uwserver.frames import rpy_from_quat
from uwserver.units import deg

PX4 = os.environ.get("UWSERVER_PX4", "")
TICKS = 4
"""Of the physics in one step of PX4."""

PARAMS = {"EKF2_MAG_TYPE": 5, "UUV_THRUST_SAT": 1, "UUV_TORQUE_SAT": 1, "UUV_MGM_THRTL": 0.4, "UUV_SGM_THRTL": 0.4}
"""See docs/how-to/px4.md."""

MODEL = os.environ.get("UWSERVER_PX4_MODEL", "gazebo-classic_uuv_bluerov2_heavy")

pytestmark = pytest.mark.skipif(not PX4, reason="UWSERVER_PX4 is not set: a px4 binary of a SITL build")


class Station(Gcs):
    """A ground station with a joystick, as PX4 takes it: surge, sway, heave and yaw, -1 to 1."""

    MODES: ClassVar[dict[str, int]] = {"MANUAL": 1, "ALTCTL": 2, "POSCTL": 3, "ACRO": 5, "OFFBOARD": 6, "STABILIZED": 7}

    def __init__(self) -> None:
        super().__init__(14550)
        self.surge = self.sway = self.up = self.yaw = 0.0

    def begin(self) -> None:
        """Another will come: forget what the last one said."""
        self.socket.settimeout(0.0)
        with contextlib.suppress(BlockingIOError):
            while True:
                self.socket.recv(65536)
        super().begin()

    def steer(self) -> None:
        x, y, z, r = (round(stick * 1000.0) for stick in (self.up, self.sway, (self.surge + 1.0) / 2.0, self.yaw))
        self.send(self.mav.manual_control_encode(1, x, y, z, r, 0))

    @property
    def time_s(self) -> float:
        return float(self.last["ATTITUDE"].time_boot_ms) * 1e-3

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw as it believes."""
        message = self.last["ATTITUDE"]
        return math.degrees(message.roll), math.degrees(message.pitch), math.degrees(message.yaw)

    def mode(self, name: str) -> None:
        self.command(176, 1.0, float(self.MODES[name]))
        self.until(lambda: self.is_in(name), f"mode {name}")

    def is_in(self, name: str) -> bool:
        return bool(self.last["HEARTBEAT"].custom_mode >> 16 & 0xFF == self.MODES[name])

    @property
    def is_armed(self) -> bool:
        return bool(self.last["HEARTBEAT"].base_mode & 128)


@contextlib.contextmanager
def px4(folder: Path, **params: float) -> Iterator[subprocess.Popen[bytes]]:
    """A real one with an empty parameter file, killed with the test."""
    binary = Path(PX4).resolve()
    folder.mkdir(exist_ok=True)
    environment = os.environ | {"PX4_SIM_MODEL": MODEL}
    environment |= {f"PX4_PARAM_{name}": f"{value:g}" for name, value in params.items()}
    command = [str(binary), "-d", str(binary.parents[1] / "etc")]
    with (folder / "px4.log").open("wb") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=folder, env=environment
        )
        try:
            time.sleep(0.5)
            assert process.poll() is None, (folder / "px4.log").read_text(errors="replace")
            yield process
        finally:
            process.kill()
            process.wait()


def scenario(clock: str = "max_speed = 1.0", **adapter: object) -> str:
    """The one that comes with it, on free ports but PX4's, its truth to be seen."""
    text = (Path(uwserver_scenarios.__file__).parent / "bluerov2_px4.toml").read_text(encoding="utf-8")
    text = text.replace("port = 7600", "port = 0\ntruth = true")
    text = re.sub(r"^max_speed = .*$", clock, text, flags=re.MULTILINE)
    keys = "".join(f"{key} = {value}\n" for key, value in adapter.items())
    return text.replace("[adapters.px4]\n", f"[adapters.px4]\n{keys}")


def details(server: Server) -> dict[str, int]:
    return dict(server.status()["adapters"]["px4"]["details"])


def steps(server: Server) -> tuple[int, int]:
    """Samples that it was given, outputs that came back."""
    status = server.status()
    return status["tick"] // TICKS, status["adapters"]["px4"]["details"]["controls"]


def place(server: Server) -> tuple[float, float, float]:
    north, east, down = server.last("bluerov2/truth/pose")["p_NB"]
    return north, east, down


def depth(server: Server) -> float:
    """Looked at also where nobody wants to know it: a client that does not read is told of the past."""
    return place(server)[2]


def angles_deg(server: Server) -> tuple[float, float, float]:
    """Roll, pitch, yaw of the world."""
    roll, pitch, yaw = rpy_from_quat(server.last("bluerov2/truth/pose")["q_NB"])
    return deg(roll), deg(pitch), deg(yaw)


def turned_deg(before: float, after: float) -> float:
    return (after - before + 180.0) % 360.0 - 180.0


def wait_for_estimator(station: Station) -> None:
    """Until it believes that it lies still."""
    station.until(lambda: "ATTITUDE" in station.last and "LOCAL_POSITION_NED" in station.last, "an estimate", 180)
    begun = station.time_s
    station.until(lambda: station.time_s > begun + 5.0, "5 s of it", 180)
    station.until(
        lambda: abs(station.last["LOCAL_POSITION_NED"].vz) < 0.1 and abs(station.angles_deg[0]) < 1.0,
        "a steady estimate",
        60,
    )


def arm(station: Station) -> None:
    """In MANUAL it arms with the throttle at its bottom only, for it thinks of aircraft."""
    station.mode("MANUAL")
    station.surge = -1.0
    station.hold(0.5, lambda: 0.0)
    station.arm()
    station.surge = 0.0
    station.until(lambda: station.is_armed, "armed")


def test_px4_flies_with_us(tmp_path: Path) -> None:
    """Each demand moves the vehicle of the world the right way, attitude and place are held, and no step is lost."""
    with (
        contextlib.closing(Station()) as station,
        serving(tmp_path, scenario()) as server,
        px4(tmp_path / "px4", **PARAMS, COM_RC_LOSS_T=5),  # the station may stand still on a busy machine
    ):
        wait_for_estimator(station)
        arm(station)
        server.follow("bluerov2/truth/pose")
        server.follow("bluerov2/truth/velocity")
        station.hold(1.0, lambda: 0.0)
        begun, wall, before = station.time_s, time.monotonic(), steps(server)

        station.up = -1.0
        station.until(lambda: depth(server) > 2.0, "2 m deep", 60)
        station.up = 0.0
        station.mode("STABILIZED")
        station.hold(4.0, lambda: depth(server))
        level = station.hold(5.0, lambda: max(abs(angle) for angle in angles_deg(server)[:2]))
        print(f"STABILIZED: roll and pitch within {max(level):.2f} deg of level")
        assert max(level) < 3.0

        for stick in (1.0, -1.0):
            yaw = angles_deg(server)[2]
            station.yaw = stick
            level = station.hold(3.0, lambda: max(abs(angle) for angle in angles_deg(server)[:2]))
            station.yaw = 0.0
            turned = turned_deg(yaw, angles_deg(server)[2])
            print(f"yaw stick {stick:+g} for 3 s: {turned:+.1f} deg, roll and pitch within {max(level):.2f} deg")
            assert 40.0 < turned * stick < 140.0
            assert max(level) < 10.0
            station.hold(4.0, lambda: depth(server))
        assert abs(turned_deg(station.angles_deg[2], angles_deg(server)[2])) < 3.0, "it knows where it looks"

        for axis, (stick, demand) in enumerate((("surge", 1.0), ("sway", 1.0), ("up", -1.0))):
            setattr(station, stick, demand)
            tilt = station.hold(3.0, lambda: max(abs(angle) for angle in angles_deg(server)[:2]))
            velocity = server.last("bluerov2/truth/velocity")["v_NB_B"]
            setattr(station, stick, 0.0)
            print(
                f"{stick} {demand:+g} for 3 s: {[round(v, 3) for v in velocity]} m/s, tilt within {max(tilt):.1f} deg"
            )
            assert velocity[axis] > 0.2
            assert velocity[axis] > 2.0 * max(abs(v) for other, v in enumerate(velocity) if other != axis)
            assert max(tilt) < 20.0
            station.hold(3.0, lambda: depth(server))

        station.mode("POSCTL")
        station.hold(10.0, lambda: depth(server))
        held = place(server)
        away = station.hold(15.0, lambda: math.dist(held, place(server)))
        believed = station.last["LOCAL_POSITION_NED"]
        wrong = math.dist((believed.x, believed.y, believed.z), place(server))
        print(f"POSCTL: within {max(away):.3f} m of where it was for 15 s, believed {wrong:.3f} m from there")
        assert station.is_in("POSCTL"), "no fail-safe took over"
        assert max(away) < 0.2
        assert wrong < 0.15

        after, counts = steps(server), details(server)
        given, answered = (b - a for a, b in zip(before, after, strict=True))
        took = (station.time_s - begun) / (time.monotonic() - wall)
        print(f"{given} steps, {answered} outputs, at {took:.2f} of real time; {counts}; it said {station.texts}")
        assert abs(given - answered) <= 1, "outputs for each"
        assert (counts["missed"], counts["bad"], counts["limited"], counts["connections"]) == (0, 0, 0, 1)
        assert counts["late"] <= 1, "one from before the lock-step at most"


def test_px4_starts_first_and_restarts_on_a_living_world(tmp_path: Path) -> None:
    """It waits for a simulator, and a new one goes on in the world of the old one."""
    with contextlib.closing(Station()) as station:
        with px4(tmp_path / "first"):
            log = tmp_path / "first" / "px4.log"
            until(lambda: "Waiting for simulator" in log.read_text(errors="replace"), "PX4 waits")
            with serving(tmp_path, scenario()) as server:
                wait_for_estimator(station)
                print(f"it waited, then: {details(server)}")
                assert details(server)["connections"] == 1
            station.begin()
        with serving(tmp_path, scenario()) as server:
            for start in (1, 2):
                with px4(tmp_path / f"px4_{start}"):
                    wait_for_estimator(station)
                    arm(station)
                    counts = details(server)
                    print(f"start {start}: {counts}")
                    assert counts["connections"] == start
                    assert counts["bad"] == 0
                station.begin()
                until(lambda: server.status()["adapters"]["px4"]["peers"] == 0, "it is gone")


@pytest.mark.parametrize("clock", ["max_speed = 1.0", ""], ids=["in real time", "as fast as it goes"])
def test_px4_keeps_up(tmp_path: Path, clock: str) -> None:
    """How fast is printed; that no step is lost is checked."""
    with (
        contextlib.closing(Station()) as station,
        serving(tmp_path, scenario(clock)) as server,
        px4(tmp_path / "px4", **PARAMS),
    ):
        wait_for_estimator(station)
        before, begun = steps(server), time.monotonic()
        while time.monotonic() < begun + 20.0:
            station.turn()
        after, took = steps(server), time.monotonic() - begun
        given, answered = (b - a for a, b in zip(before, after, strict=True))
        print(f"{given / took:.1f} steps/s for {took:.0f} s, {answered} outputs for {given} steps: {details(server)}")
        assert abs(given - answered) <= 1
        assert details(server)["missed"] == 0
