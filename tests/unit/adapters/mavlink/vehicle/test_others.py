"""Other systems on the links lead external vehicles."""

from __future__ import annotations

import math

import pytest

from uwserver.frames import quat_from_rpy
from uwserver.ports import Port
from uwserver.world.external.motion import LiveMotion, ShownActuator
from uwserver.world.external.pose_source import LivePoses

LAT, LON = 630_000_000, 100_000_000
EAST = quat_from_rpy(0.0, 0.0, math.pi / 2)
POSE = Port("ghost/pose", "actuator", "pose", LivePoses.fields, LivePoses.doc, message="FollowedPose")


@pytest.fixture
def others(make_bench):
    bench = make_bench(externals={"ghost": 7}, origin_deg=(63.0, 10.0))
    bench.rov.ports = {**bench.rov.ports, POSE.path: POSE}
    return bench


def commanded(bench) -> list[dict[str, tuple[float, ...]]]:
    names = [field.name for field in POSE.fields]
    found = [c.value for c in bench.rov.commands if c.port == POSE.path]
    return [{n: v for n, v in zip(names, value, strict=True) if v is not None} for value in found]


def odometry(station, frame=1, child=12, p=(1, 2, 3), q=EAST, v=(1, 0, 0), w=(0, 0, 0.5)):
    nothing = [math.nan] * 21
    station.send("ODOMETRY", 0, frame, child, *p, q, *v, *w, nothing, nothing)


def test_odometry_of_the_system_that_is_followed(others):
    odometry(others.station(system=7, component=1))
    odometry(others.station(system=8, component=1))
    (value,) = commanded(others)
    assert value["p_NB"] == (1, 2, 3)
    assert value["q_NB"] == pytest.approx(EAST)
    assert value["v_NB_B"] == (1, 0, 0)
    assert value["w_NB_B"] == (0, 0, 0.5)


def test_velocity_in_the_world_is_turned_into_the_body(others):
    odometry(others.station(system=7, component=1), child=1, v=(0, 2, 0))
    (value,) = commanded(others)
    assert value["v_NB_B"] == pytest.approx((2, 0, 0), abs=1e-6)


@pytest.mark.parametrize("bad", [{"frame": 8}, {"p": (math.nan, 0, 0)}, {"q": (0, 0, 0, 0)}, {"q": (math.nan,) * 4}])
def test_odometry_that_is_no_pose_is_counted(others, bad):
    odometry(others.station(system=7, component=1), **bad)
    assert commanded(others) == []
    assert others.router.vehicle.bridge.counters["other_odometry"] == 1


def test_global_positions_with_attitude(others):
    station = others.station(system=7, component=1)
    station.send("ATTITUDE", 0, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.1)
    station.send("GLOBAL_POSITION_INT", 0, LAT + 90, LON, -5000, -5000, 0, 100, 0, 9000)
    (value,) = commanded(others)
    assert value["p_NB"] == pytest.approx((1.0, 0.0, 5.0), abs=0.01)
    assert value["v_NB_B"] == pytest.approx((1, 0, 0), abs=1e-6)
    assert value["w_NB_B"] == pytest.approx((0, 0, 0.1))


def test_odometry_counts_more_than_the_global_position(others):
    station = others.station(system=7, component=1)
    odometry(station)
    station.send("GLOBAL_POSITION_INT", 0, LAT, LON, 0, 0, 0, 0, 0, 0)
    assert len(commanded(others)) == 1
    others.run(3.0)
    station.send("GLOBAL_POSITION_INT", 0, LAT, LON, 0, 0, 0, 0, 0, 0)
    assert len(commanded(others)) == 2


def test_without_an_origin_a_global_position_says_nothing(make_bench):
    bench = make_bench(externals={"ghost": 7}, origin_deg=None)
    bench.rov.ports = {**bench.rov.ports, POSE.path: POSE}
    bench.station(system=7, component=1).send("GLOBAL_POSITION_INT", 0, LAT, LON, 0, 0, 0, 0, 0, 0)
    assert commanded(bench) == []
    assert bench.router.vehicle.bridge.counters["other_position"] == 1


def test_a_vehicle_that_is_not_there_is_told_and_harms_nobody(make_bench):
    bench = make_bench(externals={"ghost": 7})
    odometry(bench.station(system=7, component=1))
    assert bench.router.vehicle.bridge.counters["other_refused"] == 1
    assert "ghost/pose" in bench.rov.stats.last_error


TURNING = Port(
    "ghost/actuators",
    "actuator",
    "actuators",
    LiveMotion([ShownActuator("t1"), ShownActuator("t2"), ShownActuator("t3")], int).fields,
    "",
)


@pytest.fixture
def turning(others):
    others.rov.ports = {**others.rov.ports, TURNING.path: TURNING}
    return others


def turned(bench) -> list[tuple[float, ...]]:
    return [c.value[0] for c in bench.rov.commands if c.port == TURNING.path]


def test_servo_outputs_turn_the_thrusters_of_who_follows(turning):
    station = turning.station(system=7, component=1)
    station.send("SERVO_OUTPUT_RAW", 0, 0, 1100, 1600, 2300, 1900, 0, 0, 0, 0)
    turning.station(system=8, component=1).send("SERVO_OUTPUT_RAW", 0, 0, 1900, 1900, 1900, 1900, 0, 0, 0, 0)
    assert turned(turning) == [pytest.approx((-1.0, 0.25, 1.0))]


def test_outputs_that_are_off_or_auxiliary_turn_nothing(turning):
    station = turning.station(system=7, component=1)
    station.send("SERVO_OUTPUT_RAW", 0, 0, 0, 0xFFFF, 1500, 1900, 0, 0, 0, 0)
    station.send("SERVO_OUTPUT_RAW", 0, 1, 1900, 1900, 1900, 1900, 0, 0, 0, 0)
    assert turned(turning) == [(0.0, 0.0, 0.0)]


def test_outputs_of_a_px4(turning):
    station = turning.station(system=7, component=1)
    station.send("ACTUATOR_OUTPUT_STATUS", 0, 3, [0.5, -2.0, math.nan, 1.0] + [0.0] * 28)
    assert turned(turning) == [(0.5, -1.0, 0.0)]


def test_outputs_for_a_body_without_actuators_are_no_fault(others):
    others.station(system=7, component=1).send("SERVO_OUTPUT_RAW", 0, 0, 1900, 0, 0, 0, 0, 0, 0, 0)
    assert others.rov.commands == []
    assert others.router.vehicle.bridge.counters["other_refused"] == 0
