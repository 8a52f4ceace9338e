"""A real ArduSub dives our vehicles: what ArduPilot's own autotests (`Tools/autotest/ardusub.py`) ask of their vehicle, with their numbers.

Opt-in, see `ground_station`. The autopilot steps the physics at 400 Hz, so a dive of minutes takes some ten seconds; figures are printed
(``pytest -s``). The vehicle makes 1.2 m/s ahead; where ArduPilot's is stronger it is asked for less, as is said there.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from autopilot_server import Server
from ground_station import SETTLE_S, Gcs, diving, kept, needs_ardusub, place, yaw_of

pytestmark = needs_ardusub

BY_DVL = """
[adapters.autopilot.dvl]
port = "dvl"
address = "tcp:127.0.0.1:5762"
"""
WITHOUT_GPS = """
GPS1_TYPE 0
VISO_TYPE 1
EK3_SRC1_POSXY 6
EK3_SRC1_VELXY 6
EK3_SRC1_POSZ 1
EK3_SRC1_VELZ 0
EK3_SRC1_YAW 1
"""


def float_by(server: Server, newton: float) -> None:
    server.call("world/set_fault", name="foam", kind="buoyancy_change", target="rov", parameters={"force_N": newton})


def steer(gcs: Gcs, heading: float) -> None:
    """By the yaw stick to a heading (deg), in POSHOLD or ALT_HOLD; it stays there."""

    def off() -> float:
        return (heading - gcs.heading + 180.0) % 360.0 - 180.0

    end = gcs.time_s + 120.0
    while abs(off()) > 3.0:
        assert gcs.time_s < end, f"heading {gcs.heading:.1f}, not {heading}"
        gcs.sticks[4] = round(1500 + math.copysign(min(max(2.0 * abs(off()), 40.0), 150.0), off()))
        gcs.hold(0.2)
        if abs(off()) < 10.0:  # it turns on for a while
            gcs.sticks[4] = Gcs.NEUTRAL
            gcs.hold(2.0)
    gcs.sticks[4] = Gcs.NEUTRAL
    gcs.hold(2.0)


def test_it_holds_depth_when_its_buoyancy_changes(tmp_path: Path, gcs: Gcs) -> None:
    """AltitudeHold, its end: 0.3 m in 5 s with +-10 N of buoyancy, at once, and a small stick against it dives."""
    with diving(tmp_path, gcs) as server:
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        gcs.dive(-4.5, 1000)
        gcs.hold(SETTLE_S)
        for newton in (10.0, -10.0, 10.0):
            float_by(server, newton)
            kept(gcs, server, f"{newton:+.0f} N")
        gcs.dive(-5.5, 1350)
        gcs.hold(1.0)
        kept(gcs, server, "after diving against +10 N")


def test_modes_change_without_a_jump_in_depth(tmp_path: Path, gcs: Gcs) -> None:
    """ModeChanges: 0.2 m at neutral buoyancy through ALT_HOLD, POSHOLD, STABILIZE and SURFTRAK."""
    with diving(tmp_path, gcs, depth=4.0) as server:
        gcs.locate()
        float_by(server, -(1025.0 * 0.0134 - 13.5) * 9.81)
        gcs.mode("STABILIZE")
        gcs.arm()
        gcs.sticks[3] = 1350
        gcs.hold(10.0)
        gcs.sticks[3] = Gcs.NEUTRAL
        gcs.hold(3.0)
        before = place(server)[2]
        for mode in ("ALT_HOLD", "POSHOLD", "STABILIZE", "SURFTRAK", "ALT_HOLD", "STABILIZE", "ALT_HOLD", "SURFTRAK"):
            gcs.mode(mode)
            gcs.hold(2.0)
        gcs.mode("MANUAL")
        moved = place(server)[2] - before
        print(f"through eight modes: {moved:+.3f} m of depth")
        assert abs(moved) < 0.2


@pytest.mark.parametrize("aid", ["gps", "dvl"])
def test_it_holds_position_in_a_current(tmp_path: Path, gcs: Gcs, aid: str) -> None:
    """PositionHold: less than 1 m of drift in 10 s, then at least 2 m north in 10 s with the stick at 1600 us, against the current.

    ArduPilot asks both in 1 m/s. At full thrust ahead this vehicle makes 1.2 m/s through the water, little more than that: it must hold in 1 m/s,
    and make that way against 0.3 m/s.
    """
    by_dvl = aid == "dvl"
    with diving(
        tmp_path, gcs, seabed='[seabed]\nkind = "flat"\ndepth_m = 20.0\n',
        adapter=BY_DVL if by_dvl else "", params=WITHOUT_GPS if by_dvl else "",
    ) as server:  # fmt: skip
        if by_dvl:
            gcs.locate_by_odometry()
        else:
            gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        steer(gcs, 0.0)
        gcs.mode("POSHOLD")
        gcs.sticks[3] = 1300
        gcs.hold(3.0)
        gcs.sticks[3] = Gcs.NEUTRAL
        gcs.hold(2.0)

        def drifts(speed: float) -> list[float]:
            server.call("world/set_current", velocity_N=[-speed, 0.0, 0.0])
            start = place(server)
            return gcs.hold(10.0, lambda: math.dist(start[:2], place(server)[:2]))

        for speed in (0.0, 0.3, 0.6, 1.0):
            drift = drifts(speed)
            print(f"{aid}, {speed} m/s: at most {max(drift):.3f} m, {drift[-1]:.3f} m after 10 s")
            assert max(drift) < 1.0
        drifts(0.3)
        gcs.hold(10.0)
        start = place(server)
        gcs.sticks[5] = 1600
        gcs.hold(10.0)
        gcs.sticks[5] = Gcs.NEUTRAL
        north, east, _ = (a - b for a, b in zip(place(server), start, strict=True))
        print(f"{aid}, against 0.3 m/s at 1600 us: {north:.2f} m north, {east:.2f} m east in 10 s")
        assert north > 2.0
        assert abs(east) < north * math.tan(math.radians(30.0))


@pytest.mark.parametrize(("gain", "settle_s", "allowed"), [(3.0, 4.0, 0.75), (1.0, 8.0, 0.3)])
def test_it_keeps_its_height_over_ground(
    tmp_path: Path, gcs: Gcs, gain: float, settle_s: float, allowed: float
) -> None:
    """Surftrak: 0.3 m in 5 s of the height that it had when the stick was let go, with the ground in range; below that, of the depth.

    ArduPilot asks it 4 s after the stick. At its default gain this vehicle swings by up to 0.6 m then: ArduSub takes the range through a filter of
    0.25 Hz (0.64 s) from a height that it does not filter, so that what it takes for the ground moves with the vehicle by 0.64 s of its speed, and
    3 /s times that is more than its loop of speed takes away; drag alone damps it. At a gain of 1 /s it settles.
    """
    with diving(
        tmp_path, gcs, seabed='[seabed]\nkind = "flat"\ndepth_m = 50.0\n',
        params=f"RNGFND1_MAX 30\nSIM_BARO_RND 0.01\nPSC_POSZ_P {gain}\n",
    ) as server:  # fmt: skip
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        gcs.dive(-5.0, 1300)
        gcs.hold(3.0)
        with gcs.says("waiting for a rangefinder reading"):
            gcs.mode("SURFTRAK")
        kept(gcs, server, "out of range")
        for altitude in (-25.0, -30.0):
            with gcs.says("rangefinder target is"):
                gcs.dive(altitude, 1300)
                gcs.hold(settle_s)
            kept(gcs, server, f"gain {gain}, {gcs.last['RANGEFINDER'].distance:.1f} m over ground", allowed)
        gcs.disarm()
        gcs.hold(5.0)
        # ArduSub of May 2025, disarmed in SURFTRAK, forgets the ground but not its height over it: armed, it dives.
        gcs.mode("ALT_HOLD")
        gcs.arm()
        gcs.mode("SURFTRAK")
        gcs.hold(settle_s)
        kept(gcs, server, f"gain {gain}, armed again", allowed)


def test_it_follows_the_ground(tmp_path: Path, gcs: Gcs) -> None:
    """SimTerrainSurftrak: 15 m over a ridge of 8 m, and over ground that lies 10 m deeper behind it, always within 1.5 m, the stick at 1650 us.

    The ridge is a grid of depths here, and the range that of a beam of 25 degrees.
    """
    north = np.arange(-60.0, 100.0)
    profile = np.interp(north, (20.0, 40.0, 45.0, 75.0), (40.0, 32.0, 32.0, 44.0))
    np.save(tmp_path / "ridge.npy", np.repeat(profile[:, None], 81, axis=1))
    seabed = (
        '[seabed]\nkind = "grid"\nfile = "ridge.npy"\nspacing_m = [1.0, 1.0]\norigin_north_east_m = [-60.0, -40.0]\n'
    )
    with diving(tmp_path, gcs, seabed=seabed) as server:
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        steer(gcs, 0.0)
        gcs.dive(-25.0, 1300)
        gcs.hold(3.0)
        with gcs.says("rangefinder target is"):
            gcs.mode("SURFTRAK")
        gcs.hold(2.0)

        def height() -> float:
            n, _, down = place(server)
            return float(np.interp(n, north, profile)) - down

        begun, start, heights = gcs.time_s, place(server), [height()]
        gcs.sticks[5] = 1650
        while place(server)[0] < 85.0:
            heights += gcs.hold(1.0, height)
        gcs.sticks[5] = Gcs.NEUTRAL
        end = place(server)
        went, depths = math.dist(start[:2], end[:2]), f"{start[2]:.2f} to {end[2]:.2f} m"
        print(f"{went:.0f} m over the ridge in {gcs.time_s - begun:.0f} s, depth {depths}")
        print(f"height over ground {heights[0]:.2f} m, then {min(heights):.2f} to {max(heights):.2f} m")
        assert max(abs(now - heights[0]) for now in heights) < 1.5


def test_the_vehicle_with_six_thrusters(tmp_path: Path, gcs: Gcs) -> None:
    """FRAME_CONFIG 1, `vectored`, is `bluerov2`: depth within 0.3 m, the stick to the right turns it right, ahead is ahead.

    Nothing but 5 cm between its centres holds its pitch, and its horizontal thrusters push below them: it nods and stays upright.
    """
    with diving(tmp_path, gcs, model="bluerov2", frame=1) as server:
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        gcs.dive(-5.0, 1000)
        gcs.hold(SETTLE_S)
        kept(gcs, server, "six thrusters")
        before = gcs.heading
        gcs.sticks[4] = 1600
        gcs.hold(2.0)
        gcs.sticks[4] = Gcs.NEUTRAL
        gcs.hold(2.0)
        turned = (gcs.heading - before + 180.0) % 360.0 - 180.0
        true = math.degrees(yaw_of(server))
        print(f"six thrusters, yaw 1600 us for 2 s: {turned:+.1f} deg, heading {gcs.heading:.1f}, in truth {true:.1f}")
        assert 5.0 < turned < 170.0
        assert abs((true - gcs.heading + 180.0) % 360.0 - 180.0) < 5.0
        kept(gcs, server, "after turning")
        steer(gcs, 0.0)
        start = place(server)
        gcs.sticks[5] = 1700
        leaned = max(gcs.hold(10.0, lambda: abs(pitch_of(server))))
        north, east, _ = (a - b for a, b in zip(place(server), start, strict=True))
        print(
            f"six thrusters, ahead 1700 us: {north:.2f} m north, {east:.2f} m east in 10 s, pitch up to {leaned:.1f} deg"
        )
        assert north > 1.0
        assert abs(east) < 0.3 * north
        assert leaned < 20.0


def pitch_of(server: Server) -> float:
    w, x, y, z = server.last("rov/truth/pose")["q_NB"]
    return math.degrees(math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))))


@pytest.mark.parametrize("first", [1, 17])
def test_thirty_two_channels(tmp_path: Path, gcs: Gcs, first: int) -> None:
    """SERVO_32_ENABLE 1, packets of 72 bytes: motors on outputs 1 to 8, and on 17 to 24, which no shorter packet has."""
    here = range(first, first + 8)
    functions = dict.fromkeys(range(1, 9), 0) | {n: 33 + k for k, n in enumerate(here)}
    motors = "".join(f"SERVO{n}_FUNCTION {function}\n" for n, function in functions.items())
    adapter = f'[adapters.autopilot.outputs.thrusters]\nport = "thrusters"\nchannels = {list(here)}\n'
    with diving(tmp_path, gcs, params=f"SERVO_32_ENABLE 1\n{motors}", adapter=adapter) as server:
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        gcs.dive(-5.0, 1000)
        gcs.hold(SETTLE_S)
        kept(gcs, server, f"motors on outputs {first} to {first + 7}")
