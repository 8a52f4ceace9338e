"""One tick of a body: order of accuracy, sub-steps, the implicit fallback, and what it does to lags, servos and work space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics import integrator
from uwserver.physics.dynamics.appendage_params import Appendages, FoilParams, HullParams, ServoParams
from uwserver.physics.dynamics.integrator import keep_state
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, ForceTable, Lag, ThrusterParams, damping_rates
from uwserver.physics.dynamics.runge_kutta import MAX_LEVEL, STABLE
from uwserver.physics.dynamics.scratch import ACTUATED, PASSIVE, STATE
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, SHAPE_SPHERE

ZERO = np.zeros((6, 6))
TABLE = ForceTable((12.0,), (((-1.0, -40.0), (1.0, 40.0)),))
FIN = Appendages(
    servos=(ServoParams("fin", -0.5, 0.5, rate=2.0, tau=0.1),),
    foils=(FoilParams("fin", (-0.5, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 5.0, 3.0, 0.1, 0.01, 1.2, 0.3, 0.5),),
    hulls=(HullParams(slow=(1.0,) * 6, fade=0.5, length=1.5, strips=4, sway=5.0, heave=5.0),),
)  # fmt: skip


def body(**changes: object) -> BodyParams:
    rng = np.random.default_rng(2)
    root = 0.5 * rng.normal(size=(6, 6))
    D = np.diag([20.0, 30.0, 30.0, 2.0, 2.0, 2.0])
    thruster = ThrusterParams("t", (0.1, 0.2, 0.0), (1.0, 0.0, 0.0), TABLE, 12.0, Lag.first_order(0.15))
    plain = BodyParams(
        np.diag([10.0] * 3 + [0.5] * 3), root @ root.T + np.eye(6), D, D, ZERO, 98.1, 100.0, (0.0, 0.0, 0.02), (0.0,) * 3, thrusters=(thruster,)
    )  # fmt: skip
    return replace(plain, **changes)  # type: ignore[arg-type]


def run(params: BodyParams, dt: float, seconds: float = 0.4, speed: float = 1.0) -> FloatArray:
    hydro = Hydrodynamics([params], dt)
    hydro.state[0] = (
        0.0,
        0.0,
        40.0,
        *quat_from_rpy(0.2, 0.1, 0.3),
        *(speed * np.array([1.0, 0.3, -0.2, 0.5, -0.4, 0.6])),
    )
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 0.5, 1
    hydro.servos["command"] = 0.3
    for k in range(round(seconds / dt)):
        assert hydro.advance(k * dt) < 0
    return hydro.state[0].copy()


def test_the_error_falls_with_the_fourth_power_of_the_step() -> None:
    """With a lagged thruster that starts in the first step, whose exact values are inserted."""
    exact = run(body(), 0.4 / 512)
    errors = [float(np.abs(run(body(), 0.4 / n) - exact).max()) for n in (16, 32, 64)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.3)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.3)


def test_with_a_fin_that_turns_it_stays_of_high_order() -> None:
    """The bend of a servo at its largest rate lies within a step: two orders are lost there, no more."""
    params = body(appendages=FIN)
    exact = run(params, 0.4 / 1024)
    errors = [float(np.abs(run(params, 0.4 / n) - exact).max()) for n in (16, 64)]
    assert errors[0] / errors[1] > 10.0


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_sub_steps_are_as_many_steps(dt: float) -> None:
    """Where the rate asks for two sub-steps, a tick is two ticks of half the length."""
    rate = STABLE * 1.5 / dt
    D_L = np.diag([rate * 11.0] * 3 + [rate * 1.5] * 3)
    params = body(M_RB=np.diag([10.0] * 3 + [0.5] * 3), M_A=np.eye(6), D_L=D_L, D_Q=ZERO, thrusters=())
    assert 1.0 < damping_rates(params)[0] * dt / STABLE < 2.0
    whole, halves = run(params, dt, 4 * dt), run(params, 0.5 * dt, 4 * dt)
    np.testing.assert_allclose(whole, halves, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("factor", [0.5, 0.99, 3.0, 15.9])
def test_damping_up_to_the_finest_sub_steps_decays_as_an_exponential(factor: float) -> None:
    dt, rate = 0.05, STABLE * factor / 0.05
    assert factor <= 2**MAX_LEVEL
    params = body(
        M_A=ZERO, D_L=np.diag([rate * 10.0] * 3 + [rate * 0.5] * 3), D_Q=ZERO, thrusters=(), weight=0.0, buoyancy=0.0
    )
    hydro = Hydrodynamics([params], dt)
    hydro.state[0, 2], hydro.state[0, NU] = 40.0, 1.0
    hydro.advance(0.0)
    assert hydro.state[0, NU] == pytest.approx(np.exp(-rate * dt), abs=6e-2)
    assert hydro.state[0, NU] > 0.0


@pytest.mark.parametrize("stiffness", [1e3, 1e6, 1e9])
def test_stiffer_bodies_come_to_the_speed_at_which_damping_balances(stiffness: float) -> None:
    params = body(D_L=stiffness * np.eye(6), D_Q=stiffness * np.eye(6), thrusters=(), weight=0.0, buoyancy=0.0)
    hydro = Hydrodynamics([params], 0.05)
    hydro.state[0, 2], hydro.state[0, NU] = 40.0, 2.0
    hydro.wrenches["bias"][0, 0] = 12.0
    for k in range(400):
        assert hydro.advance(k * 0.05) < 0
    v = hydro.state[0, NU]
    assert stiffness * (v + v * v) == pytest.approx(12.0, rel=1e-6)


def test_a_light_body_under_a_sudden_force_counts_the_speed_that_it_will_have() -> None:
    """Quadratic damping has no rate at rest."""
    params = body(M_RB=np.eye(6), M_A=ZERO, D_L=ZERO, D_Q=np.diag([50.0] * 6), thrusters=(), weight=0.0, buoyancy=0.0)
    hydro = Hydrodynamics([params], 0.05)
    hydro.state[0, 2] = 40.0
    hydro.wrenches["bias"][0, 0] = 50.0
    for k in range(200):
        assert hydro.advance(k * 0.05) < 0
        assert 0.0 < hydro.state[0, NU] < 1.1
    assert hydro.state[0, NU] == pytest.approx(1.0, rel=1e-3)


def test_quaternions_keep_unit_length() -> None:
    assert np.linalg.norm(run(body(), 0.1, 5.0, speed=3.0)[3:7]) == pytest.approx(1.0, abs=1e-15)


def test_lags_go_on_once_a_tick_whatever_the_sub_steps() -> None:
    soft, hard = body(), body(D_L=np.diag([3000.0] * 3 + [300.0] * 3))
    hydro = Hydrodynamics([soft, hard], 0.05)
    hydro.state[:, 2] = 40.0
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 1.0, 1
    for k in range(3):
        hydro.advance(k * 0.05)
        np.testing.assert_allclose(
            hydro.thrusters["x"][:, 0], 40.0 * (1.0 - np.exp(-(k + 1) * 0.05 / 0.15)), rtol=1e-12
        )


def test_bodies_do_not_share_what_is_left_in_the_work_space() -> None:
    """A body with a fin steps by the same bits after another one as alone, and so does the one after it."""
    alone = [run(body(appendages=FIN), 0.02), run(body(), 0.02)]
    hydro = Hydrodynamics([body(appendages=FIN), body(), body(appendages=FIN)], 0.02)
    for row in hydro.state:
        row[:] = 0.0, 0.0, 40.0, *quat_from_rpy(0.2, 0.1, 0.3), 1.0, 0.3, -0.2, 0.5, -0.4, 0.6
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 0.5, 1
    hydro.servos["command"] = 0.3
    for k in range(20):
        hydro.rates_of_change(k * 0.02)
        hydro.advance(k * 0.02)
        assert not hydro.scratch["work"][0, [ACTUATED, PASSIVE]].any()
    for row, expected in zip(hydro.state, (alone[0], alone[1], alone[0]), strict=True):
        np.testing.assert_array_equal(row, expected)


def test_rates_of_change_change_nothing_but_the_work_space() -> None:
    hydro = Hydrodynamics([body(appendages=FIN)], 0.02)
    hydro.state[0, 2], hydro.state[0, NU] = 40.0, 1.0
    before = hydro.save()
    hydro.rates_of_change(0.0)
    assert hydro.save() == before


def test_a_body_at_the_surface_accelerates_with_the_added_mass_that_is_wet() -> None:
    """Half out of the water, at rest, and pulled: a = F / (m + m_A / 2)."""
    shape = BuoyancyShape(SHAPE_SPHERE, (0.0,) * 3, (0.2, 0.0, 0.0), 1.0)
    params = body(M_A=np.diag([6.0] * 3 + [0.0] * 3), shapes=(shape,), r_g=(0.0,) * 3, thrusters=(), weight=50.0)
    hydro = Hydrodynamics([params], 0.01)
    hydro.wrenches["bias"][0, 0] = 13.0
    assert hydro.rates_of_change(0.0)[0][0, 0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("column", "value", "sound"),
    [
        (0, 1e11, True), (0, 1e13, False), (7, 9e5, True), (7, -2e6, False), (12, 2e6, False), (3, np.nan, False), (9, np.inf, False),
        (2, -np.inf, False),
    ],
)  # fmt: skip
def test_a_state_that_is_not_finite_or_absurdly_fast_is_found(column: int, value: float, sound: bool) -> None:
    s, x = np.zeros((6, 13)), np.empty(13)
    s[STATE, column] = value
    assert keep_state(s, x) == sound
    np.testing.assert_array_equal(x, s[STATE])


def test_a_retired_body_stays_where_it_is() -> None:
    hydro = Hydrodynamics([body(), body()], 0.02)
    hydro.state[:, 2], hydro.state[:, NU] = 40.0, 1.0
    hydro.retire(0)
    before = hydro.state[0].copy()
    assert hydro.advance(0.0) < 0
    np.testing.assert_array_equal(hydro.state[0], before)
    nu_dot, tau = hydro.rates_of_change(0.02)
    assert not nu_dot[0].any()
    assert not tau[0].any()
    assert nu_dot[1].any()


def test_python_calls_one_version_of_each_entry() -> None:
    run(body(appendages=FIN), 0.1)
    run(body(), 0.1)
    assert len(integrator.advance.signatures) == len(integrator.rates_of_change.signatures) <= 1  # type: ignore[attr-defined]
