"""Parameters of bodies and thrusters, lags against exact solutions, and the rows that kernels get of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uwserver.physics.dynamics.appendage_params import Appendages, HullParams
from uwserver.physics.dynamics.params import (
    BodyParams,
    BuoyancyShape,
    ForceTable,
    Lag,
    ThrusterParams,
    body_row,
    damping_rates,
    expm,
    lag_row,
    rigid_body_inertia,
    shape_rows,
    table_row,
    thruster_row,
    wrench_rows,
)
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import LAG, LAG_LEVELS, SHAPE_BOX, SHAPE_SPHERE, TABLE_SIZE, TABLE_VOLTAGES

ZERO = np.zeros((6, 6))
I_C = np.array([[0.4, 0.02, -0.01], [0.02, 0.5, 0.03], [-0.01, 0.03, 0.6]])
TABLE_12V = ForceTable((12.0,), (((-1.0, -30.0), (0.0, 0.0), (1.0, 40.0)),))


def body(**changes: object) -> BodyParams:
    plain = BodyParams(
        np.diag([10.0] * 3 + [1.0] * 3), np.diag([5.0] * 6), ZERO, ZERO, ZERO, 98.1, 100.0, (0.0,) * 3, (0.0,) * 3
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


# -- inertia --------------------------------------------------------------------------------------------------------------------------


def test_inertia_about_the_centre_of_mass_is_not_coupled() -> None:
    M = rigid_body_inertia(12.0, I_C, (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(M[:3, :3], 12.0 * np.eye(3))
    np.testing.assert_array_equal(M[3:, 3:], I_C)
    assert not M[:3, 3:].any()


def test_inertia_gives_the_energy_of_the_centre_of_mass_and_of_the_turn_about_it() -> None:
    rng = np.random.default_rng(5)
    r_g = np.array([0.05, -0.03, 0.08])
    M = rigid_body_inertia(12.0, I_C, tuple(r_g))
    np.testing.assert_allclose(M, M.T, rtol=0.0, atol=1e-15)
    for nu in rng.normal(size=(20, 6)):
        v_g = nu[:3] + np.cross(nu[3:], r_g)
        assert nu @ M @ nu == pytest.approx(12.0 * v_g @ v_g + nu[3:] @ I_C @ nu[3:])


# -- body rows ------------------------------------------------------------------------------------------------------------------------


def test_a_row_has_the_inverse_of_the_whole_inertia() -> None:
    row = body_row(body())[0]
    np.testing.assert_allclose(row["M_inv"] @ (row["M_RB"] + row["M_A"]), np.eye(6), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize(("D", "form"), [(ZERO, 0), (np.diag([1.0, 0.0, 2.0, 0.0, 0.0, 0.0]), 1), (np.eye(6)[::-1], 2)])
def test_the_form_of_a_matrix_tells_what_may_be_left_out(D: np.ndarray, form: int) -> None:
    row = body_row(body(D_L=D, D_Q=D, D_S=D))[0]
    assert {row[f"form_{name}"] for name in ("D_L", "D_Q", "D_S")} == {form}


def test_displaced_mass_follows_from_the_buoyancy_unless_it_is_given() -> None:
    assert body_row(body())["displaced"][0] == pytest.approx(100.0 / 9.81)
    assert body_row(body(displaced=12.5))["displaced"][0] == 12.5


def test_a_body_is_fitted_if_it_has_any_appendage() -> None:
    assert body_row(body())["fitted"][0] == 0
    assert body_row(body(appendages=Appendages(hulls=(HullParams(),))))["fitted"][0] == 1


def test_the_radius_reaches_all_that_the_surface_may_cut() -> None:
    shape = BuoyancyShape(SHAPE_SPHERE, (0.3, 0.0, 0.0), (0.1, 0.0, 0.0), 1.0)
    box = BuoyancyShape(SHAPE_BOX, (-0.3, 0.0, 0.0), (0.2, 0.1, 0.2), 1.0)
    thruster = ThrusterParams("t", (0.0, 0.9, 0.0), (1.0, 0.0, 0.0), TABLE_12V, 12.0, Lag(), disc_radius=0.05)
    assert body_row(body())["radius"][0] == 0.0
    assert body_row(body(shapes=(shape, box)))["radius"][0] == pytest.approx(0.3 + 0.3)
    assert body_row(body(shapes=(shape, box), thrusters=(thruster,)))["radius"][0] == pytest.approx(0.95)


def test_shapes_are_moved_together_to_the_centre_of_buoyancy() -> None:
    heavy = BuoyancyShape(SHAPE_BOX, (1.0, 0.0, 0.0), (0.1,) * 3, 0.03)
    light = BuoyancyShape(SHAPE_BOX, (-1.0, 0.0, 0.0), (0.1,) * 3, 0.01)
    rows = shape_rows(body(shapes=(heavy, light), r_b=(0.0, 0.0, -0.2)))
    assert rows["share"].tolist() == pytest.approx([0.75, 0.25])
    np.testing.assert_allclose(rows["share"] @ rows["center"], [0.0, 0.0, -0.2], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(rows["center"][0] - rows["center"][1], [2.0, 0.0, 0.0])
    assert len(shape_rows(body())) == 0


# -- damping rates --------------------------------------------------------------------------------------------------------------------


def test_the_rate_of_diagonal_damping_is_that_of_its_quickest_axis() -> None:
    rate_L, rate_Q, rate_S = damping_rates(
        body(D_L=np.diag([15.0, 30.0, 3.0, 0.6, 0.0, 0.0]), D_S=np.diag([1.5] * 3 + [0.0] * 3))
    )
    assert rate_L == pytest.approx(2.0)
    assert rate_S == pytest.approx(0.2)
    assert not rate_Q.any()


def test_quadratic_damping_counts_with_its_slope_axis_by_axis() -> None:
    _, rate_Q, _ = damping_rates(body(D_Q=np.diag([30.0, 15.0, 0.0, 6.0, 0.0, 0.0])))
    np.testing.assert_allclose(rate_Q, [4.0, 2.0, 0.0, 2.0, 0.0, 0.0])


def test_rates_bound_the_true_ones_of_full_matrices() -> None:
    """Eigenvalues of M^-1 times the damping's Jacobian, at random velocities."""
    rng = np.random.default_rng(6)
    root = rng.normal(size=(6, 6))
    full = body(
        M_A=root @ root.T, D_L=rng.normal(size=(6, 6)), D_Q=rng.normal(size=(6, 6)), D_S=rng.normal(size=(6, 6))
    )
    rate_L, rate_Q, rate_S = damping_rates(full)
    for nu in rng.normal(size=(100, 6)):
        J = full.D_L + 2.0 * full.D_Q * np.abs(nu) + full.D_S * abs(nu[0])
        J[:, 0] += full.D_S @ nu * np.sign(nu[0])
        true = np.abs(np.linalg.eigvals(np.linalg.solve(full.M_RB + full.M_A, J))).max()
        # rate_S counts 2 |u| D_S, the derivative by u in it where the velocity is along u.
        assert true <= rate_L + rate_Q @ np.abs(nu) + rate_S * np.linalg.norm(nu) + 1e-12


def test_a_stopped_thruster_damps_along_its_line() -> None:
    """c |V_a| V_a at a mount 0.5 m to starboard, ahead: V_a = u - 0.5 r. Slope 2 c |V_a|, over 10 kg and 2 kg m2."""
    thruster = ThrusterParams("t", (0.0, 0.5, 0.0), (2.0, 0.0, 0.0), TABLE_12V, 12.0, Lag(), drag=3.0)
    bare, dragged = (
        damping_rates(body(M_RB=np.diag([10.0, 10.0, 10.0, 2.0, 2.0, 2.0]), M_A=np.zeros((6, 6)), thrusters=each))
        for each in ((), (thruster,))
    )
    np.testing.assert_allclose(dragged[1] - bare[1], 6.0 * (1 / 10 + 0.25 / 2) * np.array([1.0, 0, 0, 0, 0, 0.5]))
    assert dragged[0] == bare[0]


# -- thrusters ------------------------------------------------------------------------------------------------------------------------


def test_a_thruster_row_has_wrench_and_inflow_of_its_mount() -> None:
    params = ThrusterParams("t", (0.1, 0.2, 0.3), (0.0, 0.0, 2.0), TABLE_12V, 12.0, Lag(), torque_per_force=0.05)
    row = thruster_row(params, 3, 4)[0]
    np.testing.assert_allclose(row["per_force"], [0.0, 0.0, 1.0, 0.2, -0.1, 0.05])
    np.testing.assert_allclose(row["per_velocity"], [0.0, 0.0, 1.0, 0.2, -0.1, 0.0])
    assert (row["table"], row["lag"], row["efficiency"], row["demand"]) == (3, 4, 1.0, 0.0)


def test_curves_of_a_table_are_padded_by_their_last_point() -> None:
    row = table_row(ForceTable((12.0, 16.0), (TABLE_12V.curves[0], ((0.0, 1.0), (1.0, 2.0)))))[0]
    assert row["n_voltages"] == 2
    assert row["voltage"][:2].tolist() == [12.0, 16.0]
    assert row["u"][0, :4].tolist() == [-1.0, 0.0, 1.0, 1.0]
    assert row["force"][1, 1:].tolist() == [2.0] * (TABLE_SIZE - 1)


@pytest.mark.parametrize(
    "table",
    [
        ForceTable((), ()),
        ForceTable(tuple(map(float, range(TABLE_VOLTAGES + 1))), TABLE_12V.curves * (TABLE_VOLTAGES + 1)),
        ForceTable((12.0,), (((0.0, 0.0),),)),
        ForceTable((12.0,), (tuple((float(k), 0.0) for k in range(TABLE_SIZE + 1)),)),
    ],
)
def test_a_table_that_does_not_fit_is_refused(table: ForceTable) -> None:
    with pytest.raises(ValueError, match="force table"):
        table_row(table)


def test_a_lag_row_is_the_transition_of_the_tick() -> None:
    lag = Lag.first_order(0.2)
    row = lag_row(lag, 0.02)[0]
    for name, values in zip(("F", "G", "C", "D"), lag.transition(0.02), strict=True):
        np.testing.assert_array_equal(row[name], values)
    assert row.dtype == LAG


def test_wrenches_begin_at_zero() -> None:
    rows = wrench_rows(3)
    assert rows.tobytes() == bytes(rows.nbytes)


DT = 0.02


def response(lag: Lag, level: int, seconds: float) -> FloatArray:
    """Output at the end of each half sub-step after a unit step, from rest."""
    F, G, C, D = lag.transition(DT)
    x, out = np.zeros(3), []
    for _ in range(round(seconds / (0.5 * DT / 2**level))):
        x = F[level] @ x + G[level]
        out.append(C @ x + D)
    return np.array(out)


@pytest.mark.parametrize("level", range(LAG_LEVELS))
@pytest.mark.parametrize("tau", [0.01, 0.2, 5.0])
def test_a_first_order_lag_is_an_exponential_at_each_number_of_sub_steps(tau: float, level: int) -> None:
    h = 0.5 * DT / 2**level
    found = response(Lag.first_order(tau), level, 0.4)
    t = h * np.arange(1, len(found) + 1)
    np.testing.assert_allclose(found, 1.0 - np.exp(-t / tau), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("tau", [0.0, -1.0])
def test_no_time_constant_is_no_lag(tau: float) -> None:
    lag = Lag.first_order(tau)
    assert lag == Lag()
    np.testing.assert_array_equal(response(lag, 0, 0.1), 1.0)


def test_a_third_order_lag_with_known_poles() -> None:
    """(s + 1)(s + 2)(s + 4) below 8: partial fractions give 1 - 8/3 e^-t + 2 e^-2t - 1/3 e^-4t."""
    lag = Lag((8.0, 0.0, 0.0), (8.0, 14.0, 7.0))
    found = response(lag, 2, 2.0)
    t = 0.5 * DT / 4 * np.arange(1, len(found) + 1)
    exact = 1.0 - 8.0 / 3.0 * np.exp(-t) + 2.0 * np.exp(-2.0 * t) - np.exp(-4.0 * t) / 3.0
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-10)


def test_zeros_of_the_numerator_lead_and_keep_the_gain_at_rest() -> None:
    """With b1 the output begins with a slope, without it with none; both end at b0 / a0."""
    denominator = (8.0, 14.0, 7.0)
    plain, leading = Lag((16.0, 0.0, 0.0), denominator), Lag((16.0, 0.0, 3.0), denominator)
    assert response(leading, 0, 0.1)[0] > 10.0 * response(plain, 0, 0.1)[0]
    for lag in (plain, leading):
        assert response(lag, 0, 30.0)[-1] == pytest.approx(2.0, rel=1e-9)


def test_two_half_sub_steps_of_a_level_are_one_of_the_level_above() -> None:
    F, G, _, _ = Lag((8.0, 1.0, 0.5), (8.0, 14.0, 7.0)).transition(DT)
    for level in range(1, LAG_LEVELS):
        np.testing.assert_allclose(F[level] @ F[level], F[level - 1], rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(F[level] @ G[level] + G[level], G[level - 1], rtol=0.0, atol=1e-13)


def test_the_exponential_of_a_turn_is_a_rotation() -> None:
    for angle in (1e-9, 0.3, 3.0, 40.0):
        c, s = math.cos(angle), math.sin(angle)
        found = expm(np.array([[0.0, -angle], [angle, 0.0]]))
        np.testing.assert_allclose(found, [[c, -s], [s, c]], rtol=0.0, atol=1e-12 * max(1.0, angle))


def test_the_exponential_of_a_nilpotent_matrix_is_its_series() -> None:
    M = np.array([[0.0, 2.0, 1.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(expm(M), np.eye(3) + M + 0.5 * M @ M, rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(expm(np.zeros((4, 4))), np.eye(4))
