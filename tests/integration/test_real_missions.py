"""A real ArduSub goes where it is told: missions and set points, as ArduPilot's own autotests have them, with their numbers.

Opt-in, see `ground_station`; the vehicle, and its pace, are those of `test_real_dives`.
"""

from __future__ import annotations

import math
from pathlib import Path

from autopilot_server import Server
from ground_station import (
    ABOVE_GROUND,
    ABOVE_HOME,
    HOME,
    Gcs,
    Items,
    autotest,
    degrees_at,
    diving,
    needs_ardusub,
    place,
    yaw_of,
)

pytestmark = needs_ardusub


def mission_of(file: Path) -> Items:
    """A file of waypoints ("QGC WPL 110")."""
    items = []
    for line in file.read_text().splitlines()[1:]:
        if line.strip() and not line.startswith("#"):
            _, _, frame, command, *numbers = line.split()
            a, b, c, d, lat, lon, alt = map(float, numbers[:7])
            items.append((int(frame), int(command), (a, b, c, d), lat, lon, alt))
    return items


def off_track(server: Server, lat: float, lon: float, altitude: float) -> float:
    """True distance from a place, m."""
    north, east, down = place(server)
    per_degree = 111318.84502145034
    there = (lat - HOME[0]) * per_degree, (lon - HOME[1]) * per_degree * math.cos(math.radians(HOME[0]))
    return math.dist((north, east, down), (*there, -altitude))


def set_off(gcs: Gcs, items: Items) -> float:
    """Fly these items from now on; the autopilot's time, s."""
    gcs.locate()
    gcs.upload(items)
    gcs.mode("ALT_HOLD")
    gcs.arm()
    gcs.mode("AUTO")
    return gcs.time_s


def test_it_dives_a_mission(tmp_path: Path, gcs: Gcs) -> None:
    """DiveMission: ArduPilot's own file to waypoint 5, 160 m of square at 50 m of depth, then a circle of 50 m; each within 5 m."""
    items = mission_of(autotest() / "ArduSub_Tests/DiveMission/sub_mission.txt")
    with diving(tmp_path, gcs) as server:
        begun = set_off(gcs, items)
        for number in (1, 2, 3):
            gcs.until(lambda: number in gcs.reached, f"waypoint {number}", 180)  # noqa: B023
            error = off_track(server, *items[number][3:])
            print(f"waypoint {number} after {gcs.time_s - begun:.0f} s, {error:.2f} m off")
            assert error < 5.0
        gcs.until(lambda: gcs.last["MISSION_CURRENT"].seq >= 5, "waypoint 5 is next", 300)
        print(f"waypoint 5 is next after {gcs.time_s - begun:.0f} s")


def test_it_dives_a_mission_over_ground(tmp_path: Path, gcs: Gcs) -> None:
    """TerrainMission: ArduPilot's own file down to 25 m of depth, then at heights over ground; 15 m of them at the end, 50 m deep, within 1 m."""
    items = mission_of(autotest() / "ArduSub_Tests/TerrainMission/terrain_mission.txt")
    seabed = '[seabed]\nkind = "flat"\ndepth_m = 50.0\n'
    with diving(tmp_path, gcs, seabed=seabed, params="RNGFND1_MAX 30\n") as server:
        begun = set_off(gcs, items)
        for number in (1, 2, 3, 4):
            gcs.until(lambda: number in gcs.reached, f"waypoint {number}", 180)  # noqa: B023
            _, _, down = place(server)
            error = off_track(server, *items[number][3:5], -down)
            print(
                f"waypoint {number} after {gcs.time_s - begun:.0f} s: {error:.2f} m off, {50.0 - down:.2f} m over ground"
            )
            assert error < 5.0
        gcs.hold(3.0)
        print(f"3 s later {50.0 - place(server)[2]:.2f} m over ground")
        assert abs(place(server)[2] - 35.0) < 1.0


def test_it_turns_as_it_is_told(tmp_path: Path, gcs: Gcs) -> None:
    """MAV_CMD_CONDITION_YAW in GUIDED: 5, 30, 60, 10 and 0 degrees, then 20 on from there; within 5 degrees for 2 s, in truth 7."""

    def off(heading: float, goal: float) -> float:
        return abs((heading - goal + 180.0) % 360.0 - 180.0)

    with diving(tmp_path, gcs) as server:
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        gcs.dive(-2.0, 1300)
        gcs.mode("GUIDED")
        for angle, goal, relative in ((5, 5, 0), (30, 30, 0), (60, 60, 0), (10, 10, 0), (0, 0, 0), (20, 20, 1)):
            gcs.command(115, angle, 10.0, 1.0, relative)
            begun = arrived = gcs.time_s
            while gcs.time_s < arrived + 2.0:
                gcs.turn()
                if off(gcs.heading, goal) > 5.0:
                    arrived = gcs.time_s
                assert gcs.time_s < begun + 60.0, f"heading {gcs.heading:.1f}, not {goal}"
            true = off(math.degrees(yaw_of(server)), goal)
            print(
                f"heading {goal}: there for good after {arrived - begun:.1f} s, in truth {true:.1f} deg off 2 s later"
            )
            assert true < 7.0


def test_it_goes_where_it_is_told(tmp_path: Path, gcs: Gcs) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT in GUIDED: more than 10 m within 200 s; DO_REPOSITION, over home and over ground: within 5 m in 120 s."""
    with diving(tmp_path, gcs, seabed='[seabed]\nkind = "flat"\ndepth_m = 50.0\n') as server:
        gcs.locate()
        gcs.mode("ALT_HOLD")
        gcs.arm()
        gcs.mode("GUIDED")

        def goes(
            what: str, frame: int, north: float, east: float, altitude: float, depth: float, within: float
        ) -> None:
            lat, lon = degrees_at(north, east)
            where = round(lat * 1e7), round(lon * 1e7), altitude
            if what == "DO_REPOSITION":
                gcs.accepted(gcs.mav.command_int_encode(1, 1, frame, 192, 0, 0, 0, 0, 0, 0, *where), 192)
            else:
                gcs.send(
                    gcs.mav.set_position_target_global_int_encode(
                        0, 1, 1, frame, 0b1111111111111000, *where, *[0.0] * 8
                    )
                )
            begun = gcs.time_s
            gcs.until(lambda: math.dist(place(server), (north, east, depth)) < 0.5, f"{what} to {where}", 120)
            took = gcs.time_s - begun
            gcs.hold(10.0)
            error = math.dist(place(server), (north, east, depth))
            print(f"{what}: within 0.5 m after {took:.0f} s, {error:.2f} m off 10 s later")
            assert took < within
            assert error < 1.0

        goes("SET_POSITION_TARGET_GLOBAL_INT", ABOVE_HOME, 8.0, 9.0, -10.0, 10.0, 200.0)
        goes("DO_REPOSITION", ABOVE_HOME, 18.0, 19.0, -25.0, 25.0, 120.0)
        goes("DO_REPOSITION", ABOVE_GROUND, 28.0, 29.0, 22.0, 28.0, 120.0)
