"""What can fail, why a fault is not possible, what faults of a hull leave of it, and what the kinds of extensions build."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from uwserver.physics.dynamics.params import rigid_body_inertia
from uwserver.world.faults.table import (
    BuoyancyChange,
    FaultTable,
    MassLoss,
    SensorFrozen,
    SensorSilent,
    ThrusterDead,
    ThrusterWeak,
)
from uwserver.world.faults.targets import Hull, Targets, effects, left_inertia, left_volume, refusals

HULL = Hull(rigid_body_inertia(10.0, np.diag([1.0, 1.0, 1.0]), (0.0, 0.0, 0.0)), (0.0, 0.0, 0.0), 0.01, 10_000.0)
TARGETS = Targets({"rov": HULL, "dry": HULL._replace(water=0.0)}, {"rov/thrusters": ("t1", "t2")}, ("rov/imu",))


class Leaky(FaultTable, tag="leaky", kw_only=True, frozen=True):
    gives: Any = ()

    def build(self, targets: Targets, rng: np.random.Generator) -> Any:
        assert targets is TARGETS
        return self.gives


@pytest.mark.parametrize(
    ("fault", "key", "text"),
    [
        (SensorSilent(target="rov/imu", at_s=5.0, until_s=5.0), "until_s", "not after its begin"),
        (SensorFrozen(target="rov/gps"), "target", 'no sensor "rov/gps", there are: rov/imu'),
        (ThrusterDead(target="rov"), "target", "no actuator of thrusters"),
        (MassLoss(target="auv", mass_kg=1.0), "target", 'no vehicle "auv", there are: rov, dry'),
        (ThrusterWeak(target="rov/thrusters", factor=0.1, members=("t1", "t3")), "members", 'no thruster "t3"'),
        (MassLoss(target="rov", mass_kg=10.0), "mass_kg", "leaves no mass"),
        (BuoyancyChange(target="rov", volume_m3=-0.02), "volume_m3", "takes away more than"),
        (BuoyancyChange(target="rov", fraction=9.5), "fraction", "more than 10 times"),
        (BuoyancyChange(target="dry", force_N=1.0), "force_N", "without gravity"),
    ],
)
def test_each_reason_names_its_key(fault: Any, key: str, text: str) -> None:
    [(where, why)] = refusals(fault, TARGETS)
    assert where == key
    assert text in why


@pytest.mark.parametrize(
    "fault",
    [
        ThrusterDead(target="rov/thrusters", members=("t2",)),
        SensorSilent(target="rov/imu", at_s=1.0, until_s=2.0),
        MassLoss(target="rov", mass_kg=9.0),
        BuoyancyChange(target="rov", fraction=-1.0),
        BuoyancyChange(target="dry", fraction=1.0),
    ],
)
def test_what_can_be_has_no_reason_against_it(fault: Any) -> None:
    assert list(refusals(fault, TARGETS)) == []


def test_faults_of_one_hull_count_together_and_those_of_others_do_not() -> None:
    half = MassLoss(target="rov", mass_kg=5.0)
    assert list(refusals(half, TARGETS, [MassLoss(target="dry", mass_kg=5.0)])) == []
    [(key, _)] = refusals(half, TARGETS, [half])
    assert key == "mass_kg"


def test_a_shipped_kind_is_its_own_effect_and_an_extensions_has_many() -> None:
    rng, dead, silent = np.random.default_rng(1), ThrusterDead(target="rov/thrusters"), SensorSilent(target="rov/imu")
    assert effects("a", dead, TARGETS, rng) == {"a": dead}
    both = Leaky(target="rov", gives=(dead, silent))
    assert effects("a", both, TARGETS, rng) == {"a/1": dead, "a/2": silent}


@pytest.mark.parametrize("gives", [(), None, "x", (1,), (Leaky(target="rov"),)])
def test_an_extension_that_gives_something_else_is_told(gives: Any) -> None:
    with pytest.raises(ValueError, match="must give a tuple of faults"):
        effects("a", Leaky(target="rov", gives=gives), TARGETS, np.random.default_rng(1))


BOX = Hull(rigid_body_inertia(10.0, np.diag([1.0, 2.0, 3.0]), (0.0, 0.0, 0.1)), (0.0, 0.0, 0.1), 0.01, 10_000.0)


@pytest.mark.parametrize(
    ("change", "volume"), [({"volume_m3": 0.002}, 0.012), ({"fraction": -0.5}, 0.005), ({"force_N": -20.0}, 0.008)]
)
def test_the_three_ways_to_say_a_volume(change: dict[str, float], volume: float) -> None:
    assert left_volume(BOX, [BuoyancyChange(target="rov", **change)]) == pytest.approx(volume)


def test_changes_of_volume_add_up_and_ballast_is_none() -> None:
    changes = [BuoyancyChange(target="rov", fraction=0.5), BuoyancyChange(target="rov", fraction=0.5)]
    assert left_volume(BOX, [*changes, MassLoss(target="rov", mass_kg=1.0)]) == pytest.approx(0.02)


def test_lost_ballast_takes_its_mass_and_its_moments_in_any_order() -> None:
    losses = [
        MassLoss(target="rov", mass_kg=1.0, position_frd_m=(0.5, 0.0, 0.0)),
        MassLoss(target="rov", mass_kg=2.0, position_frd_m=(0.0, 0.2, 0.1)),
        MassLoss(target="rov", mass_kg=0.5),
    ]
    expected = BOX.M_RB.copy()
    for mass, place in ((1.0, (0.5, 0.0, 0.0)), (2.0, (0.0, 0.2, 0.1)), (0.5, BOX.r_g)):
        expected -= rigid_body_inertia(mass, np.zeros((3, 3)), place)
    for order in itertools.permutations(losses):
        assert np.allclose(left_inertia(BOX, order), expected, rtol=0, atol=1e-12)
    assert BOX.M_RB[0, 0] == 10.0, "the hull without faults must stay"


def test_a_volume_of_no_change_is_no_inertia() -> None:
    assert np.array_equal(left_inertia(BOX, [BuoyancyChange(target="rov", fraction=1.0)]), BOX.M_RB)
