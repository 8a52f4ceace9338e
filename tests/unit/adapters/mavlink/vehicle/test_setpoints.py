"""Set points of a companion computer: frames, masks, modes, and numbers that are none."""

from __future__ import annotations

import math

import pytest

POSITION, VELOCITY, POS_VEL, YAW = 0xDF8, 0xDC7, 0xDC0, 0x9FF


def local(station, mask, frame=1, p=(0, 0, 0), v=(0, 0, 0), yaw=0.0, rate=0.0):
    station.send("SET_POSITION_TARGET_LOCAL_NED", 0, 1, 1, frame, mask, *p, *v, 0, 0, 0, yaw, rate)


@pytest.fixture
def guided(bench):
    bench.rov.state |= {
        "mode": "guided",
        "q_NB": (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)),
    }  # heading east
    bench.run(0.1)
    return bench


@pytest.mark.parametrize(
    ("frame", "p", "p_N"),
    [
        (1, (3, 4, 6), (3, 4, 6)),
        (7, (3, 4, 6), (4, 6, 11)),
        (8, (3, 4, 6), (-3, 5, 11)),
        (9, (3, 4, 6), (-3, 5, 11)),
        (12, (3, 4, 6), (-3, 5, 11)),
    ],
)
@pytest.mark.parametrize("mask", [POSITION, POS_VEL])
def test_positions(guided, frame, p, p_N, mask):
    local(guided.station(), mask, frame, p=p)
    assert guided.rov.commanded("position")[-1]["p_N"] == pytest.approx(p_N)


@pytest.mark.parametrize(
    ("frame", "v", "v_N"), [(1, (0.5, 0.1, 0.2), (0.5, 0.1, 0.2)), (8, (0.5, 0.1, 0.2), (-0.1, 0.5, 0.2))]
)
def test_velocities(guided, frame, v, v_N):
    local(guided.station(), VELOCITY, frame, v=v)
    assert guided.rov.commanded("velocity")[-1]["v_N"] == pytest.approx(v_N)
    local(guided.station(), VELOCITY & ~0x800, frame, v=v, rate=0.3)
    assert guided.rov.commanded("velocity")[-1]["yaw_rate"] == pytest.approx((0.3,))


def test_yaw(guided):
    local(guided.station(), YAW, yaw=0.5)
    assert guided.rov.commanded("heading")[-1]["heading"] == pytest.approx((0.5,))
    local(guided.station(), YAW, frame=8, yaw=0.5)
    assert guided.rov.commanded("heading")[-1]["heading"] == pytest.approx((0.5 + math.pi / 2,))
    local(guided.station(), POSITION & ~0x400, p=(1, 1, 1), yaw=1.0)
    assert guided.rov.commanded("position")[-1]["heading"] == pytest.approx((1.0,))


def test_a_change_of_depth_as_ground_stations_send_it(guided):
    """QGroundControl 0xFFF8, Cockpit 0xFF8: with the bit for a force, of which there is none."""
    station = guided.station()
    for mask in (0xFFF8, 0xFF8):
        local(station, mask, frame=7, p=(0.0, 0.0, 2.0))
    gone = [told["p_N"] for told in guided.rov.commanded("position")]
    x, y, z = guided.vehicle.bridge.readings.state().p_N
    assert gone == [pytest.approx((x, y, z + 2.0))] * 2


@pytest.mark.parametrize(
    ("mask", "more"),
    [
        (POSITION, {"p": (math.nan, 0, 0)}),
        (VELOCITY, {"v": (math.inf, 0, 0)}),
        (POSITION & ~0x400, {"yaw": math.nan}),
        (POSITION, {"frame": 2}),
        (POSITION & ~0x1C0, {}),
        (POSITION & ~0x1C0 | 0x200, {}),
        (0xFFF, {}),
    ],
)
def test_what_cannot_be_followed_is_told_and_changes_nothing(guided, mask, more):
    station = guided.station()
    local(station, mask, **more)
    local(station, mask, **more)
    assert not guided.rov.commands
    assert guided.counters["refused"] == 2
    assert len(station.texts()) == 1


def test_only_in_guided(bench):
    station = bench.station()
    local(station, POSITION, p=(3, 4, 6))
    station.send("SET_ATTITUDE_TARGET", 0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 0.5)
    assert not bench.rov.commands
    assert station.texts() == ["set points are followed in GUIDED only"]


async def test_a_set_point_right_after_the_acknowledgement_of_its_mode(bench):
    """The autopilot tells its state some times a second only; who was told ACCEPTED goes on at once."""
    station = bench.station()
    bench.run(1.0)
    bench.rov.state_of = (bench.rov.tick * 4_000_000, dict(bench.rov.state))  # what it said before
    assert await station.command(176, 1.0, 4.0) == 0
    local(station, POSITION, p=(3, 4, 6))
    assert len(bench.rov.commanded("position")) == 1
    assert await station.command(400, 1.0) == 0
    assert bench.vehicle.bridge.readings.state().armed
    bench.rov.state |= {"mode": "manual", "armed": False}
    bench.rov.state_of = None
    bench.run(0.1)
    assert (bench.vehicle.bridge.readings.state().mode, bench.vehicle.bridge.readings.state().armed) == (
        "manual",
        False,
    )
    local(station, POSITION, p=(3, 4, 6))
    assert len(bench.rov.commanded("position")) == 1


def test_a_far_position_is_refused_by_the_world_and_told(guided):
    station = guided.station()
    local(station, POSITION, p=(1e9, 0, 0))
    assert any("p_N" in text for text in station.texts())


def geodetic(station, mask, frame, lat, lon, alt):
    station.send("SET_POSITION_TARGET_GLOBAL_INT", 0, 1, 1, frame, mask, lat, lon, alt, *(0,) * 8)


def test_geodetic_positions(guided):
    home = guided.vehicle.bridge.home.origin
    lat, lon = (round(math.degrees(a) * 1e7) for a in home.geodetic(100.0, -50.0))
    geodetic(guided.station(), POSITION, 6, lat, lon, -7.5)
    assert guided.rov.commanded("position")[-1]["p_N"] == pytest.approx((100.0, -50.0, 7.5), abs=0.02)


def test_in_alt_hold_the_altitude_is_the_depth_to_hold(bench):
    bench.rov.state["mode"] = "depth_hold"
    bench.run(0.1)
    station = bench.station()
    geodetic(station, POSITION, 0, 0, 0, -12.5)
    assert bench.rov.commanded("depth") == [{"depth": (12.5,)}]
    geodetic(station, POSITION, 0, 0, 0, math.nan)
    geodetic(station, POSITION, 11, 0, 0, -3.0)
    assert len(bench.rov.commands) == 1


def test_attitude(guided):
    station = guided.station()
    q = (math.cos(0.1), math.sin(0.1), 0.0, 0.0)
    station.send("SET_ATTITUDE_TARGET", 0, 1, 1, 7, q, 0, 0, 0, 0.5)
    value = guided.rov.commanded("attitude")[-1]
    assert value["q_NB"] == pytest.approx(q, abs=1e-6)
    assert value["heave"] == pytest.approx((0.0,))
    station.send("SET_ATTITUDE_TARGET", 0, 1, 1, 7, q, 0, 0, 0, 1.0)
    assert guided.rov.commanded("attitude")[-1]["heave"] == pytest.approx((-1.0,))
    station.send("SET_ATTITUDE_TARGET", 0, 1, 1, 0x80 | 0x3, q, 0, 0, 0.2, 0.5)
    assert guided.rov.commanded("heading")[-1]["rate"] == pytest.approx((0.2,))
    count = len(guided.rov.commands)
    station.send("SET_ATTITUDE_TARGET", 0, 1, 1, 7, [0, 0, 0, 0], 0, 0, 0, 0.5)
    station.send("SET_ATTITUDE_TARGET", 0, 1, 1, 7, q, 0, 0, 0, math.nan)
    assert len(guided.rov.commands) == count
