"""Fins, propeller, ballast and moving mass: rows, order, limits, neutral; and through the world. Also of uwserver.actuators.servo."""

from __future__ import annotations

import math

import pytest

from uwserver.actuators import BallastConfig, Body, FinConfig, FinsConfig, MovingMassConfig, PropellerConfig
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.wageningen import b4_70
from uwserver.sensors.truth import Truth
from uwserver.world.state.snapshot import restore, take

SERVOS = ("fins.rudder", "fins.elevator", "propellers.main", "ballasts.buoyancy_engine", "moving_masses.battery")


@pytest.fixture
def world():
    """Two Tethys, so that an actuator that writes a wrong row is seen."""
    entries = {
        name: VehicleEntry(model="tethys", position_ned_m=(x, 0.0, 50.0), truth=Truth(rate_hz=240))
        for name, x in (("first", -20.0), ("auv", 0.0))
    }
    return build(load(Scenario(schema=1, vehicles=entries), adapters={}))


@pytest.fixture
def body(world):
    """The second vehicle."""
    return Body(world.hydro, 1, {}, 1, {name: 5 + k for k, name in enumerate(SERVOS)})


def commands(world):
    return world.hydro.servos["command"].tolist()


REST = [0.0, 0.0, 0.0, 500e-6, 0.0]


@pytest.mark.parametrize(
    ("config", "field", "unit", "limits", "row"),
    [
        (FinConfig(member="elevator"), "angle_rad", "rad", (-0.2617993878, 0.2617993878), 6),
        (PropellerConfig(member="main"), "speed_radps", "rad/s", (-31.416, 31.416), 7),
        (BallastConfig(member="buoyancy_engine"), "volume_m3", "m^3", (80e-6, 955e-6), 8),
        (MovingMassConfig(member="battery"), "position_m", "m", (-0.03, 0.03), 9),
    ],
)
def test_one_servo_takes_a_number_within_its_limits(body, world, config, field, unit, limits, row):
    actuator = config.build(body)
    (port_field,) = actuator.fields
    assert (port_field.name, port_field.unit, port_field.shape) == (field, unit, ())
    assert (port_field.minimum, port_field.maximum) == pytest.approx(limits)
    actuator.apply(((limits[1],),))
    expected = REST + REST
    expected[row] = limits[1]
    assert commands(world) == expected
    actuator.neutral()
    assert commands(world) == REST + REST
    actuator.apply((None,))
    assert commands(world) == REST + REST


def test_fins_are_a_vector_in_the_order_asked_for(body, world):
    fins = FinsConfig(members=("elevator", "rudder")).build(body)
    fins.apply(((0.1, -0.2),))
    assert commands(world)[5:7] == [-0.2, 0.1]
    assert fins.doc == "Fins elevator, rudder."
    assert "order: elevator, rudder" in fins.fields[0].doc
    assert FinsConfig().build(body).doc == "Fins rudder, elevator."


def test_an_unknown_member_is_named_with_those_that_are_there(body):
    with pytest.raises(ValueError, match=r'^no fin "tail" here, there are: rudder, elevator$'):
        FinConfig(member="tail").build(body)
    with pytest.raises(ValueError, match='no moving mass "x" here, there are: none'):
        MovingMassConfig(member="x").build(Body(body.hydro, 1, {}, 1))


def test_commands_outside_the_limits_are_refused_at_the_door(world):
    with pytest.raises(Refused, match='"angle_rad" must be at least'):
        world.command("auv/rudder", angle_rad=1.0)
    with pytest.raises(Refused, match='"volume_m3" must be at least'):
        world.command("auv/buoyancy_engine", volume_m3=1.0)


def test_a_fin_moves_at_its_rate_and_the_watchdog_brings_it_back(world):
    """30 degrees a second; after one second without a command it returns."""
    world.command("auv/rudder", angle_rad=0.2)
    world.step(61)  # the command is carried out in the first tick
    angle = world.hydro.servos["value"][5]
    assert angle == pytest.approx(30.0 * 3.14159265 / 180.0 * 0.25, rel=0.02)
    world.step(240)
    assert commands(world)[5] == 0.0
    world.step(240)
    assert world.hydro.servos["value"][5] == 0.0


def test_the_wrench_of_the_vehicle_counts_its_propeller(world):
    world.command("auv/propeller", speed_radps=30.0)
    world.step(200)
    (x, _, _), _ = world.read("auv/truth/wrench").value
    K_T = math.pi / 8.0 * (0.7 * math.pi) ** 2 * sum(row[0] for row in b4_70(1.27))  # at rest; it has begun to move
    assert x == pytest.approx(K_T * 1025.0 * 0.2**4 * (30.0 / 6.283185307) ** 2, rel=0.1)
    assert world.read("first/truth/wrench").value[0][0] == pytest.approx(0.0, abs=1e-9)


def test_a_snapshot_holds_angles_shaft_and_pumps(world):
    for port, value in (
        ("rudder", {"angle_rad": 0.2}),
        ("buoyancy_engine", {"volume_m3": 900e-6}),
        ("propeller", {"speed_radps": 20.0}),
    ):
        world.command(f"auv/{port}", **value)
    world.step(30)
    saved = take(world)
    world.step(100)
    first = take(world).hash()
    restore(world, saved)
    assert take(world).hash() == saved.hash()
    world.step(100)
    assert take(world).hash() == first
