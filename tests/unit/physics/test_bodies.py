"""All bodies of a world as rows: ranges, views, external wrenches of a tick, and what is saved. Also of uwserver.physics.entries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.colliders import Floor
from uwserver_bench.proofs.contact_forms import FEET, OFF_DIAGONAL, vehicle

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.appendage_params import Appendages, HullParams, ServoParams
from uwserver.physics.dynamics.params import (
    BodyParams,
    BuoyancyShape,
    ForceTable,
    Lag,
    ThrusterParams,
    rigid_body_inertia,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, PROFILE_SIZE, SHAPE_BOX, WAVE_SIZE, Q, SeaRows

DT = 0.01
ZERO = np.zeros((6, 6))
WRENCH = np.array([3.0, -2.0, 1.0, 0.2, -0.1, 0.3])


def coupled(**changes: object) -> BodyParams:
    """Neutral, its weight and buoyancy in one point, undamped; with a full inertia of which no element is small."""
    rng = np.random.default_rng(9)
    root = rng.normal(size=(6, 6))
    M_RB = rigid_body_inertia(12.0, np.diag([0.4, 0.5, 0.6]), (0.05, -0.03, 0.08))
    plain = BodyParams(M_RB, root @ root.T + np.eye(6), ZERO, ZERO, ZERO, 100.0, 100.0, (0.0,) * 3, (0.0,) * 3)
    return replace(plain, **changes)  # type: ignore[arg-type]


def deep(*bodies: BodyParams, dt: float = DT) -> Hydrodynamics:
    hydro = Hydrodynamics(bodies, dt)
    hydro.state[:, 2] = 50.0
    return hydro


def total(body: BodyParams) -> FloatArray:
    return body.M_RB + body.M_A


# -- an external wrench ---------------------------------------------------------------------------------------------------------------


def test_a_wrench_accelerates_through_the_whole_inertia() -> None:
    """From rest, in a tick so short that nothing else comes about: nu = M^-1 tau dt."""
    hydro = deep(coupled(), dt=1e-6)
    hydro.external[0] += WRENCH
    assert hydro.advance(0.0) < 0
    np.testing.assert_allclose(
        hydro.state[0, NU:], 1e-6 * np.linalg.solve(total(coupled()), WRENCH), rtol=1e-6, atol=0.0
    )


def test_a_wrench_that_is_added_in_each_tick_is_a_constant_one() -> None:
    """On a body that a wrench cannot turn: v = F t / m, p = F t^2 / 2 m."""
    body = coupled(M_RB=np.diag([12.0] * 3 + [1.0] * 3), M_A=np.diag([3.0] * 3 + [1.0] * 3))
    hydro = deep(body)
    hydro.state[0, Q : Q + 4] = quat_from_rpy(0.0, 0.0, np.pi / 2)
    force = np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for k in range(200):
        hydro.external[0] += force
        assert hydro.advance(k * DT) < 0
    assert hydro.state[0, NU] == pytest.approx(3.0 / 15.0 * 2.0, rel=1e-12)
    np.testing.assert_allclose(hydro.state[0, :2], [0.0, 0.5 * 3.0 / 15.0 * 4.0], rtol=0.0, atol=1e-12)  # ahead is east


def test_a_wrench_in_each_tick_is_what_a_prescribed_one_is_bit_for_bit() -> None:
    ours, theirs = deep(coupled(D_L=np.eye(6))), deep(coupled(D_L=np.eye(6)))
    theirs.wrenches["bias"] = WRENCH
    for k in range(100):
        ours.external[0] += WRENCH
        assert ours.advance(k * DT) < 0
        assert theirs.advance(k * DT) < 0
        np.testing.assert_array_equal(ours.state, theirs.state)
    for found, expected in zip(ours.rates_of_change(1.0), theirs.rates_of_change(1.0), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_wrench_acts_for_one_tick() -> None:
    body = coupled(M_RB=np.diag([12.0] * 3 + [1.0] * 3), M_A=ZERO)
    hydro = deep(body)
    hydro.external[0] += [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    speeds = []
    for k in range(3):
        assert hydro.advance(k * DT) < 0
        assert not hydro.external.any()
        speeds.append(float(hydro.state[0, NU]))
    assert speeds == pytest.approx([0.5 * DT] * 3)


def test_wrenches_of_several_add_up() -> None:
    once, thrice = deep(coupled()), deep(coupled())
    once.external[0] += 3.0 * WRENCH
    for _ in range(3):
        thrice.external[0] += WRENCH
    once.advance(0.0)
    thrice.advance(0.0)
    np.testing.assert_allclose(thrice.state, once.state, rtol=1e-14, atol=0.0)


def test_an_accelerometer_feels_the_wrench_of_the_last_tick() -> None:
    hydro = deep(coupled())
    hydro.external[0] += WRENCH
    assert not hydro.rates_of_change(0.0)[0].any()  # it has not acted yet
    hydro.advance(0.0)
    hydro.state[0, NU:] = 0.0
    nu_dot, tau = hydro.rates_of_change(DT)
    np.testing.assert_allclose(nu_dot[0], np.linalg.solve(total(coupled()), WRENCH), rtol=1e-12, atol=0.0)
    np.testing.assert_array_equal(tau[0], WRENCH)
    hydro.advance(DT)
    assert not hydro.rates_of_change(2.0 * DT)[1].any()


def test_each_body_has_its_own() -> None:
    hydro = deep(coupled(), coupled(), coupled())
    hydro.external[1] += WRENCH
    hydro.advance(0.0)
    assert hydro.state[1, NU:].all()
    assert not hydro.state[[0, 2], NU:].any()


def test_a_wrench_on_a_body_that_rests_is_carried_by_the_ground() -> None:
    """20 N heavy and 5 N more: its contacts carry 25 N in that tick, and 20 N in the next."""
    hydro = Hydrodynamics([vehicle(OFF_DIAGONAL, 20.0, 0.0)], 1.0 / 240.0)
    hydro.state[0, 2] = -0.1
    hydro.collider = Floor({0: FEET}, friction=0.5)
    loads = []
    for k in range(481):
        if k == 479:
            hydro.external[0] += [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]
        assert hydro.advance(k * hydro.dt) < 0
        assert not hydro.external.any()
        loads.append(float(-hydro.touched.impulse[:, 2].sum() / hydro.dt))
    assert loads[-3:] == pytest.approx([20.0, 25.0, 20.0], rel=1e-4)
    assert np.abs(hydro.state[0, NU:]).max() < 1e-6


def test_a_wrench_lifts_a_body_off_the_ground() -> None:
    body = vehicle(OFF_DIAGONAL, 20.0, 0.0)
    hydro = Hydrodynamics([body], 1.0 / 240.0)
    hydro.state[0, 2] = -0.1
    hydro.collider = Floor({0: FEET}, friction=0.5)
    for k in range(240):
        hydro.external[0] += [0.0, 0.0, -30.0, 0.0, 0.0, 0.0]
        assert hydro.advance(k * hydro.dt) < 0
    free = deep(body, dt=1.0 / 240.0)
    for k in range(240):
        free.external[0] += [0.0, 0.0, -30.0, 0.0, 0.0, 0.0]
        free.advance(k * free.dt)
    np.testing.assert_allclose(hydro.state[0, NU:], free.state[0, NU:], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("stiff", [1.0, 1e5])
@pytest.mark.parametrize("touching", [False, True])
def test_a_wrench_of_nothing_changes_no_bit(touching: bool, stiff: float) -> None:
    body = vehicle(OFF_DIAGONAL, 20.0, stiff)
    plain, pushed = (Hydrodynamics([body], 1.0 / 240.0) for _ in range(2))
    for hydro in (plain, pushed):
        hydro.state[0] = 0.0, 0.0, -0.1, *quat_from_rpy(0.1, 0.0, 0.2), 0.3, 0.1, 0.4, 0.2, 0.1, 0.3
        hydro.collider = Floor({0: FEET}, friction=0.5) if touching else None
    for k in range(240):
        pushed.external[0] += np.zeros(6)
        pushed.external[0] += WRENCH
        pushed.external[0] -= WRENCH
        for hydro in (plain, pushed):
            assert hydro.advance(k * hydro.dt) < 0
        np.testing.assert_array_equal(pushed.state, plain.state)


def test_a_wrench_on_a_body_with_appendages_in_waves_acts_as_a_prescribed_one() -> None:
    fins = Appendages(
        servos=(ServoParams("fin", -1.0, 1.0),), hulls=(HullParams((1.0,) * 6, 1.0, 2.0, 0.0, 5, 10.0, 10.0),)
    )
    body = coupled(appendages=fins, shapes=(BuoyancyShape(SHAPE_BOX, (0.0,) * 3, (0.3, 0.2, 0.1), 0.02),))
    ours, theirs = Hydrodynamics([body], DT), Hydrodynamics([body], DT)
    wave = [0.2, 0.0, 0.2, 1.4, 0.2, 0.3, np.inf]
    theirs.wrenches["bias"] = WRENCH
    for hydro in (ours, theirs):
        hydro.sea = SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), np.array(wave).reshape(1, WAVE_SIZE))
    for k in range(100):
        ours.external[0] += WRENCH
        assert ours.advance(k * DT) < 0
        assert theirs.advance(k * DT) < 0
    np.testing.assert_allclose(ours.state, theirs.state, rtol=1e-12, atol=1e-13)


def test_a_body_that_was_taken_out_keeps_no_wrench() -> None:
    hydro = deep(coupled(), coupled())
    hydro.external[:] += WRENCH
    hydro.retire(0)
    assert hydro.external[1].all()
    assert not hydro.external[0].any()
    hydro.external[0] += WRENCH
    hydro.advance(0.0)
    assert not hydro.external.any()
    assert not hydro.state[0, NU:].any()
    assert not hydro.rates_of_change(DT)[0][0].any()


def test_a_change_of_the_body_keeps_the_wrench_of_the_tick() -> None:
    hydro = deep(coupled(), dt=1e-6)
    hydro.external[0] += WRENCH
    heavier = coupled(M_RB=np.diag([50.0] * 6))
    hydro.change(0, heavier)
    hydro.advance(0.0)
    np.testing.assert_allclose(hydro.state[0, NU:], 1e-6 * np.linalg.solve(total(heavier), WRENCH), rtol=1e-6, atol=0.0)


def test_a_saved_wrench_acts_after_a_load() -> None:
    hydro = deep(coupled())
    hydro.external[0] += WRENCH
    hydro.advance(0.0)
    hydro.external[0] += WRENCH
    saved, felt = hydro.save(), hydro.rates_of_change(DT)
    hydro.advance(DT)
    after = hydro.state.copy()
    hydro.advance(2.0 * DT)
    hydro.load(saved)
    for found, expected in zip(hydro.rates_of_change(DT), felt, strict=True):
        np.testing.assert_array_equal(found, expected)
    hydro.advance(DT)
    np.testing.assert_array_equal(hydro.state, after)


# -- rows -----------------------------------------------------------------------------------------------------------------------------

TABLE = ForceTable((12.0,), (((-1.0, -30.0), (1.0, 40.0)),))


def thruster(name: str, lag: float = 0.1) -> ThrusterParams:
    return ThrusterParams(name, (0.0,) * 3, (1.0, 0.0, 0.0), TABLE, 12.0, Lag.first_order(lag))


def test_bodies_name_their_own_rows() -> None:
    shape = BuoyancyShape(SHAPE_BOX, (0.0,) * 3, (0.1,) * 3, 1.0)
    fins = Appendages(servos=(ServoParams("a", -1.0, 1.0), ServoParams("b", -2.0, 2.0)))
    hydro = Hydrodynamics(
        [coupled(shapes=(shape,)), coupled(thrusters=(thruster("x"), thruster("y")), wrenches=2), coupled(shapes=(shape,) * 3, appendages=fins)],
        DT,
    )  # fmt: skip
    ranges = {
        name: [(int(b[f"{name}_first"]), int(b[f"{name}_count"])) for b in hydro.bodies]
        for name in ("shape", "thruster", "wrench", "servo")
    }
    assert ranges == {
        "shape": [(0, 1), (1, 0), (1, 3)],
        "thruster": [(0, 0), (0, 2), (2, 0)],
        "wrench": [(0, 1), (1, 2), (3, 1)],
        "servo": [(0, 0), (0, 0), (0, 2)],
    }
    assert hydro.bodies["fitted"].tolist() == [0, 0, 1]
    assert len(hydro) == 3


def test_equal_tables_and_lags_are_kept_once() -> None:
    hydro = Hydrodynamics(
        [coupled(thrusters=(thruster("x"), thruster("y"))), coupled(thrusters=(thruster("z"), thruster("w", 0.3)))], DT
    )
    assert len(hydro.tables) == 1
    assert hydro.thrusters["lag"].tolist() == [0, 0, 0, 1]


def test_a_body_that_is_added_later_leaves_the_others_as_they_are() -> None:
    hydro, alone = deep(coupled(D_L=np.eye(6))), deep(coupled(D_L=np.eye(6)))
    for h in (hydro, alone):
        h.state[0, NU:] = 0.5
        h.advance(0.0)
    assert hydro.add(coupled()) == 1
    assert hydro.state[1].tolist() == [0.0, 0.0, 0.0, 1.0] + [0.0] * 9
    for h in (hydro, alone):
        h.advance(DT)
    np.testing.assert_array_equal(hydro.state[0], alone.state[0])


def test_a_world_of_no_bodies_steps() -> None:
    hydro = Hydrodynamics((), DT)
    assert hydro.advance(0.0) == -1
    assert hydro.rates_of_change(0.0)[0].shape == (0, 6)
    assert hydro.kinetic_energy().shape == (0,)


def test_the_first_body_whose_state_is_not_finite_is_named() -> None:
    hydro = deep(coupled(), coupled(), coupled())
    hydro.state[1, NU] = np.nan
    hydro.state[2, NU] = np.nan
    assert hydro.advance(0.0) == 1


def test_a_load_brings_back_every_bit() -> None:
    hydro = deep(coupled(thrusters=(thruster("x"),)))
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 0.5, 1
    hydro.advance(0.0)
    saved = hydro.save()
    hydro.advance(DT)
    expected = hydro.state.copy()
    hydro.advance(2.0 * DT)
    hydro.check(saved)
    hydro.load(saved)
    assert hydro.save() == saved
    hydro.advance(DT)
    np.testing.assert_array_equal(hydro.state, expected)


def test_a_state_from_before_a_servo_was_stuck_still_fits() -> None:
    """Its rate is infinite, and 0 while it is stuck; it can never be less than a number."""
    hydro = deep(coupled(appendages=Appendages(servos=(ServoParams("rudder", -0.3, 0.3),))))
    saved = hydro.save()
    hydro.servos["rate"] = 0.0
    hydro.check(saved)
    hydro.load(saved)
    assert hydro.servos["rate"].tolist() == [np.inf]
    hydro.servos["rate"] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        hydro.check(hydro.save())


def test_the_state_of_other_bodies_is_refused() -> None:
    hydro = deep(coupled())
    saved = hydro.save()
    hydro.add(coupled())
    with pytest.raises(ValueError, match='bytes of "state"'):
        hydro.check(saved)


def test_currents_are_the_water_of_the_bodies() -> None:
    hydro = deep(coupled(D_L=np.eye(6)))
    hydro.currents[0] = 0.3, 0.0, 0.0
    hydro.advance(0.0)
    assert hydro.state[0, NU] > 0.0


def test_other_masses_leave_strips_and_bottom_as_they_are() -> None:
    """What a copy with its own added mass does."""
    k = 0.7
    wave = np.array([[k, 0.0, k, np.sqrt(9.81 * k), 0.1, 0.0, np.inf]])
    hydro = Hydrodynamics((), DT)
    hydro.sea, hydro.floor = SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), wave), 70.0
    hydro.add(replace(coupled(), length=3.0))
    before = hydro.bodies.copy()
    assert before["strip_count"][0] > 2
    hydro.change(0, replace(hydro.params[0], M_A=2.0 * hydro.params[0].M_A))
    for name in ("strip_first", "strip_count", "strip_half", "strip_turn", "strip_moment", "floor"):
        np.testing.assert_array_equal(hydro.bodies[name], before[name])
    assert hydro.bodies["floor"][0] == 70.0
