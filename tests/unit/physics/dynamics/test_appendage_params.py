"""Parameters of fins, propellers, ballast and hulls, and the rows that kernels get of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uwserver.physics.dynamics.appendage_params import (
    Appendages,
    DerivativeParams,
    FoilParams,
    HullParams,
    PropellerParams,
    ServoParams,
    WeightParams,
    appendage_rates,
    appendage_rows,
    quadrant_coefficients,
    servo_rows,
)
from uwserver.physics.kernel.layout import HARMONICS, PROPELLER_SIZE

CURVE = ((0.0, 0.4, 0.05), (0.5, 0.3, 0.04), (1.0, 0.0, 0.01))
ALL = Appendages(
    servos=(ServoParams("shaft", -100.0, 80.0), ServoParams("rudder", -0.4, 0.3, rate=1.0, tau=0.1, neutral=0.05)),
    foils=(
        FoilParams("rudder", (-0.7, 0.0, 0.1), (0.0, 0.0, 2.0), (3.0, 0.0, 1.0), 5.0, 3.0, 0.1, 0.01, 1.2, 0.3, 0.5),
        FoilParams("", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), 1.0, 2.0, 0.1, 0.01, 1.2, 0.3, 0.5, whole=True),
    ),
    propellers=(PropellerParams("shaft", (-0.9, 0.0, 0.0), (5.0, 0.0, 0.0), 0.2, 1025.0, CURVE),),
    weights=(WeightParams("rudder", 10.0, (1.0, 2.0, 3.0), displaces=True),),
    derivatives=(DerivativeParams(1, 0, 5, -3.0), DerivativeParams(5, 0, 0, 2.0, "rudder", 2)),
    hulls=(HullParams((1.0, 2.0, 3.0, 0.1, 0.2, 0.3), 3.0, 2.0, 0.1, 4, 5.0, 6.0, True),),
)  # fmt: skip


def test_servos_rest_at_their_neutral_and_are_healthy() -> None:
    rows = servo_rows(ALL)
    assert rows["value"].tolist() == rows["command"].tolist() == [0.0, 0.05]
    assert rows["efficiency"].tolist() == [1.0, 1.0]
    assert rows["rate"].tolist() == [math.inf, 1.0]
    assert (rows["low"].tolist(), rows["high"].tolist()) == ([-100.0, -0.4], [80.0, 0.3])


def test_parts_name_the_rows_of_their_servos_in_the_world() -> None:
    rows = appendage_rows(ALL, 7)
    assert rows["foils"]["servo"].tolist() == [8, -1]
    assert rows["propellers"]["servo"].tolist() == [7]
    assert rows["weights"]["servo"].tolist() == [8]
    assert rows["derivatives"]["servo"].tolist() == [-1, 8]


def test_a_foil_s_axes_are_square_to_its_hinge() -> None:
    row = appendage_rows(ALL, 0)["foils"][0]
    np.testing.assert_allclose(
        row["chord"], [1.0, 0.0, 0.0], rtol=0.0, atol=1e-15
    )  # its part along the hinge is left out
    np.testing.assert_allclose(row["normal"], [0.0, 1.0, 0.0], rtol=0.0, atol=1e-15)


def test_axes_get_unit_length_and_curves_their_points() -> None:
    row = appendage_rows(ALL, 0)["propellers"][0]
    assert row["axis"].tolist() == [1.0, 0.0, 0.0]
    assert row["points"] == 3
    np.testing.assert_array_equal(np.stack([row[name][:3] for name in ("J", "KT", "KQ")], axis=1), CURVE)


def test_a_weight_adds_nothing_at_its_servo_s_neutral() -> None:
    row = appendage_rows(ALL, 0)["weights"][0]
    assert (row["zero"], row["force"], row["displaces"]) == (0.05, 10.0, 1)
    assert row["moment"].tolist() == [1.0, 2.0, 3.0]


def test_strips_cover_the_hull_from_aft() -> None:
    hull = ALL.hulls[0]
    assert hull.spacing == 0.5
    assert [hull.first + k * hull.spacing for k in range(4)] == pytest.approx([-0.65, -0.15, 0.35, 0.85])
    row = appendage_rows(ALL, 0)["hulls"][0]
    assert (row["sway"], row["heave"], row["joint"]) == (2.5, 3.0, 1)
    assert HullParams().spacing == 0.0


def test_nothing_fitted_gives_no_rows() -> None:
    assert {name: len(rows) for name, rows in appendage_rows(Appendages(), 0).items()} == dict.fromkeys(
        ("foils", "propellers", "weights", "derivatives", "hulls"), 0
    )
    assert len(servo_rows(Appendages())) == 0


@pytest.mark.parametrize("points", [1, PROPELLER_SIZE + 1])
def test_a_curve_that_does_not_fit_is_refused(points: int) -> None:
    curve = tuple((float(k), 0.1, 0.01) for k in range(points))
    given = Appendages(
        (ServoParams("shaft", 0.0, 1.0),),
        propellers=(PropellerParams("shaft", (0.0,) * 3, (1.0, 0.0, 0.0), 0.1, 1e3, curve),),
    )
    with pytest.raises(ValueError, match="propeller"):
        appendage_rows(given, 0)


FOUR = ((0.01, 0.0, 0.002, 0.0), (0.2, -0.7, 0.03, -0.1), (0.0, 0.05, 0.0, 0.01))


def test_coefficients_of_a_series_at_some_angles() -> None:
    found = quadrant_coefficients(FOUR, np.array([0.0, 0.5 * math.pi, -0.5 * math.pi, math.pi, 0.25 * math.pi]))
    half = math.sqrt(0.5)
    np.testing.assert_allclose(found[0], [0.21, -0.69, 0.71, -0.19, 0.01 + half * (0.2 - 0.7) + 0.05], atol=1e-15)
    np.testing.assert_allclose(found[1], [0.032, -0.098, 0.102, -0.028, 0.002 + half * (0.03 - 0.1) + 0.01], atol=1e-15)


@pytest.mark.parametrize("included", [False, True])
def test_a_propeller_in_four_quadrants_has_its_series_and_what_the_damping_has_of_it(included: bool) -> None:
    (propeller,) = ALL.propellers
    four = replace(propeller, curve=(), series=FOUR, damping_includes_stopped=included)
    row = appendage_rows(replace(ALL, propellers=(four,)), 0)["propellers"][0]
    assert (row["harmonics"], row["points"]) == (3, 0)
    np.testing.assert_array_equal(row["series"][:3], FOUR)
    assert not row["series"][3:].any()
    np.testing.assert_allclose(row["stopped"], [-0.69, -0.098, 0.71, 0.102] if included else 0.0, atol=1e-15)


def test_the_straight_line_of_a_propeller_ends_with_its_first_quadrant() -> None:
    """C_T* = 0.2 cos - 0.4 sin: no thrust at tan(beta) = 1/2, J = 0.35 pi; astern the mirror."""
    (propeller,) = ALL.propellers
    assert replace(propeller, astern=0.8).line == pytest.approx((0.4, 0.4, 0.8))
    rest, fall, astern = replace(propeller, curve=(), series=((0.0,) * 4, (0.2, -0.4, 0.0, 0.0))).line
    assert rest == pytest.approx(0.2 * math.pi / 8.0 * (0.7 * math.pi) ** 2)
    assert fall == pytest.approx(rest / (0.35 * math.pi), rel=0.02)
    assert astern == pytest.approx(1.0)


@pytest.mark.parametrize("terms", [HARMONICS + 1, 60])
def test_a_series_that_does_not_fit_is_refused(terms: int) -> None:
    (propeller,) = ALL.propellers
    with pytest.raises(ValueError, match=f"a propeller takes 1..{HARMONICS} terms of its series, not {terms}"):
        appendage_rows(replace(ALL, propellers=(replace(propeller, curve=(), series=((0.0,) * 4,) * terms),)), 0)


def test_the_reach_is_that_of_the_farthest_part() -> None:
    assert ALL.reach == pytest.approx(1.0)
    assert Appendages().reach == 0.0


# -- rates ----------------------------------------------------------------------------------------------------------------------------

ROOT = np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
"""Inverse square root of M = diag(4, 4, 4, 1, 1, 1)."""


def test_without_appendages_there_is_nothing_to_damp() -> None:
    rate_L, rate_Q, rate_S = appendage_rates(Appendages(), ROOT)
    assert (rate_L, rate_S) == (0.0, 0.0)
    assert not rate_Q.any()


def test_slow_damping_of_a_hull_is_the_largest_of_its_axes() -> None:
    rate_L, _, _ = appendage_rates(Appendages(hulls=(HullParams((8.0, 4.0, 0.0, 1.5, 0.0, 0.0)),)), ROOT)
    assert rate_L == pytest.approx(2.0)


def test_a_propeller_damps_by_its_steepest_piece_at_its_highest_speed() -> None:
    """dT/dV_a = rho D^3 |dK_T/dJ| n, on a body of 4 kg."""
    servos, propellers = ALL.servos, ALL.propellers
    rate_L, _, _ = appendage_rates(Appendages(servos, propellers=propellers), ROOT)
    assert rate_L >= 1025.0 * 0.2**3 * 0.6 * 100.0 / (2.0 * math.pi) / 4.0


def test_a_foil_s_rate_bounds_the_slope_of_its_force() -> None:
    foil = ALL.foils[0]
    _, rate_Q, rate_S = appendage_rates(Appendages(ALL.servos, foils=(foil,)), ROOT)
    # d(5 * 3 * v/u * u^2)/dv at speed u: 15 u, on 4 kg of sway alone.
    assert rate_S >= 15.0 / 4.0
    assert rate_Q[1] == rate_Q[2] == rate_S
    assert rate_Q[0] == 0.0


def test_a_term_with_a_servo_counts_at_its_largest_angle() -> None:
    term = DerivativeParams(5, 0, 1, 2.0, "rudder", 2)
    _, rate_Q, _ = appendage_rates(Appendages(ALL.servos, derivatives=(term,)), ROOT)
    np.testing.assert_allclose(rate_Q, [2.0 * 0.16 * 0.5, 2.0 * 0.16 * 0.5, 0.0, 0.0, 0.0, 0.0])


def test_a_propeller_in_four_quadrants_damps_with_the_shaft_and_with_the_speed() -> None:
    """C_T* = -sin(beta): T = -s V_a sqrt(V_a^2 + V_t^2), which falls by s V_t of the largest V_t, and by 2 s |V_a| at most."""
    propeller = PropellerParams(
        "shaft", (0.0,) * 3, (1.0, 0.0, 0.0), 0.2, 1e3, series=((0.0,) * 4, (0.0, -1.0, 0.0, 0.0))
    )
    rate_L, rate_Q, rate_S = appendage_rates(
        Appendages((ServoParams("shaft", -100.0, 50.0),), propellers=(propeller,)), ROOT
    )
    s = math.pi / 8.0 * 1e3 * 0.2**2
    at = 0.25
    assert rate_L == pytest.approx(s * 0.35 * 100.0 * 0.2 * at, rel=1e-4)
    assert rate_Q.tolist() == pytest.approx([4.0 * s * at] * 3 + [0.0] * 3, rel=1e-4)
    assert rate_S == 0.0
