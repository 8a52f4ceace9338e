"""Tables of solid things: limits and defaults, and which kinds there are where."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import UNSET

from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.solids.tables import Collision, Contact, ObjectEntry, Seabed, Structure


@pytest.mark.parametrize(
    ("union", "kinds"),
    [
        (Seabed, {"flat", "grid"}),
        (Structure, {"box", "sphere", "cylinder", "capsule", "mesh", "hull"}),
        (ObjectEntry, {"box", "sphere", "cylinder"}),
        (Collision, {"box", "sphere", "cylinder", "capsule", "hull"}),
    ],
)
def test_kinds(union: Any, kinds: set[str]) -> None:
    """Nothing that moves is a bare surface: no engine could say what is inside it."""
    assert set(kinds_of(union)) == kinds


def test_a_surface_by_default() -> None:
    assert Contact() == Contact(friction=0.5, restitution=0.0, material="default")


@pytest.mark.parametrize(
    ("type_", "keys", "line"),
    [
        (Contact, {"friction": -0.1}, "friction: expected a number of at least 0, found -0.1"),
        (Contact, {"restitution": 1.1}, "restitution: expected a number from 0 to 1, found 1.1"),
        (Contact, {"material": ""}, 'material: expected a string that is not empty, found the string ""'),
        (Structure, {"kind": "box", "size_m": [1, 0, 1]}, "size_m[1]: expected a number greater than 0, found 0"),
        (Structure, {"kind": "sphere", "radius_m": 0}, "radius_m: expected a number greater than 0, found 0"),
        (Structure, {"kind": "mesh", "file": ""}, 'file: expected a string that is not empty, found the string ""'),
        (Structure, {"kind": "mesh", "file": "x", "up": "x"}, 'up: expected one of "y", "z", found the string "x"'),
        (Structure, {"kind": "hull", "file": "x", "scale": 0}, "scale: expected a number greater than 0, found 0"),
        (Seabed, {"kind": "flat"}, ': missing key "depth_m"'),
        (Seabed, {"kind": "grid", "file": "x", "spacing_m": [1]}, "spacing_m: expected an array of 2"),
        (Seabed, {"kind": "grid", "file": "x", "extent_m": 0}, "extent_m: expected a number greater than 0, found 0"),
        (ObjectEntry, {"kind": "sphere", "radius_m": 1, "mass_kg": 0}, "mass_kg: expected a number greater than 0"),
        (ObjectEntry, {"kind": "capsule"}, 'kind: unknown kind "capsule"'),
        (Collision, {"kind": "mesh", "file": "x"}, 'kind: unknown kind "mesh"'),
    ],
)
def test_limits(type_: Any, keys: dict[str, Any], line: str, tree_of, report) -> None:
    assert tree_of(keys, type_).value is None
    assert report.lines[0].startswith(line)


def test_places_and_truth_of_an_object(tree_of, report) -> None:
    ball = tree_of({"kind": "sphere", "radius_m": 1, "mass_kg": 2}, ObjectEntry).value
    assert report.lines == []
    assert (ball.position_ned_m, ball.attitude_rpy_deg, ball.velocity_frd_mps) == ((0.0, 0.0, 0.0),) * 3
    assert ball.present
    assert ball.truth is ball.density_kgpm3 is UNSET
