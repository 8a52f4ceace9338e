"""What faults make of a hull: all changes add up, whatever their order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from uwserver.physics.dynamics.params import rigid_body_inertia
from uwserver.world.faults.hull import Hull, left_inertia, left_volume
from uwserver.world.faults.table import BuoyancyChange, MassLoss

HULL = Hull(rigid_body_inertia(10.0, np.diag([1.0, 2.0, 3.0]), (0.0, 0.0, 0.1)), (0.0, 0.0, 0.1), 0.01, 10_000.0)


@pytest.mark.parametrize(
    ("change", "volume"), [({"volume_m3": 0.002}, 0.012), ({"fraction": -0.5}, 0.005), ({"force_N": -20.0}, 0.008)]
)
def test_the_three_ways_to_say_a_volume(change: dict[str, float], volume: float) -> None:
    assert left_volume(HULL, [BuoyancyChange(target="rov", **change)]) == pytest.approx(volume)


def test_changes_of_volume_add_up_and_ballast_is_none() -> None:
    changes = [BuoyancyChange(target="rov", fraction=0.5), BuoyancyChange(target="rov", fraction=0.5)]
    assert left_volume(HULL, [*changes, MassLoss(target="rov", mass_kg=1.0)]) == pytest.approx(0.02)


def test_lost_ballast_takes_its_mass_and_its_moments_in_any_order() -> None:
    losses = [
        MassLoss(target="rov", mass_kg=1.0, position_frd_m=(0.5, 0.0, 0.0)),
        MassLoss(target="rov", mass_kg=2.0, position_frd_m=(0.0, 0.2, 0.1)),
        MassLoss(target="rov", mass_kg=0.5),
    ]
    expected = HULL.M_RB.copy()
    for mass, place in ((1.0, (0.5, 0.0, 0.0)), (2.0, (0.0, 0.2, 0.1)), (0.5, HULL.r_g)):
        expected -= rigid_body_inertia(mass, np.zeros((3, 3)), place)
    for order in itertools.permutations(losses):
        assert np.allclose(left_inertia(HULL, order), expected, rtol=0, atol=1e-12)
    assert HULL.M_RB[0, 0] == 10.0, "the hull without faults must stay"


def test_a_volume_of_no_change_is_no_inertia() -> None:
    assert np.array_equal(left_inertia(HULL, [BuoyancyChange(target="rov", fraction=1.0)]), HULL.M_RB)
