"""Lift and drag of a foil: the laws on either side of stall, their seam, signs, and that it only takes energy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.dynamics.foil import foil_coefficients, foil_force
from uwserver.physics.kernel.layout import FOIL

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
