"""Makes a first model of a hull from its mesh: volume, centre and inertia by integration, added mass and damping by formulas.

The axes of B are forward, right, down; the results refer to the centre of gravity. Integrals are as good as the mesh. The formulas give a vehicle
that behaves plausibly until somebody measures it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.scenario.solids.assets import read_mesh

BLUNT, SLENDER = 2.0, 6.0
"""Ratio of length to width up to which a hull is blunt (an open frame, a box), and that from which it is slender (a torpedo)."""
DRAG_ACROSS, DRAG_SLENDER = 0.9, 0.25
"""C_D on the area of the silhouette: of a blunt body or across the flow, and of a slender body ahead with its fins."""
TURNING = 6.0
"""Ratio of the drag of turning to that of bare strips, for blunt vehicles with frame and thrusters: 7.6 for BlueROV2 (Wu 2018), 5.4 for VideoRay
Pro III (Wang)."""
AT_REST = 0.1
"""Ratio of linear to quadratic drag at 1 m/s (1 rad/s): 0.09 to 0.15 for BlueROV2 (Wu 2018)."""
RIGHTING = 0.1
"""Distance of the centre of gravity below that of buoyancy, over the height of the hull."""


@dataclass(frozen=True)
class MeshHull:
    """Model of a hull from a mesh, in SI. The origin of B is the centre of gravity.

    Attributes:
        volume: inside the mesh, m3.
        size: edges of the box around it.
        center_of_buoyancy: in B.
        box_center: middle of the box around it, in B.
        cad_origin: origin of the mesh file, in B.
        second_moments: (3, 3) integral of x x^T over the volume about its centre, m5.
        added_mass: (6) in water of 1000 kg/m3.
        quadratic, linear, lift: (6) damping coefficients of |v| v, of v, and of |u| v, in water of 1000 kg/m3.
    """

    volume: float
    size: tuple[float, float, float]
    center_of_buoyancy: tuple[float, float, float]
    box_center: tuple[float, float, float]
    cad_origin: tuple[float, float, float]
    second_moments: FloatArray
    added_mass: FloatArray
    quadratic: FloatArray
    linear: FloatArray
    lift: FloatArray

    def inertia(self, mass_kg: float) -> FloatArray:
        """Return the inertia (3, 3) about the centre if the mass is spread evenly over the volume."""
        spread = mass_kg / self.volume * self.second_moments
        return float(np.trace(spread)) * np.eye(3) - spread


def mesh_hull(path: Path, scale: float, up: Literal["y", "z"] | None) -> MeshHull:
    """Return the model of a mesh file.

    Args:
        path: path of a file that `read_mesh` reads, with x ahead.
        scale: length of one unit of the file, m.
        up: axis of the file that points up; None: y for glTF, z for others.

    Raises:
        BadSolid: the file cannot be read, is not closed, or is too large or small for a vehicle; the text says what to do.
    """
    warnings: list[str] = []
    tiles = read_mesh(path, up, scale, warnings.append)
    if not all(tile.oriented for tile in tiles):
        raise BadSolid(f'"{path.name}" is not closed, so it has no volume: export a solid, or repair the mesh')
    vertices, faces = _joined([(tile.vertices, tile.faces) for tile in tiles])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    if not 0.05 <= float(size.max()) <= 50.0:
        text = f'"{path.name}" is {size[0]:.4g} m long, {size[1]:.4g} m wide and {size[2]:.4g} m high'
        raise BadSolid(f"{text}, unlike any vehicle: give the unit of the file by --scale (0.001 for millimetres)")
    volume, center, moments = _integrals(vertices, faces)
    gravity = center + np.array([0.0, 0.0, RIGHTING * size[2]])
    # Semi-axes of the ellipsoid with the same moments along the axes of B.
    half = np.sqrt(5.0 * np.diag(moments) / volume)
    areas = _silhouettes(vertices)
    quadratic = _quadratic(size, areas)
    return MeshHull(
        volume=volume,
        size=_three(size),
        center_of_buoyancy=_three(center - gravity),
        box_center=_three(0.5 * (low + high) - gravity),
        cad_origin=_three(-gravity),
        second_moments=moments,
        added_mass=1000.0 * ellipsoid_added_mass(half),
        quadratic=quadratic,
        linear=AT_REST * quadratic,
        lift=_lift(size),
    )


def ellipsoid_added_mass(half: FloatArray) -> FloatArray:
    """Return the added mass (6) of an ellipsoid over the density of the water, from its semi-axes: Lamb, Hydrodynamics, articles 114 and 115."""
    from scipy.special import elliprd

    a, b, c = (float(axis) for axis in half)
    volume = 4.0 / 3.0 * math.pi * a * b * c
    alpha = np.array([elliprd(b * b, c * c, a * a), elliprd(c * c, a * a, b * b), elliprd(a * a, b * b, c * c)])
    alpha *= 2.0 / 3.0 * a * b * c
    added = volume * alpha / (2.0 - alpha)
    turning = [_turning(volume, *pair) for pair in (((b, c), alpha[1:]), ((a, c), alpha[::2]), ((a, b), alpha[:2]))]
    return np.array([*added, *turning])


def _turning(volume: float, axes: tuple[float, float], alpha: FloatArray) -> float:
    """Return the added inertia about the third axis; 0 if the two are equal, as the ellipsoid is then round about it."""
    difference, total = axes[0] ** 2 - axes[1] ** 2, axes[0] ** 2 + axes[1] ** 2
    if abs(difference) < 1e-9 * total:
        return 0.0
    slope = float(alpha[1] - alpha[0])
    return volume / 5.0 * difference**2 * slope / (2.0 * difference - total * slope)


def slenderness(size: FloatArray) -> float:
    """Return 0 for a blunt hull, 1 for a slender one, and values between."""
    ratio = float(size[0]) / math.sqrt(float(size[1] * size[2]))
    return min(max((ratio - BLUNT) / (SLENDER - BLUNT), 0.0), 1.0)


def _quadratic(size: FloatArray, areas: FloatArray) -> FloatArray:
    """Return the quadratic damping (6) at 1000 kg/m3: C_D on the silhouette; turning by strips at their own speeds, which gives 1/32 of the area
    times the cube of the length."""
    slender = slenderness(size)
    drag = np.array([DRAG_ACROSS + slender * (DRAG_SLENDER - DRAG_ACROSS), DRAG_ACROSS, DRAG_ACROSS])
    factor = TURNING + slender * (1.0 - TURNING)
    x, y, z = areas
    cube = size**3 / 32.0
    strips = np.array([y * cube[2] + z * cube[1], z * cube[0] + x * cube[2], y * cube[0] + x * cube[1]])
    return 500.0 * np.concatenate([drag * areas, factor * DRAG_ACROSS * strips])


def _lift(size: FloatArray) -> FloatArray:
    """Return the lift damping (6) at 1000 kg/m3: half that of flat plates of low aspect ratio (Jones, NACA 835), even over length and width."""
    length, width, height = (float(edge) for edge in size)
    sway, heave = (1000.0 * math.pi * span**2 / 8.0 for span in (height, width))
    return np.array([0.0, sway, heave, heave * width**2 / 12.0, heave * length**2 / 12.0, sway * length**2 / 12.0])


def _silhouettes(vertices: FloatArray) -> FloatArray:
    """Return the areas (3) of the convex hull seen along x, y and z."""
    from scipy.spatial import ConvexHull as Quickhull

    return np.array([Quickhull(np.delete(vertices, axis, axis=1)).volume for axis in range(3)])


def _integrals(vertices: FloatArray, faces: IntArray) -> tuple[float, FloatArray, FloatArray]:
    """Return volume, its centre, and the integral (3, 3) of x x^T about that, by tetrahedra from the middle of the box."""
    start = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    a, b, c = (vertices[faces[:, k]] - start for k in range(3))
    parts = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    volume = float(parts.sum())
    total = a + b + c
    center = (parts[:, None] * total).sum(axis=0) / (4.0 * volume)
    outer = sum(np.einsum("i,ij,ik->jk", parts, p, p) for p in (a, b, c, total)) / 20.0
    return volume, start + center, outer - volume * np.outer(center, center)


def _joined(parts: list[tuple[FloatArray, IntArray]]) -> tuple[FloatArray, IntArray]:
    counts = [0, *np.cumsum([len(vertices) for vertices, _ in parts]).tolist()]
    faces = [f + first for (_, f), (first, _) in zip(parts, pairwise(counts), strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def _three(x: FloatArray) -> tuple[float, float, float]:
    return float(x[0]), float(x[1]), float(x[2])
