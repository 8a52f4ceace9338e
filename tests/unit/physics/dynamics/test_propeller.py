"""Open-water curves of a propeller: on their points, between, beyond, at rest and astern."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.dynamics.propeller import propeller_force
from uwserver.physics.kernel.layout import PROPELLER

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
