"""Faces: normals are smooth but across edges, and long thin triangles are cut without a change of the surface."""

from __future__ import annotations

import numpy as np

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import Box, Cylinder, HalfSpace, Placed, Solid, Sphere
from uwserver.sensors.optical.camera.faces import Paint, floors, solid_faces

PAINT = Paint([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])


def area(faces: np.ndarray) -> float:
    corners = faces["corners"].astype(np.float64)
    return float(
        0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )


def test_a_ball_is_smooth_and_a_box_has_edges() -> None:
    ball = solid_faces(Solid("ball", (Placed(Sphere(2.0)),)), PAINT)
    corners = ball["corners"].reshape(-1, 3)
    normals = ball["normals"].reshape(-1, 3)
    assert np.abs(np.einsum("ij,ij->i", corners / 2.0, normals)).min() > 0.995
    box = solid_faces(Solid("box", (Placed(Box((1.0, 1.0, 1.0))),)), PAINT)
    assert {tuple(np.abs(n).round(6).tolist()) for n in box["normals"].reshape(-1, 3)} == {
        (1, 0, 0),
        (0, 1, 0),
        (0, 0, 1),
    }


def test_a_pipe_askew_is_cut_and_stays_the_same_surface() -> None:
    placed = Placed(Cylinder(0.1, 6.0), (0.0, 0.0, 0.0), quat_from_rpy(0.0, 0.3, 0.7))
    cut = solid_faces(Solid("pipe", (placed,)), PAINT)
    whole = 2 * 64 * (2 * 0.1 * np.sin(np.pi / 64)) * 12.0 / 2 + 64 * 0.01 * np.sin(2 * np.pi / 64)
    assert len(cut) > 1000
    assert abs(area(cut) - whole) < 1e-3 * whole


def test_materials_have_their_colours() -> None:
    solid = Solid("two", (Placed(Box((1.0, 1.0, 1.0)), material=0), Placed(Sphere(1.0))), material=1)
    faces = solid_faces(solid, PAINT)
    assert faces["colour"][:12].tolist() == [[1.0, 0.0, 0.0]] * 12
    assert faces["colour"][-1].tolist() == [0.0, 1.0, 0.0]


def test_a_floor_looks_up() -> None:
    (floor,) = floors(Solid("floor", (Placed(HalfSpace(), (0.0, 0.0, 9.0)),)), PAINT)
    assert floor.p[2] == 9.0
    assert floor.normal.tolist() == [0.0, 0.0, -1.0]
