"""The wrench of what is fitted to a hull at one instant: where each part's force acts, how faults and the surface scale it, and who gets it.

`tests/physics/test_appendages.py` proves the laws of fins, propellers, ballast and hulls on moving bodies.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.appendage_forces import foil_force, propeller_force
from uwserver.physics.dynamics.appendage_params import (
    Appendages,
    DerivativeParams,
    FoilParams,
    HullParams,
    PropellerParams,
    ServoParams,
    WeightParams,
)
from uwserver.physics.dynamics.appendages import appendages
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape
from uwserver.physics.dynamics.scratch import ACTUATED, PASSIVE, STATE
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import SHAPE_SPHERE, Fitted, Model

ZERO = np.zeros((6, 6))
NU = np.array([1.5, 0.2, -0.3, 0.1, -0.2, 0.4])
SERVOS = (
    ServoParams("idle", -9.0, 9.0),
    ServoParams("fin", -0.5, 0.5),
    ServoParams("shaft", -200.0, 200.0),
    ServoParams("ballast", -1.0, 1.0),
)
MOUNT = (-0.6, 0.1, 0.2)
CURVE = ((0.0, 0.4, 0.05), (1.0, 0.0, 0.01))


def foil(servo: str = "fin", **changes: Any) -> FoilParams:
    return FoilParams(servo, MOUNT, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 5.0, 3.0, 0.1, 0.01, 1.2, 0.3, 0.5, **changes)


def world_of(given: Appendages, depth: float = 50.0, nu: FloatArray = NU, rpy: Any = (0.0, 0.0, 0.0)) -> Hydrodynamics:
    """One body after another with servos, so that rows do not begin at zero; a ball of 0.2 m about the origin holds its water."""
    ball = BuoyancyShape(SHAPE_SPHERE, (0.0,) * 3, (0.2, 0.0, 0.0), 1.0)
    bodies = [
        BodyParams(np.eye(6), ZERO, ZERO, ZERO, ZERO, 10.0, 10.0, (0.0,) * 3, (0.0,) * 3, shapes=(ball,), appendages=a)
        for a in (Appendages(SERVOS[:3]), given)
    ]
    hydro = Hydrodynamics(bodies, 0.01)
    hydro.state[1] = 0.0, 0.0, depth, *quat_from_rpy(*rpy), *nu
    return hydro


def wrenches(hydro: Hydrodynamics, stage: int = 1, **values: float) -> tuple[FloatArray, FloatArray]:
    """What acts by servos, and what the hull itself does, at some values of servos."""
    names = [servo.name for servo in SERVOS]
    for name, value in values.items():
        hydro.values[3 + names.index(name), stage] = value
    model = Model(*(getattr(hydro, name) for name in Model._fields))
    fitted = Fitted(*(getattr(hydro, name) for name in Fitted._fields))
    scratch = hydro.scratch
    scratch["s"][0, STATE] = hydro.state[1]
    appendages(model, fitted, hydro.bodies[1], hydro.flows[1], 0.0, STATE, stage, scratch[0])
    return scratch["work"][0, ACTUATED].copy(), scratch["work"][0, PASSIVE].copy()


def at_mount(force: Any) -> FloatArray:
    return np.concatenate([force, np.cross(MOUNT, force)])


@pytest.mark.parametrize("stage", [0, 1, 2])
def test_a_fin_acts_at_its_mount_with_the_angle_of_its_stage(stage: int) -> None:
    hydro = world_of(Appendages(SERVOS, foils=(foil(),)))
    hydro.values[:] = 7.0  # of others, and of other stages
    v = NU[:3] + np.cross(NU[3:], MOUNT)
    along, normal = foil_force(hydro.foils[0], 0.2, v[0], v[1], v[0] ** 2 + v[1] ** 2)
    actuated, passive = wrenches(hydro, stage, fin=0.2)
    np.testing.assert_allclose(actuated, at_mount([along, normal, 0.0]), rtol=1e-12, atol=1e-12)
    assert not passive.any()


def test_a_fixed_fin_is_of_the_hull() -> None:
    actuated, passive = wrenches(world_of(Appendages(SERVOS, foils=(foil(""),))))
    expected, _ = wrenches(world_of(Appendages(SERVOS, foils=(foil(),))), fin=0.0)
    np.testing.assert_array_equal(passive, expected)
    assert not actuated.any()


def test_a_fin_of_the_whole_speed_has_the_larger_pressure() -> None:
    plain, whole = (wrenches(world_of(Appendages(SERVOS, foils=(foil(whole=w),))), fin=0.2)[0] for w in (False, True))
    v = NU[:3] + np.cross(NU[3:], MOUNT)
    np.testing.assert_allclose(whole, plain * (v @ v) / (v[0] ** 2 + v[1] ** 2), rtol=1e-12, atol=1e-12)


def propeller(**changes: Any) -> PropellerParams:
    return PropellerParams("shaft", MOUNT, (1.0, 0.0, 0.0), 0.2, 1025.0, CURVE, sense=-1.0, **changes)


@pytest.mark.parametrize("whole", [False, True])
def test_a_propeller_acts_at_its_mount_and_turns_the_body(whole: bool) -> None:
    hydro = world_of(Appendages(SERVOS, propellers=(propeller(whole=whole),)))
    v = NU[:3] + np.cross(NU[3:], MOUNT)
    thrust, torque = propeller_force(hydro.propellers[0], 90.0, float(np.linalg.norm(v)) if whole else v[0])
    actuated, passive = wrenches(hydro, shaft=90.0)
    np.testing.assert_allclose(actuated, at_mount([thrust, 0.0, 0.0]) + torque * np.eye(6)[3], rtol=1e-12, atol=1e-12)
    assert not passive.any()


@pytest.mark.parametrize("efficiency", [0.0, 0.3])
def test_a_fault_scales_fin_propeller_and_terms(efficiency: float) -> None:
    given = Appendages(SERVOS, (foil(),), (propeller(),), derivatives=(DerivativeParams(1, 0, 5, -3.0, "fin", 1),))
    healthy = wrenches(world_of(given), fin=0.2, shaft=90.0)[0]
    hydro = world_of(given)
    hydro.servos["efficiency"][3:] = efficiency
    np.testing.assert_allclose(wrenches(hydro, fin=0.2, shaft=90.0)[0], efficiency * healthy, rtol=1e-12, atol=1e-12)


def test_ballast_adds_weight_and_moment_about_its_lever() -> None:
    rpy = (0.3, -0.2, 1.0)
    hydro = world_of(Appendages(SERVOS, weights=(WeightParams("ballast", 30.0, (6.0, 0.0, 3.0)),)), rpy=rpy)
    down = np.array(matrix(quat_from_rpy(*rpy)))[2]
    expected = 0.4 * np.concatenate([30.0 * down, np.cross((6.0, 0.0, 3.0), down)])
    np.testing.assert_allclose(wrenches(hydro, ballast=0.4)[0], expected, rtol=1e-12, atol=1e-12)
    assert not wrenches(hydro, ballast=0.0)[0].any()


def test_displaced_volume_counts_as_far_as_it_is_wet() -> None:
    for displaces, share in ((False, 1.0), (True, 0.5)):
        given = Appendages(SERVOS, weights=(WeightParams("ballast", -30.0, (0.0,) * 3, displaces),))
        assert wrenches(world_of(given, depth=0.0), ballast=0.4)[0][2] == pytest.approx(-12.0 * share)


@pytest.mark.parametrize(("servo", "power", "factor"), [("", 0, 1.0), ("fin", 1, 0.2), ("fin", 2, 0.04)])
def test_a_term_of_the_hull_is_a_product_of_velocities_and_angles(servo: str, power: int, factor: float) -> None:
    hydro = world_of(Appendages(SERVOS, derivatives=(DerivativeParams(4, 0, 2, -3.0, servo, power),)))
    both = wrenches(hydro, fin=0.2)
    expected = np.zeros(6)
    expected[4] = -3.0 * NU[0] * NU[2] * factor
    np.testing.assert_allclose(both[0 if servo else 1], expected, rtol=1e-12, atol=0.0)
    assert not both[1 if servo else 0].any()


def test_slow_damping_fades_with_the_speed() -> None:
    slow = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    _, passive = wrenches(world_of(Appendages(SERVOS, hulls=(HullParams(slow, fade=0.7),))))
    np.testing.assert_allclose(
        passive, -np.exp(-0.7 * np.linalg.norm(NU[:3])) * np.array(slow) * NU, rtol=1e-12, atol=0.0
    )


@pytest.mark.parametrize("joint", [False, True])
def test_strips_add_up_over_the_hull(joint: bool) -> None:
    hull = HullParams(length=2.0, center=0.1, strips=5, sway=30.0, heave=20.0, joint=joint)
    expected = np.zeros(6)
    for k in range(5):
        x = 0.1 - 1.0 + 0.4 * (k + 0.5)
        v, w = NU[1] + x * NU[5], NU[2] - x * NU[4]
        if joint:
            drag = 0.4 * (30.0 * v * v + 20.0 * w * w) / np.hypot(v, w)
            force = np.array([0.0, -drag * v, -drag * w])
        else:
            force = np.array([0.0, -0.4 * 30.0 * abs(v) * v, -0.4 * 20.0 * abs(w) * w])
        expected += np.concatenate([force, np.cross([x, 0.0, 0.0], force)])
    _, passive = wrenches(world_of(Appendages(SERVOS, hulls=(hull,))))
    np.testing.assert_allclose(passive, expected, rtol=1e-12, atol=1e-12)


def test_strips_at_rest_have_no_drag() -> None:
    hull = HullParams(length=2.0, strips=5, sway=30.0, heave=20.0, joint=True)
    assert not wrenches(world_of(Appendages(SERVOS, hulls=(hull,)), nu=np.zeros(6)))[1].any()


def test_the_current_is_taken_from_the_velocity() -> None:
    given = Appendages(SERVOS, (foil(),), hulls=(HullParams((1.0,) * 6, 0.1, 2.0, 0.0, 4, 9.0, 9.0),))
    drifting, still = world_of(given), world_of(given, nu=NU - [0.5, 0.1, 0.0, 0.0, 0.0, 0.0])
    drifting.currents[1] = 0.5, 0.1, 0.0
    for found, expected in zip(wrenches(drifting, fin=0.1), wrenches(still, fin=0.1), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_what_is_out_of_the_water_does_nothing() -> None:
    given = Appendages(
        SERVOS,
        (foil(), foil("")),
        (propeller(),),
        derivatives=(DerivativeParams(1, 0, 5, -3.0),),
        hulls=(HullParams((1.0,) * 6),),
    )
    for found in wrenches(world_of(given, depth=-5.0), fin=0.2, shaft=90.0):
        np.testing.assert_array_equal(found, 0.0)


def test_each_part_is_wet_by_itself() -> None:
    """Fins 0.2 m below the origin, of 0.1 m about their middle: half wet when it is 0.2 m above the surface."""
    given = Appendages(SERVOS, (foil(radius=0.1),))
    deep, half = (wrenches(world_of(given, depth=d), fin=0.2)[0] for d in (50.0, -0.2))
    np.testing.assert_allclose(half, 0.5 * deep, rtol=1e-12, atol=1e-12)
