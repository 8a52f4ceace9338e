"""What `describe` says of a world."""

from __future__ import annotations

import pytest

import uwserver
from uwserver.ports import Refused


@pytest.fixture(scope="module")
def world():
    with uwserver.load("bluerov2_pool") as world:
        yield world


def test_it_lists_bodies_ports_with_fields_and_services(world):
    found = world.describe()
    assert found.bodies == {"bluerov2": "bluerov2_heavy"}
    assert {port.path for port in (*found.sensors, *found.actuators)} == set(world.ports)
    assert {service.path for service in found.services} == set(world.services)
    text = str(found)
    assert "bluerov2_pool: 240 ticks a second, seed 1; SI units" in text
    assert "  bluerov2/imu                 120 Hz  f_S (3) m/s^2, w_S (3) rad/s, temperature degC\n" in text
    assert "  bluerov2/thrusters    neutral after 1 s  u (8)\n" in text
    assert "world/spawn(name, like, p_NB, q_NB=[1.0, 0.0, 0.0, 0.0])" in text
    assert "and of each sensor, below its path: activate, deactivate, get, set" in text
    assert "bluerov2/imu/activate" not in text


def test_one_port_or_service_is_told_in_full(world):
    text = str(world.describe("bluerov2/thrusters"))
    assert "thrusters, neutral after 1 s." in text
    assert "(from -1 to 1)" in text
    assert "bodies" not in text
    text = str(world.describe("world/set_current"))
    assert "velocity_N: water velocity in N (from -20 to 20 m/s)" in text


def test_patterns_choose_and_what_matches_nothing_is_refused(world):
    found = world.describe("bluerov2/truth/*")
    assert len(found.sensors) == 5
    assert (found.bodies, found.actuators, found.services) == ({}, (), ())
    with pytest.raises(Refused, match=r'matches bluerov2/imuu.*did you mean "bluerov2/imu"'):
        world.describe("bluerov2/imuu")


@pytest.mark.parametrize("scenario", ["one_of_everything", "remus_survey"])
def test_every_port_of_large_scenarios_has_its_line(scenario):
    with uwserver.load(scenario) as world:
        lines = str(world.describe()).splitlines()
        starts = [line.split()[0] for line in lines if line.startswith("  ")]
        assert set(world.ports) <= set(starts)
        assert max(map(len, lines)) < 1000
