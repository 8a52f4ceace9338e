"""The external wrench."""

from __future__ import annotations

import pytest

from uwserver.actuators import ForceTorqueConfig
from uwserver.ports import Refused


def held(hydro):
    return hydro.wrenches["bias"].tolist()


ZERO = [0.0] * 6


@pytest.mark.parametrize(
    ("value", "wrench"),
    [
        (((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)), [1, 2, 3, 4, 5, 6]),
        (((1.0, 2.0, 3.0), None), [1, 2, 3, 0, 0, 0]),
        ((None, (4.0, 5.0, 6.0)), [0, 0, 0, 4, 5, 6]),
        ((None, None), ZERO),
        (((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ZERO),
    ],
)
def test_a_field_that_is_left_out_is_zero(body, hydro, value, wrench):
    actuator = ForceTorqueConfig().build(body)
    actuator.apply(((9.0, 9.0, 9.0), (9.0, 9.0, 9.0)))
    actuator.apply(value)
    assert held(hydro) == [ZERO, wrench]


def test_neutral(body, hydro):
    actuator = ForceTorqueConfig().build(body)
    actuator.apply(((9.0, 9.0, 9.0), (9.0, 9.0, 9.0)))
    actuator.neutral()
    assert held(hydro) == [ZERO, ZERO]


def test_limits(body):
    force, torque = ForceTorqueConfig(max_force_N=200.0, max_torque_Nm=50.0).build(body).fields
    assert (force.minimum, force.maximum, torque.minimum, torque.maximum) == (-200.0, 200.0, -50.0, 50.0)
    inertia = body.hydro.bodies["M_RB"][body.row].diagonal()
    force, torque = ForceTorqueConfig().build(body).fields
    assert (force.maximum, torque.maximum) == (100.0 * inertia[0], 100.0 * max(inertia[3:]))
    assert (force.minimum, torque.minimum) == (-force.maximum, -torque.maximum)


def test_the_default_limits_are_survived(make_world):
    world = make_world(tow={"kind": "force_torque", "timeout_s": 0})
    force, torque = world.ports["rov/tow"].fields
    world.command("rov/tow", force_B=[force.maximum] * 3, torque_B=[torque.maximum] * 3)
    world.step(240 * 20)


def test_limits_are_told_to_the_sender(make_world):
    world = make_world(tow={"kind": "force_torque", "max_force_N": 200})
    with pytest.raises(Refused, match='"force_B" must be at least -200 and at most 200 N, not 201'):
        world.command("rov/tow", force_B=[0, 0, 201])
    world.command("rov/tow", torque_B=[0, 0, 10])


def test_truth_tells_the_wrench_and_the_vehicle_follows(make_world):
    world = make_world(tow={"kind": "force_torque"})
    world.command("rov/tow", force_B=[10, 0, 0], torque_B=[0, 0, 1])
    world.step(120)
    assert world.read("rov/truth/wrench").value == ((10.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert world.read("first/truth/wrench").value == ((0.0,) * 3, (0.0,) * 3)
    assert world.vehicles["rov"].nu[0] > 0.05
    assert world.vehicles["rov"].nu[5] > 0.05
    assert abs(world.vehicles["first"].nu[0]) < 1e-3
