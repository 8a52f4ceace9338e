"""Autopilots that others wrote, against a running server.

Opt-in: `UWSERVER_ARDUSUB` names an `ardusub` of a SITL build (its `Tools/autotest/default_params/sub.parm` is looked for in the tree around it,
or named by `UWSERVER_ARDUSUB_PARAMS`), `UWSERVER_PX4` a `px4` of a SITL build. ArduSub's numbers are those of its own autotests. Both autopilots
may listen on all interfaces, whatever they are told: run these in a network namespace (``unshare -n``, loopback up).
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
from autopilot_server import PATIENCE_S, PRESSURE_50_HZ, SCENARIO, Server, ardusub_scenario, serving, until

ARDUSUB = os.environ.get("UWSERVER_ARDUSUB", "")
PX4 = os.environ.get("UWSERVER_PX4", "")

needs_ardusub = pytest.mark.skipif(not ARDUSUB, reason="UWSERVER_ARDUSUB is not set: an ardusub binary of a SITL build")
needs_px4 = pytest.mark.skipif(not PX4, reason="UWSERVER_PX4 is not set: a px4 binary of a SITL build")


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


@needs_px4
def test_px4_flies_with_us(tmp_path: Path) -> None:
    """It connects, is given time, and sends outputs; `UWSERVER_PX4` is started in its own build folder."""
    text = SCENARIO.format(
        rate=1000,
        imu=250,
        port=4560,
        depth=5.0,
        clock="max_speed = 1.0",
        sensors=PRESSURE_50_HZ,
        adapter='kind = "px4_hil"\ndepth = "depth"',
    )
    binary = Path(PX4).resolve()
    environment = os.environ | {"PX4_SIM_MODEL": "gazebo-classic_uuv_bluerov2_heavy"}
    with serving(tmp_path, text) as server, (tmp_path / "px4.log").open("wb") as log:
        command = [str(binary), "-d", str(binary.parents[1] / "etc")]
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=tmp_path, env=environment
        )
        try:
            until(lambda: server.stats()["details"]["controls"] > 500, "outputs of PX4")
            assert server.stats()["peers"] == 1
        finally:
            process.kill()
            process.wait()
