"""ArduSub at 1200 Hz against a running server.

Opt-in: `UWSERVER_ARDUSUB` names an `ardusub` of a SITL build (see `ground_station`). Its numbers are those of its own autotests; `test_real_dives`
and `test_real_missions` have more of them, `test_real_how_to` the shipped scenario; `test_real_px4` is for PX4. It may listen on all interfaces,
whatever it is told: run these in a network namespace (``unshare -n``, loopback up).
"""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

from autopilot_server import ardusub_scenario, serving, until
from ground_station import SENSORS, SETTLE_S, Gcs, ardusub, kept, needs_ardusub, place, settled

PACED_BY_US = 'no_time_sync = true\nrangefinders = ["altimeter"]'


@needs_ardusub
def test_ardusub_holds_depth_and_position(tmp_path: Path, gcs: Gcs) -> None:
    """The numbers of ArduPilot's own autotests AltitudeHold and PositionHold."""
    text = ardusub_scenario(depth=0.2, clock="max_speed = 3.0", adapter=PACED_BY_US, sensors=SENSORS)
    with serving(tmp_path, text) as server, ardusub(tmp_path, server, gcs):
        server.follow("rov/truth/pose")
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        for target, stick in ((-5.0, 1000), (-19.0, 1000), (-13.0, 2000), (-4.0, 2000)):
            gcs.dive(target, stick)
            gcs.hold(SETTLE_S)
            kept(gcs, server, "ALT_HOLD")
            assert abs(place(server)[2] + gcs.altitude) < 0.2, "its depth is the world's"
        gcs.mode("POSHOLD")
        gcs.hold(3.0)
        north, east, _ = place(server)
        gcs.hold(10.0)
        n, e, _ = place(server)
        print(f"POSHOLD: {math.hypot(n - north, e - east):.3f} m in 10 s")
        assert math.hypot(n - north, e - east) < 1.0
        gcs.sticks[5] = 1600
        gcs.hold(10.0)
        gcs.sticks[5] = Gcs.NEUTRAL
        moved = place(server)
        print(f"forward 1600 us: {moved[0] - n:.2f} m north, {moved[1] - e:.2f} m east in 10 s")
        assert moved[0] - n > 2.0
        details = server.stats()["details"]
        print(details)
        assert settled(details) == (0, 0, 0)


@needs_ardusub
def test_ardusub_in_real_time(tmp_path: Path, gcs: Gcs) -> None:
    """1200 frames a second for `UWSERVER_ARDUSUB_SECONDS`, none lost, none repeated; how late a tick was at worst is printed."""
    seconds = float(os.environ.get("UWSERVER_ARDUSUB_SECONDS", "20"))
    text = ardusub_scenario(clock="max_speed = 1.0", adapter=PACED_BY_US, sensors=SENSORS)
    with serving(tmp_path, text) as server, ardusub(tmp_path, server, gcs):
        gcs.until(lambda: gcs.last.get("HEARTBEAT"), "a heartbeat")
        before, begun = server.stats()["details"]["frames"], time.monotonic()
        now, frames, slowest, latest = begun, before, math.inf, 0.0
        while now - begun < seconds:
            gcs.turn()
            if time.monotonic() - now > 1.0:
                status = server.status()
                then, now = now, time.monotonic()
                count = status["adapters"]["autopilot"]["details"]["frames"]
                slowest, frames = min(slowest, (count - frames) / (now - then)), count
                latest = max(latest, status["lateness"]["max_s"])
        after, took = server.stats()["details"], time.monotonic() - begun
        print(f"{(after['frames'] - before) / took:.1f} frames/s for {took:.0f} s: {after}")
        print(f"slowest second {slowest:.0f} frames/s, latest tick {latest * 1e3:.1f} ms late")
        assert settled(after) == (0, 0, 0)
        assert after["frames"] > before


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
        assert settled(details) == (0, 0, 0)
