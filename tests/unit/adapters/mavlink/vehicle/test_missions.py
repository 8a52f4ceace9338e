"""Missions: upload, what is refused, download, progress, and two stations at once."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from uwserver_adapters.mavlink.vehicle.bridge import Home
from uwserver_adapters.mavlink.vehicle.missions import Missions

ACCEPTED, ERROR, BAD_FRAME, UNSUPPORTED, NO_SPACE, INVALID = 0, 1, 2, 3, 4, 5
WAYPOINT, LOITER_TIME, RTL, LAND, DELAY, SPEED, YAW, SERVO = 16, 19, 20, 21, 93, 178, 115, 183
HOME = (0, WAYPOINT, (0.0,) * 4, 634_400_000, 103_900_000, 0.0)


def item(
    station: Any, seq: int, frame: int, command: int, p: tuple[float, ...], x: int, y: int, z: float, kind: int = 0
) -> None:
    station.send("MISSION_ITEM_INT", 1, 1, seq, frame, command, 0, 1, *p, x, y, z, kind)


async def upload(bench: Any, station: Any, items: list[tuple[Any, ...]], kind: int = 0) -> int:
    """As a ground station does it: an item whenever one is asked for. The acknowledgement."""
    acks, asked = len(station.of("MISSION_ACK")), len(station.of("MISSION_REQUEST_INT"))
    station.send("MISSION_COUNT", 1, 1, len(items), kind)
    for _ in range(3 * len(items) + 3):
        requests = station.of("MISSION_REQUEST_INT")[asked:]
        asked += len(requests)
        for request in requests:
            frame, command, p, x, y, z = items[request.seq]
            item(station, request.seq, frame, command, p, x, y, z, kind)
        await asyncio.sleep(0)
        if len(station.of("MISSION_ACK")) > acks:
            break
    return int(station.last("MISSION_ACK").type)


def place(bench: Any, north: float, east: float) -> tuple[int, int]:
    return tuple(round(math.degrees(a) * 1e7) for a in bench.vehicle.bridge.home.origin.geodetic(north, east))  # type: ignore[return-value]


async def test_every_supported_item(bench):
    station = bench.station()
    x, y = place(bench, 20.0, 30.0)
    items = [
        HOME,
        (3, WAYPOINT, (5.0, 2.0, 0.0, 90.0), x, y, -8.0),
        (1, WAYPOINT, (0.0, 0.0, 0.0, math.nan), 15_000, -25_000, 4.0),
        (6, LOITER_TIME, (60.0, 0.0, 0.0, 0.0), x, y, -3.0),
        (2, DELAY, (7.0, -1.0, -1.0, -1.0), 0, 0, 0.0),
        (2, SPEED, (1.0, 0.7, -1.0, 0.0), 0, 0, 0.0),
        (2, YAW, (45.0, 0.0, 0.0, 0.0), 0, 0, 0.0),
        (3, RTL, (0.0,) * 4, 0, 0, 0.0),
        (3, LAND, (0.0,) * 4, 0, 0, 0.0),
    ]
    assert await upload(bench, station, items) == ACCEPTED
    first, second, third, *rest = bench.rov.items
    assert first["position_ned_m"] == pytest.approx([20.0, 30.0, 8.0], abs=0.02)
    assert (first["hold_s"], first["radius_m"], first["heading_deg"]) == (5.0, 2.0, 90.0)
    assert second == {"kind": "waypoint", "position_ned_m": [1.5, -2.5, 4.0]}
    assert third["hold_s"] == 60.0
    assert rest[0] == {"kind": "hold", "time_s": 7.0}
    assert rest[1] == {"kind": "speed", "speed_mps": pytest.approx(0.7)}
    assert rest[2] == {"kind": "heading", "heading_deg": 45.0}
    assert rest[3]["position_ned_m"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert rest[4] == {"kind": "surface"}


@pytest.mark.parametrize(
    ("current", "mode", "command", "z", "result", "down"),
    [
        (2, "guided", WAYPOINT, -8.0, ACCEPTED, 8.0),
        (3, "guided", WAYPOINT, -6.0, ACCEPTED, 6.0),
        (2, "manual", WAYPOINT, -8.0, ERROR, None),
        (2, "guided", LAND, -8.0, ERROR, None),
        (2, "guided", WAYPOINT, math.nan, 10, None),
    ],
)
async def test_go_to_location(bench, current, mode, command, z, result, down):
    """As QGroundControl sends a submarine somewhere: an item of no mission."""
    station = bench.station()
    bench.rov.state |= {"mode": mode, "p_N": (1.0, 2.0, 5.0), "position_valid": True, "p_ref_N": None}
    x, y = place(bench, 20.0, 30.0)
    station.send("MISSION_ITEM", 1, 1, 0, 3, command, current, 1, 0.0, 0.0, 0.0, 0.0, x * 1e-7, y * 1e-7, z, 0)
    await asyncio.sleep(0)
    assert int(station.last("MISSION_ACK").type) == result
    gone = [told["p_N"] for told in bench.rov.commanded("position")]
    there = (20.0, 30.0) if current == 2 else (1.0, 2.0)
    assert gone == ([] if down is None else [pytest.approx((*there, down), abs=1.0)])  # floats hold a metre
    assert not station.of("MISSION_REQUEST_INT")


async def test_to_a_height_without_a_position_it_goes_nowhere(bench):
    station = bench.station()
    bench.rov.state |= {"mode": "guided", "position_valid": False}
    station.send("MISSION_ITEM", 1, 1, 0, 3, WAYPOINT, 3, 1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -6.0, 0)
    await asyncio.sleep(0)
    assert int(station.last("MISSION_ACK").type) == ERROR
    assert not bench.rov.commanded("position")
    assert bench.counters["refused"] == 1


async def test_a_take_off_is_left_out_and_told(bench):
    """QGroundControl lets nobody plan a mission without one."""
    station = bench.station()
    x, y = place(bench, 20.0, 30.0)
    items = [HOME, (3, 22, (0.0,) * 4, x, y, 50.0), (3, WAYPOINT, (0.0,) * 4, x, y, -8.0)]
    assert await upload(bench, station, items) == ACCEPTED
    assert [item["kind"] for item in bench.rov.items] == ["waypoint"]
    assert "Mission: the take-off is left out" in [m.text for m in station.of("STATUSTEXT")]
    bench.rov.state |= {"mode": "mission", "mission_index": 0, "mission_count": 1}
    bench.run(1.0)
    assert station.last("MISSION_CURRENT").seq == 2


@pytest.mark.parametrize("nowhere", [0.0, math.nan, 999.0, -999.0])
async def test_a_heading_of_no_compass_is_none(bench, nowhere):
    """Cockpit puts 999 into the heading of each waypoint."""
    station = bench.station()
    x, y = place(bench, 20.0, 30.0)
    assert await upload(bench, station, [HOME, (3, WAYPOINT, (0.0, 5.0, 0.0, nowhere), x, y, -8.0)]) == ACCEPTED
    assert "heading_deg" not in bench.rov.items[0]


@pytest.mark.parametrize("frame", [10, 11])
async def test_in_a_frame_of_the_terrain_the_altitude_is_one_above_the_bottom(bench, frame):
    station = bench.station()
    x, y = place(bench, 20.0, 30.0)
    items = [HOME, (frame, WAYPOINT, (5.0, 2.0, 0.0, math.nan), x, y, 4.5), (3, WAYPOINT, (0.0,) * 4, x, y, -8.0)]
    assert await upload(bench, station, items) == ACCEPTED
    first, second = bench.rov.items
    assert first == {
        "kind": "waypoint", "position_ne_m": pytest.approx([20.0, 30.0], abs=0.02), "altitude_m": 4.5, "radius_m": 2.0, "hold_s": 5.0,
    }  # fmt: skip
    assert second["position_ned_m"][2] == 8.0
    bench.run(0.1)
    station.send("MISSION_REQUEST_INT", 1, 1, 1, 0)
    told = station.last("MISSION_ITEM_INT")
    assert (told.frame, told.x, told.y, told.z) == (frame, x, y, 4.5)


async def test_an_altitude_that_the_vehicle_cannot_keep_is_refused_with_the_number_of_the_station(bench):
    """The autopilot's items are those without home and take-off."""
    bench.rov.refusal = "item 1: altitude_m needs a sensor"
    station = bench.station()
    x, y = place(bench, 20.0, 30.0)
    level, terrain = (3, WAYPOINT, (0.0,) * 4, x, y, -8.0), (10, WAYPOINT, (0.0,) * 4, x, y, 5.0)
    assert await upload(bench, station, [HOME, (3, 22, (0.0,) * 4, x, y, 50.0), level, terrain]) == INVALID
    assert "Mission refused: item 3: altitude_m needs a sensor" in station.texts()
    assert not bench.rov.items


@pytest.mark.parametrize("origin", [(63.44, 10.39), None])
async def test_altitudes_and_depths_that_came_another_way_are_told(make_bench, origin):
    bench = make_bench(origin_deg=origin)
    bench.rov._set_mission({"items": [
        {"kind": "waypoint", "position_ne_m": [5.0, 6.0], "altitude_m": 3.0}, {"kind": "waypoint", "position_ne_m": [5.0, 6.0], "depth_m": 7.0},
    ]})  # fmt: skip
    bench.run(0.1)
    station = bench.station()
    station.send("MISSION_REQUEST_LIST", 1, 1, 0)
    await asyncio.sleep(0.01)
    found = []
    for seq in (1, 2):
        station.send("MISSION_REQUEST_INT", 1, 1, seq, 0)
        told = station.last("MISSION_ITEM_INT")
        found += [told.frame, told.z]
    assert found == ([10, 3.0, 0, -7.0] if origin else [1, pytest.approx(math.nan, nan_ok=True), 1, 7.0])


async def test_the_download_tells_what_was_uploaded(bench):
    station, other = bench.station(), bench.station(254)
    x, y = place(bench, 20.0, 30.0)
    items = [HOME, (3, WAYPOINT, (5.0, 2.0, 0.0, 90.0), x, y, -8.0), (2, DELAY, (7.0, -1.0, -1.0, -1.0), 0, 0, 0.0)]
    assert await upload(bench, station, items) == ACCEPTED
    bench.run(0.1)
    other.send("MISSION_REQUEST_LIST", 1, 1, 0)
    await asyncio.sleep(0)
    assert other.last("MISSION_COUNT").count == 3
    for seq, (frame, command, p, x, y, z) in enumerate(items):
        other.send("MISSION_REQUEST_INT", 1, 1, seq, 0)
        told = other.last("MISSION_ITEM_INT")
        assert (told.seq, told.frame, told.command, told.x, told.y, told.z) == (seq, frame, command, x, y, z)
        assert (told.param1, told.param2, told.param3, told.param4) == p
    other.send("MISSION_REQUEST", 1, 1, 1, 0)
    assert other.last("MISSION_ITEM").x == pytest.approx(items[1][3] / 1e7, abs=1e-5)
    other.send("MISSION_REQUEST_INT", 1, 1, 3, 0)
    assert other.last("MISSION_ACK").type == 13


async def test_what_comes_down_at_once_is_what_went_up(bench):
    """The autopilot's state is sampled: right after an upload it still tells of the mission before."""
    station = bench.station()
    x, y = place(bench, 20.0, 30.0)
    for heading in (math.nan, 45.0):
        items = [
            HOME, (6, WAYPOINT, (0.0, 1.0, 0.0, heading), x, y, -5.0), (2, SPEED, (1.0, 0.5, -1.0, math.nan), 0, 0, math.nan),
            (3, WAYPOINT, (0.0, 1.0, 0.0, heading), x, y, -8.0),
        ]  # fmt: skip
        assert await upload(bench, station, items) == ACCEPTED
        station.send("MISSION_REQUEST_LIST", 1, 1, 0)
        await asyncio.sleep(0)
        assert station.last("MISSION_COUNT").count == 4
        for seq, (frame, command, p, *there) in enumerate(items):
            station.send("MISSION_REQUEST_INT", 1, 1, seq, 0)
            told = station.last("MISSION_ITEM_INT")
            assert (told.seq, told.frame, told.command) == (seq, frame, command)
            assert [told.param1, told.param2, told.param3, told.param4] == pytest.approx(p, nan_ok=True)
            assert [told.x, told.y, told.z] == pytest.approx(there, nan_ok=True)


async def test_a_mission_of_somebody_else_of_the_same_length_comes_down(bench):
    station = bench.station()
    assert await upload(bench, station, [HOME, (1, WAYPOINT, (0.0,) * 4, 10_000, 0, 2.0)]) == ACCEPTED
    bench.rov._set_mission({"items": [{"kind": "waypoint", "position_ned_m": [9.0, 0.0, 2.0]}]})
    station.send("MISSION_REQUEST_LIST", 1, 1, 0)
    await asyncio.sleep(0)
    station.send("MISSION_REQUEST_INT", 1, 1, 1, 0)
    told = station.last("MISSION_ITEM_INT")
    assert told.x == pytest.approx(place(bench, 9.0, 0.0)[0], abs=2)


@pytest.mark.parametrize(
    ("bad", "result"),
    [
        ((3, SERVO, (9.0, 1500.0, 0.0, 0.0), 0, 0, 0.0), UNSUPPORTED),
        ((3, 24, (0.0,) * 4, 0, 0, 0.0), UNSUPPORTED),
        ((10, WAYPOINT, (0.0,) * 4, 634_400_000, 103_900_000, -5.0), 12),
        ((11, WAYPOINT, (0.0,) * 4, 634_400_000, 103_900_000, 0.0), 12),
        ((11, WAYPOINT, (0.0,) * 4, 950_000_000, 0, 5.0), 10),
        ((7, WAYPOINT, (0.0,) * 4, 634_400_000, 103_900_000, -5.0), BAD_FRAME),
        ((8, WAYPOINT, (0.0,) * 4, 0, 0, -5.0), BAD_FRAME),
        ((3, WAYPOINT, (0.0,) * 4, 950_000_000, 0, -5.0), 10),
        ((3, WAYPOINT, (0.0,) * 4, 0, 0, math.nan), 10),
        ((2, DELAY, (-1.0, 0.0, 0.0, 0.0), 0, 0, 0.0), 6),
        ((2, SPEED, (1.0, 0.0, 0.0, 0.0), 0, 0, 0.0), 7),
        ((2, YAW, (math.nan, 0.0, 0.0, 0.0), 0, 0, 0.0), 6),
    ],
)
async def test_what_the_vehicle_cannot_do_is_refused_and_nothing_changes(bench, bad, result):
    station = bench.station()
    good = [HOME, (1, WAYPOINT, (0.0,) * 4, 10_000, 0, 2.0)]
    assert await upload(bench, station, good) == ACCEPTED
    before = list(bench.rov.items)
    assert await upload(bench, station, [HOME, good[1], bad, good[1]]) == result
    assert bench.rov.items == before
    assert any("item 2" in text for text in station.texts())
    bench.run(10.0)
    assert not [m for m in station.of("MISSION_ACK") if m.type == 15]  # the upload is over


async def test_an_upload_that_stops_is_asked_for_and_given_up(bench):
    station = bench.station()
    station.send("MISSION_COUNT", 1, 1, 3, 0)
    bench.run(7.5)
    assert 6 <= len(station.of("MISSION_REQUEST_INT")) <= 8
    bench.run(1.5)
    assert station.last("MISSION_ACK").type == 15
    assert "Mission upload timeout" in station.texts()


async def test_items_twice_or_out_of_turn(bench):
    station = bench.station()
    good = [HOME, (1, WAYPOINT, (0.0,) * 4, 10_000, 0, 2.0)]
    station.send("MISSION_COUNT", 1, 1, 2, 0)
    item(station, 1, *good[1])
    assert station.last("MISSION_REQUEST_INT").seq == 0
    item(station, 0, *HOME)
    item(station, 0, *HOME)
    item(station, 1, *good[1])
    await asyncio.sleep(0.01)
    assert station.last("MISSION_ACK").type == ACCEPTED
    item(station, 1, *good[1])
    assert station.last("MISSION_ACK").type == 13
    station.send("MISSION_ITEM", 1, 1, 0, 3, WAYPOINT, 0, 1, 0, 0, 0, 0, 63.4, 10.3, 0, 0)
    assert len(bench.rov.items) == 1


async def test_another_station_must_wait(bench):
    a, b = bench.station(255), bench.station(254)
    a.send("MISSION_COUNT", 1, 1, 3, 0)
    b.send("MISSION_COUNT", 1, 1, 3, 0)
    assert b.last("MISSION_ACK").type == 14
    assert not a.of("MISSION_ACK")
    bench.router.close(a.channel)
    b.send("MISSION_COUNT", 1, 1, 3, 0)
    assert b.of("MISSION_REQUEST_INT")


async def test_fences_and_rally_points_there_are_none(bench):
    station = bench.station()
    for kind in (1, 2):
        station.send("MISSION_REQUEST_LIST", 1, 1, kind)
        assert (station.last("MISSION_COUNT").count, station.last("MISSION_COUNT").mission_type) == (0, kind)
        assert await upload(bench, station, [], kind) == ACCEPTED
        station.send("MISSION_COUNT", 1, 1, 4, kind)
        assert station.last("MISSION_ACK").type == UNSUPPORTED
        station.send("MISSION_CLEAR_ALL", 1, 1, kind)
        assert station.last("MISSION_ACK").type == ACCEPTED
    station.send("MISSION_COUNT", 1, 1, 60_000, 0)
    assert station.last("MISSION_ACK").type == NO_SPACE


async def test_it_runs_and_tells_how_far_it_is(bench):
    station, state = bench.station(), bench.rov.state
    leg = (1, WAYPOINT, (0.0,) * 4, 10_000, 0, 2.0)
    assert await upload(bench, station, [HOME, leg, leg, leg]) == ACCEPTED
    assert await station.command(300) == 4  # not armed
    state["armed"] = True
    bench.run(0.1)
    assert await station.command(300) == 0
    bench.run(1.0)
    assert station.last("HEARTBEAT").custom_mode == 3
    current = station.last("MISSION_CURRENT")
    assert (current.seq, current.total, current.mission_state) == (1, 3, 3)
    state |= {"mission_index": 2, "reached": 2}
    bench.run(1.0)
    assert [m.seq for m in station.of("MISSION_ITEM_REACHED")] == [1, 2]
    assert station.last("MISSION_CURRENT").seq == 3
    station.send("MISSION_SET_CURRENT", 1, 1, 2)
    assert bench.rov.calls[-1].args["index"] == 1
    assert await station.command(224, 9.0) == 4
    station.send("MISSION_CLEAR_ALL", 1, 1, 0)
    await asyncio.sleep(0.01)
    assert station.last("MISSION_ACK").type == ACCEPTED
    assert not bench.rov.items


async def test_a_mission_that_came_another_way_is_told(bench):
    bench.rov._set_mission({"items": [
        {"kind": "waypoint", "position_ned_m": [5.0, 6.0, 7.0], "radius_m": 2.0}, {"kind": "hold", "time_s": 3.0},
        {"kind": "speed", "speed_mps": 0.5}, {"kind": "heading", "heading_deg": 10.0}, {"kind": "surface"}]})  # fmt: skip
    bench.run(0.1)
    station = bench.station()
    station.send("MISSION_REQUEST_LIST", 1, 1, 0)
    await asyncio.sleep(0.01)
    assert station.last("MISSION_COUNT").count == 6
    found = []
    for seq in range(1, 6):
        station.send("MISSION_REQUEST_INT", 1, 1, seq, 0)
        told = station.last("MISSION_ITEM_INT")
        found.append((told.command, told.param1, told.param2))
    assert found == [(16, 0.0, 2.0), (93, 3.0, -1.0), (178, 0.0, 0.5), (115, 10.0, 0.0), (21, 0.0, 0.0)]
    station.send("MISSION_REQUEST_INT", 1, 1, 1, 0)
    told = station.last("MISSION_ITEM_INT")
    assert (told.x, told.y) == place(bench, 5.0, 6.0)
    assert told.z == -7.0


async def test_a_mission_is_translated_item_by_item(make_bench, monkeypatch):
    """Seven hundred at once took 2.5 ms of the loop, when the last had come, and 3 ms for a download."""
    at_once, calls = [0], [0]
    take = Missions.take

    def counted(method):
        return lambda *args: (calls.__setitem__(0, calls[0] + 1), method(*args))[1]

    def taken(*args):
        calls[0] = 0
        take(*args)
        at_once.append(calls[0])

    monkeypatch.setattr(Missions, "take", taken)
    monkeypatch.setattr(Home, "point", counted(Home.point))
    monkeypatch.setattr(Home, "place", counted(Home.place))
    bench = make_bench()
    station = bench.station()
    x, y = place(bench, 20.0, 30.0)
    assert (
        await upload(bench, station, [HOME] + [(3, WAYPOINT, (0.0,) * 4, x + k, y, -8.0) for k in range(50)])
        == ACCEPTED
    )
    assert len(bench.rov.items) == 50
    assert max(at_once) == 1
    bench.rov._set_mission({"items": [{"kind": "waypoint", "position_ned_m": [5.0, 6.0, float(k)]} for k in range(40)]})
    bench.run(0.1)
    calls[0] = 0
    station.send("MISSION_REQUEST_LIST", 1, 1, 0)
    await asyncio.sleep(0.01)
    assert station.last("MISSION_COUNT").count == 41
    assert calls[0] == 0
    for _ in range(2):
        station.send("MISSION_REQUEST_INT", 1, 1, 40, 0)
        assert station.last("MISSION_ITEM_INT").z == -39.0
    assert calls[0] == 1


async def test_without_an_origin_only_local_places(make_bench):
    bench = make_bench(origin_deg=None)
    station = bench.station()
    assert await upload(bench, station, [HOME, (3, WAYPOINT, (0.0,) * 4, 634_400_000, 103_900_000, -5.0)]) == INVALID
    assert any("SET_GPS_GLOBAL_ORIGIN" in text for text in station.texts())
    assert await upload(bench, station, [HOME, (1, WAYPOINT, (0.0,) * 4, 10_000, 0, 2.0)]) == ACCEPTED


async def test_without_an_autopilot(make_bench):
    bench = make_bench(has_autopilot=False)
    station = bench.station()
    assert await upload(bench, station, [HOME, (1, WAYPOINT, (0.0,) * 4, 10_000, 0, 2.0)]) == ERROR
    station.send("MISSION_REQUEST_LIST", 1, 1, 0)
    assert station.last("MISSION_COUNT").count == 0
