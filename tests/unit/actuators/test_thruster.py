"""Thrusters, one and several: rows, order, limits, neutral; and what comes out as force."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.actuators import ThrusterConfig, ThrustersConfig
from uwserver.ports import Refused


def rows(hydro, name):
    return hydro.thrusters[name].tolist()


def test_a_vector_writes_the_rows_of_its_vehicle_in_order(body, hydro):
    hydro.thrusters["fresh"] = 0
    ThrustersConfig().build(body).apply(((0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, -0.8),))
    assert rows(hydro, "command") == [0.0] * 8 + [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, -0.8]
    assert rows(hydro, "fresh") == [0] * 8 + [1] * 8
    assert rows(hydro, "by_force") == [0] * 16


def test_members_choose_and_order(body, hydro):
    thrusters = ThrustersConfig(members=("h", "b")).build(body)
    thrusters.apply(((0.5, -0.25),))
    assert rows(hydro, "command") == [0.0] * 9 + [-0.25, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    assert thrusters.fields[0].shape == (2,)
    assert thrusters.doc == "Thrusters h, b."
    assert "order: h, b" in thrusters.fields[0].doc


def test_one_thruster_takes_a_number(body, hydro):
    thruster = ThrusterConfig(member="c").build(body)
    (field,) = thruster.fields
    assert (field.name, field.unit, field.shape, field.minimum, field.maximum) == ("u", "1", (), -1.0, 1.0)
    thruster.apply(((0.5,),))
    assert np.flatnonzero(hydro.thrusters["command"]).tolist() == [10]


def test_by_force(body, hydro):
    thrusters = ThrustersConfig(members=("a", "b"), input="force").build(body)
    (field,) = thrusters.fields
    assert (field.name, field.unit, field.minimum, field.maximum) == ("force_N", "N", None, None)
    thrusters.apply(((12.0, -3.0),))
    assert rows(hydro, "command")[8:10] == [12.0, -3.0]
    assert rows(hydro, "by_force") == [0] * 8 + [1, 1] + [0] * 6


@pytest.mark.parametrize("command", ["u", "force"])
def test_neutral_asks_for_no_thrust(body, hydro, command):
    thrusters = ThrustersConfig(input=command).build(body)
    thrusters.apply(((0.5,) * 8,))
    hydro.thrusters["fresh"] = 0
    thrusters.neutral()
    assert rows(hydro, "command") == [0.0] * 16
    assert rows(hydro, "by_force") == [0] * 8 + [int(command == "force")] * 8
    assert rows(hydro, "fresh") == [0] * 8 + [1] * 8


def test_the_last_of_two_kinds_of_command_holds(body, hydro):
    ThrustersConfig(input="force").build(body).apply(((20.0,) * 8,))
    ThrustersConfig().build(body).apply(((0.5,) * 8,))
    assert rows(hydro, "by_force") == [0] * 16


def test_an_unknown_member_is_named_with_those_that_are_there(body):
    for config in (ThrustersConfig(members=("a", "z")), ThrusterConfig(member="z")):
        with pytest.raises(ValueError, match=r'^no thruster "z" here, there are: a, b, c, d, e, f, g, h$'):
            config.build(body)


def test_a_vehicle_without_thrusters_says_so(body):
    body.thrusters = {}
    with pytest.raises(ValueError, match='no thruster "a" here, there are: none'):
        ThrusterConfig(member="a").build(body)


# -- through the world ------------------------------------------------------------------------------------------------------------------

HOLD = 480
"""Ticks after which the lag has run out."""


def thrust(world, **command):
    """Demand of all thrusters of `rov`, N, and its wrench, with a command held for two seconds."""
    port, value = next(iter(command.items()))
    for _ in range(HOLD // 120):
        world.command(f"rov/{port}", **value)
        world.step(120)
    return world.hydro.thrusters["demand"][8:].copy()


def test_by_force_gives_that_force_within_what_the_supply_allows(make_world):
    actuators = {"forces": {"kind": "thrusters", "input": "force"}}
    full_ahead = thrust(make_world(), thrusters={"u": [1.0] * 8})
    full_astern = thrust(make_world(), thrusters={"u": [-1.0] * 8})
    assert (full_ahead > 20.0).all()
    assert (full_astern < -15.0).all()
    wanted = [10.0, -10.0, 0.0, 3.0, 1e9, -1e9, full_ahead[6], full_astern[7]]
    expected = [*wanted[:4], full_ahead[4], full_astern[5], full_ahead[6], full_astern[7]]
    assert thrust(make_world(**actuators), forces={"force_N": wanted}) == pytest.approx(np.array(expected), rel=1e-12)


def test_a_small_command_lies_in_the_dead_band_but_a_small_force_does_not(make_world):
    actuators = {"forces": {"kind": "thrusters", "input": "force"}}
    assert not thrust(make_world(), thrusters={"u": [0.02] * 8}).any()
    assert thrust(make_world(**actuators), forces={"force_N": [0.1] * 8}) == pytest.approx(np.full(8, 0.1))


def test_thrust_pushes_along_the_axes_of_the_file(make_world):
    """Wrench on the truth port = sum of force times axis, about the origin; here one thruster at a time, without inflow at first."""
    for k in range(8):
        world = make_world(one={"kind": "thruster", "member": f"t{k + 1}", "input": "force"})
        world.command("rov/one", force_N=5.0)
        world.step(1)
        row = world.hydro.thrusters[8 + k]
        wrench = np.array([*world.read("rov/truth/wrench").value[0], *world.read("rov/truth/wrench").value[1]])
        direction = row["per_force"]
        assert np.linalg.norm(direction[:3]) == pytest.approx(1.0)
        along = wrench @ direction / (direction @ direction)
        assert 0.0 < along < 5.0  # the lag has begun
        assert wrench == pytest.approx(along * direction, abs=1e-9)
        assert not np.any(world.hydro.thrusters["demand"][:8])


def test_commands_outside_their_range_are_refused_at_the_door(make_world):
    world = make_world(one={"kind": "thruster", "member": "t1"})
    with pytest.raises(Refused, match=r'"u" must be at least -1 and at most 1, not 1\.1'):
        world.command("rov/one", u=1.1)
    with pytest.raises(Refused, match='"u" must be a number, not a list'):
        world.command("rov/one", u=[0.1])
    with pytest.raises(Refused, match='"u" must be a list of 8, not a number'):
        world.command("rov/thrusters", u=0.1)
