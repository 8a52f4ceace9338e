"""docs/how-to/ardusub.md, followed to the letter with a real ArduSub: the shipped scenario, the printed commands, the printed tables.

Opt-in, see `ground_station`. The ports are those of the page (9002, 7600, 14550), so nothing else may hold them: run it in a network namespace.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from autopilot_server import Server, addresses, run
from ground_station import ARDUSUB, SETTLE_S, Gcs, autotest, needs_ardusub, settled

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/ardusub.md").read_text()
SHIPPED = (ROOT / "scenarios/uwserver_scenarios/bluerov2_ardusub.toml").read_text()
ADAPTER = "ardusub"

pytestmark = needs_ardusub


def block(begin: str) -> str:
    """The listing of the page that begins so."""
    found = re.search(rf"^```\w*\n({re.escape(begin)}.*?)^```", PAGE, re.S | re.M)
    assert found is not None, begin
    return found[1]


@pytest.fixture
def station() -> Iterator[Gcs]:
    with contextlib.closing(Gcs(14550)) as gcs:
        yield gcs


def command_of_the_page() -> str:
    return block("ardusub --model").replace("\\\n", " ").strip()


class Desk:
    """A user's folder, with a server and an autopilot that are started and ended in any order."""

    def __init__(self, folder: Path, command: str) -> None:
        (folder / "ardupilot").symlink_to(autotest().parents[1])
        (folder / "frame.parm").write_text(block("FRAME_CONFIG 2"))
        self.folder = folder
        self._command = command
        self._environment = os.environ | {"HOME": str(folder), "PATH": f"{Path(ARDUSUB).parent}:{os.environ['PATH']}"}
        self._errors = (folder / "errors").open("w+")
        self._log = (folder / "ardusub.log").open("wb")
        self._server: subprocess.Popen[str] | None = None
        self._wire: Server | None = None
        self._autopilot: subprocess.Popen[bytes] | None = None

    def serve(self, scenario: str = "bluerov2_ardusub") -> Server:
        self._server = run(scenario, self.folder, self._errors)
        self._wire = Server(self._server, addresses(self._server, self._errors))
        return self._wire

    def start_autopilot(self) -> None:
        self._autopilot = subprocess.Popen(
            f"exec {self._command}", shell=True, cwd=self.folder, env=self._environment,
            stdin=subprocess.DEVNULL, stdout=self._log, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def kill_autopilot(self) -> None:
        if self._autopilot is not None:
            self._autopilot.kill()
            self._autopilot.wait()

    def kill_server(self) -> None:
        if self._server is not None:
            self._server.kill()
            self._hang_up()

    def interrupt_server(self) -> float:
        """Ctrl-C; how long its end took, s."""
        assert self._server is not None
        begun = time.monotonic()
        self._server.send_signal(signal.SIGINT)
        assert self._server.wait(20) == 0
        took = time.monotonic() - begun
        self._hang_up()
        return took

    def _hang_up(self) -> None:
        if self._server is not None:
            self._server.communicate()
        if self._wire is not None:
            self._wire.close()
        self._server = self._wire = None

    def close(self) -> None:
        self.kill_autopilot()
        self.kill_server()
        self._log.close()
        self._errors.seek(0)
        said = self._errors.read()
        self._errors.close()
        assert "Traceback" not in said, said


def depth_of(server: Server) -> float:
    return float(server.last("bluerov2/depth")["depth"])


def dives(gcs: Gcs, server: Server, altitude: float) -> float:
    """From anywhere, ALT_HOLD to a depth; how far it went from there in 5 s, m."""
    gcs.locate()
    gcs.mode("ALT_HOLD")
    gcs.arm()
    gcs.dive(altitude, 1000)
    gcs.hold(SETTLE_S)
    seen = gcs.hold(5.0, lambda: depth_of(server))
    assert abs(seen[-1] + gcs.altitude) < 0.2, "its depth is the world's"
    return max(seen) - min(seen)


def moving(server: Server, ticks: int = 1200) -> None:
    """Time goes on."""
    begun, end = server.status()["tick"], time.monotonic() + 30.0
    while server.status()["tick"] < begun + ticks:
        assert time.monotonic() < end, server.status()
        time.sleep(0.05)


@pytest.mark.parametrize("first", ["server", "autopilot"])
def test_the_shipped_scenario(tmp_path: Path, station: Gcs, first: str) -> None:
    """Dives; survives the death of either side; Ctrl-C ends the server in order while the autopilot flies."""
    with contextlib.closing(Desk(tmp_path, command_of_the_page())) as desk:
        if first == "autopilot":
            desk.start_autopilot()
            time.sleep(3.0)
        server = desk.serve()
        if first == "server":
            time.sleep(1.0)
            desk.start_autopilot()
        server.follow("bluerov2/depth")
        station.until(lambda: station.last.get("HEARTBEAT"), "a heartbeat")
        print(f"{first} first: {server.stats(ADAPTER)['details']}")
        went = dives(station, server, -5.0)
        details = server.stats(ADAPTER)["details"]
        print(f"{first} first: depth within {went:.3f} m in 5 s; {details}")
        assert went < 0.3
        assert (details["lost"], details["restarts"]) == (0, 0)

        desk.kill_server()
        time.sleep(3.0)
        server = desk.serve()
        server.follow("bluerov2/depth")
        moving(server)
        station.hold(20.0)
        print(f"server again: depth {depth_of(server):.2f} m, believed {station.altitude:.2f} m; {station.texts[-6:]}")

        desk.kill_autopilot()
        time.sleep(1.0)
        station.begin()
        desk.start_autopilot()
        station.until(lambda: station.last.get("HEARTBEAT"), "a heartbeat of the second autopilot")
        moving(server)
        went = dives(station, server, -4.0)
        details = server.stats(ADAPTER)["details"]
        print(f"autopilot again: depth within {went:.3f} m in 5 s; {details}")
        assert went < 0.3
        assert (details["lost"], details["restarts"]) == (0, 1)
        took = desk.interrupt_server()
        print(f"Ctrl-C: ended after {took:.2f} s")


@pytest.mark.parametrize("pace", ["ours", "--speedup 5"])
def test_four_hundred_hertz(tmp_path: Path, station: Gcs, pace: str) -> None:
    """What the page says about `--rate 400`, with either clock; no frame is lost or repeated, and the depth is kept within 0.3 m."""
    text = SHIPPED.replace("rate_hz = 1200", "rate_hz = 400") + block("[vehicles.bluerov2.sensors.pressure]")
    command = command_of_the_page() + " --rate 400"
    if pace != "ours":
        text = re.sub(r"^max_speed.*\n", "", text, flags=re.M).replace("no_time_sync = true", "no_time_sync = false")
        command = command.replace("--speedup 1", pace)
    (tmp_path / "slow.toml").write_text(text)
    with contextlib.closing(Desk(tmp_path, command)) as desk:
        server = desk.serve("slow.toml")
        server.follow("bluerov2/depth")
        desk.start_autopilot()
        station.locate()
        before, begun = server.status(), time.monotonic()
        went = dives(station, server, -5.0)
        after, took = server.status(), time.monotonic() - begun
        stats = after["adapters"][ADAPTER]
        speed = (after["t_s"] - before["t_s"]) / took
        print(f"400 Hz, pace {pace}: depth within {went:.3f} m, {speed:.2f} x real time; {stats['details']}")
        assert went < 0.3
        assert settled(stats["details"]) == (0, 0, 0)
        assert stats["last_error"] == ""
        assert stats["details"]["frame_rate_hz"] == 400


def test_the_dvl_alone(tmp_path: Path, station: Gcs) -> None:
    """The page's two listings for a vehicle without GPS, added to the shipped scenario: POSHOLD is accepted."""
    (tmp_path / "dvl.toml").write_text(SHIPPED + block("[adapters.ardusub.dvl]"))
    with contextlib.closing(Desk(tmp_path, command_of_the_page())) as desk:
        with (tmp_path / "frame.parm").open("a") as file:
            file.write(block("GPS1_TYPE 0"))
        server = desk.serve("dvl.toml")
        desk.start_autopilot()
        with station.says("started relative aiding"):
            station.locate_by_odometry()
        station.arm()
        station.mode("POSHOLD")
        station.hold(5.0)
        details = server.stats(ADAPTER)["details"]
        print(f"DVL alone: {station.texts[-6:]}, {details}")
        assert settled(details) == (0, 0, 0)
