"""Tables of fins, propellers, ballast, moving masses and hulls: numbers need a source, limits hold, and defaults are what the docs say."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec import UNSET

from uwserver.physics.kernel.layout import HARMONICS, PROPELLER_SIZE
from uwserver.scenario.vehicle.appendage_tables import (
    Ballast,
    CrossFlow,
    Fin,
    Foil,
    Hull,
    HullDerivatives,
    MovingMass,
    ShaftPropeller,
    SlowDamping,
)

SOURCE = {"source": "x", "status": "guess"}
HERE = [0.0, 0.0, 0.0]
GOOD: dict[Any, dict[str, Any]] = {
    Foil: {"position_frd_m": HERE, "hinge_frd": HERE},
    Fin: {"position_frd_m": HERE, "hinge_frd": HERE, "limit_deg": 20.0},
    ShaftPropeller: {"position_frd_m": HERE, "diameter_m": 0.2, "max_speed_radps": 100.0},
    Ballast: {"position_frd_m": HERE, "form": "tank", "max_volume_m3": 1e-3, "rate_m3ps": 1e-5},
    MovingMass: {"mass_kg": 1.0, "min_position_m": -0.1, "max_position_m": 0.1, "rate_mps": 0.01},
    CrossFlow: {"length_m": 1.0, "height_m": 0.2, "width_m": 0.2, "sway_drag": 1.0},
    SlowDamping: {"diagonal": [1.0] * 6, "fading_mps": 0.3},
    HullDerivatives: {"terms": {"Yur": 5.0}},
}


@pytest.mark.parametrize("table", GOOD, ids=lambda table: table.__name__)
def test_every_table_of_numbers_needs_source_and_status(table: Any, tree_of, report) -> None:
    assert tree_of({**SOURCE, **GOOD[table]}, table).value is not None
    assert report.lines == []
    assert tree_of(GOOD[table], table).value is None
    assert report.lines == [': missing key "source"', ': missing key "status"']


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        (Foil, {"stall_deg": 179}),
        (Foil, {"area_m2": -1}),
        (Foil, {"hinge_frd": [0, 1]}),
        (Foil, {"inflow": "axial"}),
        (Fin, {"limit_deg": 0}),
        (Fin, {"rate_degps": -1}),
        (ShaftPropeller, {"diameter_m": 0}),
        (ShaftPropeller, {"curve": [HERE]}),
        (ShaftPropeller, {"curve": [HERE] * (PROPELLER_SIZE + 1)}),
        (ShaftPropeller, {"pitch_ratio": 0.4}),
        (ShaftPropeller, {"pitch_ratio": 1.5}),
        (ShaftPropeller, {"quadrants": [[0.0] * 3]}),
        (ShaftPropeller, {"quadrants": [[0.0] * 4] * (HARMONICS + 1)}),
        (ShaftPropeller, {"wake_fraction": 1}),
        (ShaftPropeller, {"thrust_deduction": -0.1}),
        (ShaftPropeller, {"handedness": "up"}),
        (Ballast, {"form": "bag"}),
        (Ballast, {"rate_m3ps": 0}),
        (MovingMass, {"mass_kg": -1}),
        (CrossFlow, {"strips": 0}),
        (CrossFlow, {"strips": 101}),
        (SlowDamping, {"fading_mps": 0}),
        (SlowDamping, {"diagonal": [1.0] * 5}),
        (SlowDamping, {"diagonal": [-1.0] * 6}),
        (HullDerivatives, {"reference_density_kgpm3": 0}),
    ],
)
def test_limits_hold(table: Any, keys: dict[str, Any], tree_of, report) -> None:
    assert tree_of({**SOURCE, **GOOD[table], **keys}, table).value is None
    assert report.lines


def test_a_fin_is_a_foil_that_turns_at_any_rate_unless_one_is_given() -> None:
    fin = msgspec.convert({**SOURCE, **GOOD[Fin]}, Fin)
    assert isinstance(fin, Foil)
    assert (fin.rate_degps, fin.time_constant_s, fin.derivatives) == (UNSET, 0.0, {})
    assert (fin.chord_frd, fin.stall_deg, fin.inflow) == ((1.0, 0.0, 0.0), 15.0, "plane")


def test_a_propeller_drives_ahead_with_the_whole_inflow_and_no_reaction() -> None:
    propeller = msgspec.convert({**SOURCE, **GOOD[ShaftPropeller]}, ShaftPropeller)
    assert propeller.axis_frd == (1.0, 0.0, 0.0)
    assert (propeller.wake_fraction, propeller.thrust_deduction, propeller.handedness) == (0.0, 0.0, "none")


def test_a_propeller_without_a_curve_has_four_quadrants_and_a_drag_of_its_own_when_it_is_stopped() -> None:
    propeller = msgspec.convert({**SOURCE, **GOOD[ShaftPropeller]}, ShaftPropeller)
    assert (propeller.curve, propeller.quadrants, propeller.pitch_ratio) == (UNSET, UNSET, UNSET)
    assert not propeller.damping_includes_stopped


def test_a_hull_has_nothing_beyond_its_matrices_unless_it_is_given() -> None:
    assert (Hull().cross_flow, Hull().slow_damping, Hull().derivatives) == (UNSET, UNSET, UNSET)
