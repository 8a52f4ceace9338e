"""A propeller by open-water curves and by a series in four quadrants, a foil at any angle of attack, and a servo."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.dynamics.appendage_forces import advance_servo, foil_coefficients, foil_force, propeller_force
from uwserver.physics.kernel.layout import FOIL, PROPELLER, SERVO

CURVE = np.array([[0.0, 0.40, 0.050], [0.4, 0.30, 0.042], [0.8, 0.10, 0.020]])
D, RHO = 0.2, 1025.0


def propeller(**changes: float) -> Any:
    row = np.zeros(1, PROPELLER)
    numbers = {"diameter": D, "density": RHO, "wake": 1.0, "deduction": 1.0, "astern": 1.0, "sense": -1.0} | changes
    for name, number in numbers.items():
        row[name] = number
    row["points"] = len(CURVE)
    row["J"][0, : len(CURVE)], row["KT"][0, : len(CURVE)], row["KQ"][0, : len(CURVE)] = CURVE.T
    return row[0]


def coefficients(n: float, J: float, **changes: float) -> tuple[float, float]:
    """K_T and K_Q found at n turns a second and an advance ratio."""
    thrust, torque = propeller_force(propeller(**changes), 2.0 * math.pi * n, J * abs(n) * D)
    return thrust / (RHO * n * n * D**4), -torque / (RHO * n * n * D**5)


@pytest.mark.parametrize(("J", "KT", "KQ"), CURVE.tolist())
@pytest.mark.parametrize("n", [1.0, 15.0])
def test_on_its_points_a_curve_is_met(n: float, J: float, KT: float, KQ: float) -> None:
    assert coefficients(n, J) == pytest.approx((KT, KQ))


def test_between_its_points_a_curve_is_straight() -> None:
    for J in (0.1, 0.2, 0.5, 0.79):
        assert coefficients(3.0, J) == pytest.approx(
            (np.interp(J, CURVE[:, 0], CURVE[:, 1]), np.interp(J, CURVE[:, 0], CURVE[:, 2]))
        )


def test_beyond_its_points_the_last_piece_goes_on() -> None:
    assert coefficients(2.0, 1.2)[0] == pytest.approx(0.10 - 0.5 * 0.4)
    assert coefficients(2.0, -0.4)[0] == pytest.approx(0.40 + 0.25 * 0.4)


def test_a_stopped_propeller_gives_nothing_and_a_slow_one_nothing_infinite() -> None:
    assert propeller_force(propeller(), 0.0, 2.0) == (0.0, 0.0)
    thrust, torque = propeller_force(propeller(), 1e-9, 2.0)
    assert abs(thrust) < 1e-6
    assert abs(torque) < 1e-6


def test_astern_it_is_the_mirror_of_itself() -> None:
    ahead = propeller_force(propeller(astern=0.7), 30.0, 1.0)
    astern = propeller_force(propeller(astern=0.7), -30.0, -1.0)
    assert astern == pytest.approx((-0.7 * ahead[0], -0.7 * ahead[1]))


def test_advance_ahead_helps_a_propeller_that_turns_astern() -> None:
    """Its inflow is from the other side: J is negative and the thrust astern larger than at rest."""
    assert propeller_force(propeller(), -30.0, 1.0)[0] < propeller_force(propeller(), -30.0, 0.0)[0] < 0.0


def test_wake_scales_the_inflow_and_deduction_the_thrust_alone() -> None:
    free = propeller_force(propeller(), 30.0, 0.8)
    slow = propeller_force(propeller(wake=0.8), 30.0, 1.0)
    assert slow == pytest.approx(free)
    thrust, torque = propeller_force(propeller(deduction=0.9), 30.0, 0.8)
    assert (thrust, torque) == pytest.approx((0.9 * free[0], free[1]))


@pytest.mark.parametrize("sense", [-1.0, 0.0, 1.0])
def test_the_hand_of_the_screw_turns_its_reaction(sense: float) -> None:
    torque = propeller_force(propeller(sense=sense), 30.0, 0.0)[1]
    assert torque == pytest.approx(sense * RHO * (30.0 / (2.0 * math.pi)) ** 2 * D**5 * 0.05)


# -- four quadrants ---------------------------------------------------------------------------------------------------------------------

SERIES = np.array(
    [[0.03, 0.0, 0.002, 0.0], [0.18, -0.75, 0.027, -0.11], [0.02, -0.01, -0.001, 0.003], [0.03, 0.10, 0.006, 0.016]]
)
SCALE = RHO * math.pi / 8.0 * D**2


def four(series: Any = SERIES, **changes: Any) -> Any:
    row = propeller(**changes)
    row["harmonics"] = len(series)
    row["series"][: len(series)] = series
    return row


def blade_speed(n: float) -> float:
    return 0.7 * math.pi * n * D


@pytest.mark.parametrize(
    ("n", "va"), [(5.0, 0.0), (5.0, 1.0), (0.0, 1.0), (-5.0, 1.0), (-5.0, -1.0), (5.0, -1.0), (0.0, -2.0), (1e-9, 0.5)]
)
def test_thrust_and_torque_are_the_series_at_the_advance_angle(n: float, va: float) -> None:
    """By angles, where the kernel has none."""
    beta, square = math.atan2(va, blade_speed(n)), va**2 + blade_speed(n) ** 2
    k = np.arange(len(SERIES))
    ct, cq = (SERIES[:, c] @ np.cos(k * beta) + SERIES[:, c + 1] @ np.sin(k * beta) for c in (0, 2))
    thrust, torque = propeller_force(four(), 2.0 * math.pi * n, va)
    assert thrust == pytest.approx(SCALE * square * ct, rel=1e-12)
    assert torque == pytest.approx(-SCALE * D * square * cq, rel=1e-12)


def test_squares_of_the_speeds_are_terms_of_the_series() -> None:
    """cos 2 beta is (V_t^2 - V_a^2) / (V_t^2 + V_a^2), sin 2 beta 2 V_t V_a over the same: polynomials without any singular place."""
    even = np.array([[0.0] * 4, [0.0] * 4, [0.7, 0.3, 0.0, 0.0]])
    for n, va in ((3.0, 0.5), (-3.0, 0.5), (0.0, -0.7), (2.0, 0.0)):
        vt = blade_speed(n)
        expected = SCALE * (0.7 * (vt**2 - va**2) + 0.3 * 2.0 * vt * va)
        assert propeller_force(four(even), 2.0 * math.pi * n, va)[0] == pytest.approx(expected, rel=1e-12)


def test_it_is_the_first_quadrant_s_curve_there() -> None:
    """K_T = pi/8 (J^2 + (0.7 pi)^2) C_T*, and K_Q likewise."""
    for J in (0.0, 0.3, 0.8):
        thrust, torque = propeller_force(four(), 2.0 * math.pi * 6.0, J * 6.0 * D)
        KT, KQ = thrust / (RHO * 36.0 * D**4), -torque / (RHO * 36.0 * D**5)
        beta, k = math.atan2(J, 0.7 * math.pi), np.arange(len(SERIES))
        factor = math.pi / 8.0 * (J**2 + (0.7 * math.pi) ** 2)
        assert pytest.approx(factor * (SERIES[:, 0] @ np.cos(k * beta) + SERIES[:, 1] @ np.sin(k * beta))) == KT
        assert pytest.approx(factor * (SERIES[:, 2] @ np.cos(k * beta) + SERIES[:, 3] @ np.sin(k * beta))) == KQ


def test_at_rest_in_still_water_there_is_nothing() -> None:
    assert propeller_force(four(), 0.0, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("va", [1.0, -1.0])
def test_a_stopped_one_drags_by_the_square_of_the_speed(va: float) -> None:
    slow, fast = (propeller_force(four(), 0.0, factor * va)[0] for factor in (1.0, 3.0))
    assert fast == pytest.approx(9.0 * slow)
    assert slow * va < 0.0


@pytest.mark.parametrize("va", [1.2, -0.7])
def test_it_is_smooth_where_the_shaft_and_where_the_water_turns_round(va: float) -> None:
    """Value and slope from both sides, through n = 0 and through V_a = 0."""
    step = 1e-4
    for at in (lambda x: propeller_force(four(), x, va), lambda x: propeller_force(four(), 20.0 * va, x)):
        left, middle, right = (np.array(at(x)) for x in (-step, 0.0, step))
        np.testing.assert_allclose(right, left, atol=1e-2)
        np.testing.assert_allclose(right - middle, middle - left, rtol=1e-2, atol=1e-8)


def test_what_the_hull_s_damping_has_is_not_counted_again() -> None:
    """The drag of the stopped propeller is taken away at every shaft speed, as the hull drags on alike."""
    stopped = [-0.8, -0.1, 0.7, 0.09]
    for n, va in ((0.0, 1.5), (0.0, -1.5), (5.0, 1.0), (-5.0, 1.0), (5.0, -1.0), (5.0, 0.0)):
        plain, less = (propeller_force(four(**extra), 2.0 * math.pi * n, va) for extra in ({}, {"stopped": stopped}))
        ct, cq = stopped[:2] if va > 0.0 else stopped[2:]
        assert less[0] == pytest.approx(plain[0] - SCALE * va**2 * ct)
        assert less[1] == pytest.approx(plain[1] + SCALE * D * va**2 * cq)


def test_wake_deduction_and_hand_are_those_of_the_curves() -> None:
    whole = propeller_force(four(), 30.0, 0.8)
    assert propeller_force(four(wake=0.8), 30.0, 1.0) == pytest.approx(whole)
    assert propeller_force(four(deduction=0.9), 30.0, 0.8) == pytest.approx((0.9 * whole[0], whole[1]))
    assert propeller_force(four(sense=1.0), 30.0, 0.8) == pytest.approx((whole[0], -whole[1]))


STALL, STALL_END = 0.3, 0.5


def foil(**changes: float) -> Any:
    row = np.zeros(1, FOIL)
    numbers = {
        "pressure_area": 10.0, "slope": 3.0, "induced": 0.12, "cd0": 0.01, "cd90": 1.2, "stall": STALL, "stall_end": STALL_END,
    } | changes  # fmt: skip
    for name, number in numbers.items():
        row[name] = number
    return row[0]


@pytest.mark.parametrize("alpha", [-0.29, -0.1, 0.0, 0.05, 0.3])
def test_attached_flow_is_a_lifting_line(alpha: float) -> None:
    lift = 3.0 * alpha
    assert foil_coefficients(foil(), alpha) == pytest.approx((lift, 0.01 + 0.12 * lift**2))


@pytest.mark.parametrize("alpha", [0.5, 1.0, math.pi / 2, 2.5, -0.7, -3.0])
def test_separated_flow_is_a_flat_plate(alpha: float) -> None:
    """Its force is square to the plate but for the friction: C_L sin - C_D cos along the chord is that of cd0 alone."""
    lift, drag = foil_coefficients(foil(), alpha)
    normal = lift * math.cos(alpha) + (drag - 0.01) * math.sin(alpha)
    along = lift * math.sin(alpha) - (drag - 0.01) * math.cos(alpha)
    assert normal == pytest.approx(1.2 * math.sin(alpha))
    assert along == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seam", [STALL, STALL_END])
def test_nothing_jumps_at_the_seams(seam: float) -> None:
    below, above = (np.array(foil_coefficients(foil(), seam + d)) for d in (-1e-9, 1e-9))
    np.testing.assert_allclose(above, below, rtol=0.0, atol=1e-7)


def test_both_sides_are_alike() -> None:
    for alpha in np.linspace(0.0, math.pi, 40):
        lift, drag = foil_coefficients(foil(), float(alpha))
        assert foil_coefficients(foil(), -float(alpha)) == pytest.approx((-lift, drag))


def test_drag_is_against_the_motion_and_lift_towards_the_normal() -> None:
    along, normal = foil_force(foil(), 0.1, 2.0, 0.0, 4.0)  # ahead, turned to lift
    assert along == pytest.approx(-40.0 * (0.01 + 0.12 * 0.09))
    assert normal == pytest.approx(40.0 * 0.3)
    along, normal = foil_force(foil(), 0.0, 0.0, 1.0, 1.0)  # the plate moves along its own normal
    assert normal == pytest.approx(-10.0 * (1.2 + 0.01))
    assert along == pytest.approx(0.0, abs=1e-12)


def test_the_angle_of_attack_counts_and_not_how_it_came_about() -> None:
    """Turned by 0.1 in straight flow, or straight in flow that comes from 0.1 below: the same lift and drag about the flow."""
    turned = foil_force(foil(), 0.1, 2.0, 0.0, 4.0)
    c, s = 2.0 * math.cos(-0.1), 2.0 * math.sin(-0.1)
    along, normal = foil_force(foil(), 0.0, c, s, 4.0)
    drag, lift = -(along * c + normal * s) / 2.0, (normal * c - along * s) / 2.0
    assert (drag, lift) == pytest.approx((-turned[0], turned[1]))


def test_no_motion_is_no_force_whatever_the_pressure() -> None:
    assert foil_force(foil(), 0.3, 0.0, 0.0, 4.0) == (0.0, 0.0)


def test_angles_beyond_half_a_turn_come_round() -> None:
    """Astern with the fin turned: the angle of attack is 0.2 from behind, whichever way it was counted."""
    for angle in (0.2, -0.2):
        assert foil_force(foil(), angle, -1.0, 1e-12, 1.0) == pytest.approx(
            foil_force(foil(), angle, -1.0, -1e-12, 1.0)
        )


def test_a_fixed_foil_only_takes_energy() -> None:
    rng = np.random.default_rng(2)
    for angle, ahead, across in rng.uniform(-1.5, 1.5, (300, 3)):
        along, normal = foil_force(foil(), angle, ahead, across, ahead**2 + across**2)
        assert along * ahead + normal * across <= 0.0


def servo(command: float, value: float = 0.0, rate: float = math.inf, tau: float = 0.0, limit: float = 10.0) -> Any:
    row = np.zeros(1, SERVO)
    row["command"], row["value"], row["rate"], row["tau"] = command, value, rate, tau
    row["low"], row["high"] = -limit, limit
    return row[0]


def test_without_rate_and_lag_it_is_there_at_once() -> None:
    row = servo(0.7)
    assert advance_servo(row, 1e-3) == 0.7
    assert row["value"] == 0.7


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_rate_alone_is_a_straight_line_to_the_command(sign: float) -> None:
    row = servo(sign * 1.0, rate=2.0)
    assert [advance_servo(row, 0.2) for _ in range(4)] == pytest.approx([sign * x for x in (0.4, 0.8, 1.0, 1.0)])


def test_a_lag_alone_is_an_exponential() -> None:
    row = servo(2.0, value=1.0, tau=0.5)
    assert advance_servo(row, 0.3) == pytest.approx(2.0 - math.exp(-0.6), rel=1e-14)


def test_rate_and_lag_join_where_the_error_is_rate_times_tau() -> None:
    """From 0 to 1 at 2/s with 0.1 s: straight for 0.4 s until 0.2 is left, exponential from there, with the same slope."""
    assert advance_servo(servo(1.0, rate=2.0, tau=0.1), 0.4) == pytest.approx(0.8, rel=1e-14)
    assert advance_servo(servo(1.0, rate=2.0, tau=0.1), 0.5) == pytest.approx(1.0 - 0.2 * math.exp(-1.0), rel=1e-14)
    before, after = (advance_servo(servo(1.0, rate=2.0, tau=0.1), 0.4 + d) for d in (-1e-6, 1e-6))
    assert after - before == pytest.approx(2.0 * 2e-6, rel=1e-4)


@pytest.mark.parametrize(("rate", "tau"), [(math.inf, 0.3), (0.7, 0.0), (0.7, 0.3), (5.0, 0.01)])
def test_many_steps_are_one(rate: float, tau: float) -> None:
    whole, cut = servo(1.0, value=-1.0, rate=rate, tau=tau), servo(1.0, value=-1.0, rate=rate, tau=tau)
    for _ in range(50):
        advance_servo(cut, 0.01)
    assert advance_servo(whole, 0.5) == pytest.approx(cut["value"], abs=1e-12)


@pytest.mark.parametrize(("command", "limit"), [(50.0, 3.0), (-50.0, -3.0)])
def test_it_goes_no_farther_than_its_limits(command: float, limit: float) -> None:
    assert advance_servo(servo(command, limit=3.0), 1.0) == limit


def test_no_rate_is_stuck() -> None:
    row = servo(1.0, value=0.25, rate=0.0, tau=0.1)
    for _ in range(5):
        assert advance_servo(row, 0.5) == 0.25


def test_at_its_goal_it_stays_there() -> None:
    assert advance_servo(servo(0.3, value=0.3, rate=1.0, tau=0.1), 10.0) == 0.3
