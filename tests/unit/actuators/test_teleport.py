"""Setting pose and velocity at once."""

from __future__ import annotations

import math

import pytest

from uwserver.actuators import TeleportConfig
from uwserver.frames import quat_from_rpy
from uwserver.ports import Refused

P, Q, V, W = (1.0, 2.0, 3.0), quat_from_rpy(0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.7, 0.8, 0.9)
OTHER = [5.0, 6.0, 7.0, *quat_from_rpy(1.0, 0.5, -1.0), 1.0, 1.0, 1.0, 2.0, 2.0, 2.0]


@pytest.fixture
def teleport(body):
    return TeleportConfig().build(body)


@pytest.mark.parametrize("given_fields", range(16))
def test_what_is_left_out_keeps_its_value(teleport, hydro, given_fields):
    hydro.state[1] = OTHER
    first = hydro.state[0].tolist()
    value = tuple(part if given_fields >> k & 1 else None for k, part in enumerate((P, Q, V, W)))
    teleport.apply(value)
    kept = (OTHER[0:3], OTHER[3:7], OTHER[7:10], OTHER[10:13])
    expected = [number for part, old in zip(value, kept, strict=True) for number in (old if part is None else part)]
    assert hydro.state[1] == pytest.approx(expected, abs=1e-15)
    assert hydro.state[0].tolist() == first


@pytest.mark.parametrize("scale", [1e-320, 1e-9, 0.5, 3.0, 1e6, -2.0])
def test_a_quaternion_is_normalised(teleport, hydro, scale):
    teleport.apply((None, (scale, 0.0, 0.0, -scale), None, None))
    half = math.copysign(math.sqrt(0.5), scale)
    assert hydro.state[1, 3:7] == pytest.approx(
        (half, 0.0, 0.0, -half), abs=1e-3 if scale < 1e-300 and scale > 0 else 1e-12
    )


def test_a_quaternion_of_zero_length_is_ignored(teleport, hydro):
    hydro.state[1] = OTHER
    teleport.apply((P, (0.0, 0.0, 0.0, 0.0), None, None))
    assert hydro.state[1].tolist() == pytest.approx([*P, *OTHER[3:]])


def test_neutral_leaves_it_where_it_is(teleport, hydro):
    hydro.state[1] = OTHER
    teleport.neutral()
    assert hydro.state[1].tolist() == OTHER


def test_it_has_no_watchdog(make_world):
    world = make_world(teleport={"kind": "teleport"})
    assert world.ports["rov/teleport"].timeout_s is None
    world.command("rov/teleport", p_NB=[1, 2, 30])
    world.step(480)
    assert world.actuators["rov/teleport"].timeouts == 0
    assert world.vehicles["rov"].p_NB[2] == pytest.approx(30.0, abs=0.5)


def test_it_acts_before_the_tick_moves_the_body(make_world):
    world = make_world(teleport={"kind": "teleport"})
    world.command("rov/teleport", p_NB=[1, 2, 30], v_NB_B=[0.24, 0, 0])
    world.step(1)
    assert world.vehicles["rov"].p_NB == pytest.approx((1.001, 2.0, 30.0), abs=1e-5)


@pytest.mark.parametrize(
    "value",
    [
        {"v_NB_B": [1e5, 0, 0]},
        {"w_NB_B": [0, 0, 1e5]},
        {"p_NB": [0, 0, 1e12]},
        {"q_NB": [1e308] * 4},
        {"p_NB": [0, 0, float("nan")]},
    ],
)
def test_what_would_make_the_body_diverge_is_refused(make_world, value):
    """One command of one client must not end the run of all."""
    world = make_world(teleport={"kind": "teleport"})
    with pytest.raises(Refused):
        world.command("rov/teleport", **value)


@pytest.mark.parametrize(
    "value",
    [{"v_NB_B": [100.0] * 3}, {"w_NB_B": [-100.0] * 3}, {"p_NB": [1e6] * 3}, {"p_NB": [-1e6] * 3}, {"q_NB": [1e6] * 4}],
)
def test_the_limits_themselves_are_survived(make_world, value):
    world = make_world(teleport={"kind": "teleport"})
    world.command("rov/teleport", **value)
    world.step(240)
    assert all(math.isfinite(number) for number in world.hydro.state[1])
