"""Forms of the shapes' arrays, and kinds that compiled code compares."""

from __future__ import annotations

from uwserver.physics.collision.broad_phase import SEARCH, Search
from uwserver.physics.geometry.slots import (
    CAPSULE,
    CYLINDER,
    HALF_SPACE,
    MESH,
    POLYHEDRON,
    SHAPES,
    SLOT,
    SPHERE,
    Shapes,
)


def test_each_array_of_the_shapes_has_a_form() -> None:
    assert tuple(SHAPES) == Shapes._fields
    assert SHAPES["slots"] == SLOT


def test_a_search_has_the_shapes_and_its_own() -> None:
    assert set(SEARCH) == {*Shapes._fields, *Search._fields}
    assert all(SEARCH[name] == form for name, form in SHAPES.items())


def test_round_kinds_come_first() -> None:
    """Kernels ask for them with one comparison."""
    assert max(SPHERE, CAPSULE, CYLINDER) < min(POLYHEDRON, HALF_SPACE, MESH)
