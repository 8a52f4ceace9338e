"""The first model of a hull, against what is known in closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from uwserver.scenario.authoring.hull import ellipsoid_added_mass, mesh_hull


def test_added_mass_of_a_sphere_is_half_its_water() -> None:
    added = ellipsoid_added_mass(np.array([0.5, 0.5, 0.5]))
    assert added[:3] == pytest.approx([0.5 * 4.0 / 3.0 * math.pi * 0.125] * 3)
    assert list(added[3:]) == [0.0, 0.0, 0.0]


def test_added_mass_of_spheroids_is_that_of_lamb_s_table() -> None:
    """Lamb, Hydrodynamics, article 115: k1, k2 and k' of prolate spheroids of a/b = 2 and 5, in parts of the displaced water, and of its
    moment of inertia."""
    for ratio, k1, k2, k3 in ((2.0, 0.209, 0.702, 0.240), (5.0, 0.059, 0.895, 0.701)):
        a, b = ratio, 1.0
        added = ellipsoid_added_mass(np.array([a, b, b]))
        water = 4.0 / 3.0 * math.pi * a * b * b
        assert added[:3] / water == pytest.approx([k1, k2, k2], abs=3e-3)
        assert added[4:] / (water * (a * a + b * b) / 5.0) == pytest.approx([k3, k3], abs=3e-3)
        assert added[3] == 0.0


def test_a_triaxial_ellipsoid_lies_between() -> None:
    added = ellipsoid_added_mass(np.array([1.0, 0.6, 0.3]))
    assert added[0] < added[1] < added[2]
    assert (added > 0.0).all()


def test_the_mesh_of_an_ellipsoid_gives_volume_inertia_and_added_mass_of_one(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")

    half = np.array([0.8, 0.3, 0.2])
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.apply_scale(half)
    ball.apply_translation((0.1, 0.2, 0.3))
    ball.export(tmp_path / "hull.stl")
    hull = mesh_hull(tmp_path / "hull.stl", 1.0, None)
    volume = 4.0 / 3.0 * math.pi * half.prod()
    assert hull.volume == pytest.approx(volume, rel=2e-3)
    a, b, c = np.square(half)
    assert np.diag(hull.inertia(10.0)) == pytest.approx(10.0 / 5.0 * np.array([b + c, c + a, a + b]), rel=2e-3)
    assert hull.added_mass == pytest.approx(1000.0 * ellipsoid_added_mass(half), rel=6e-3)
    # FLU to FRD: what is to port and up in the file has negative y and z.
    assert hull.cad_origin == pytest.approx([-0.1, 0.2, 0.3 - 0.1 * 0.4], abs=1e-6)
    assert hull.center_of_buoyancy == pytest.approx([0.0, 0.0, -0.04], abs=1e-6)
    # Drag: 0.9 of the silhouettes across; ahead less, as it is 0.38 of the way from blunt to slender (1.6 m over 0.49 m).
    areas = math.pi * np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    assert hull.quadratic[1:3] == pytest.approx(500.0 * 0.9 * areas[1:], rel=2e-3)
    assert 0.25 < hull.quadratic[0] / (500.0 * areas[0]) < 0.9
