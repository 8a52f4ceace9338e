"""Solid things as plain data, independent of any engine: convex shapes, triangle meshes, and solids made of them.

Each shape has a frame of its own; axis x of it is the axis of cylinders and capsules. `Placed` puts a shape into the frame of its solid: N for a
static solid, B for the body that carries it. Arrays are float64, m.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from uwserver.frames import Quat, Vec3, matrix
from uwserver.physics.kernel.arrays import FloatArray, IntArray

TILE_TRIANGLES = 100_000
"""Most triangles of one `TriangleMesh`: Bullet refuses inline meshes above about 178 000."""

HULL_POINTS = 256
"""Most corners of one `ConvexHull`; the time for contacts grows with them."""


@dataclass(frozen=True)
class Box:
    """A box of half edges `half`, m, along the axes of its frame."""

    half: Vec3


@dataclass(frozen=True)
class Sphere:
    """A ball of `radius`, m."""

    radius: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about axis x of its frame; `radius` and `half_length`, m."""

    radius: float
    half_length: float


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` (m) of the segment from -`half_length` to `half_length` on axis x of its frame."""

    radius: float
    half_length: float


@dataclass(frozen=True)
class HalfSpace:
    """Everything with z >= 0 in its frame: a flat seabed without end. It must be static."""


@dataclass(frozen=True, eq=False)
class ConvexHull:
    """The hull of `points` (n, 3), m; they must span a volume and have at most `HULL_POINTS` corners."""

    points: FloatArray


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A surface of triangles. It must be static.

    Attributes:
        vertices: (n, 3) m, finite.
        faces: (m, 3) vertex numbers, counter-clockwise seen from outside; no triangle without area, at most `TILE_TRIANGLES`.
        oriented: the side from which triangles are counter-clockwise is water, the other is solid; a body inside is pushed out. Otherwise it is a
            sheet with equal sides.
    """

    vertices: FloatArray
    faces: IntArray
    oriented: bool = True


Shape = Box | Sphere | Cylinder | Capsule | HalfSpace | ConvexHull | TriangleMesh


@dataclass(frozen=True)
class Placed:
    """A shape at `p` (m) with attitude `q` (w x y z) in the frame of its solid, of a material by number (-1: that of the solid)."""

    shape: Shape
    p: Vec3 = (0.0, 0.0, 0.0)
    q: Quat = (1.0, 0.0, 0.0, 0.0)
    material: int = -1

    @property
    def R(self) -> FloatArray:
        """The attitude as a matrix (3, 3), which turns components in the shape's frame into components in that of the solid."""
        return np.array(matrix(self.q))


@dataclass(frozen=True)
class Solid:
    """One rigid thing.

    Attributes:
        name: for people.
        shapes: what it is made of; they may overlap.
        friction: Coulomb coefficient; a pair's is the geometric mean of the two.
        restitution: 0..1; a pair's is the larger of the two.
        material: number that rays report.
    """

    name: str
    shapes: tuple[Placed, ...] = field(default=())
    friction: float = 0.5
    restitution: float = 0.0
    material: int = 0


class BadSolid(ValueError):
    """A solid that must not be passed to an engine. The text says what is wrong and what to do."""


def check_shape(shape: Shape) -> None:
    """Refuse shapes that would crash an engine or give wrong results without an error.

    Raises:
        BadSolid: sizes not finite or not positive, vertices not finite, faces with missing vertices, triangles without area, too large.
    """
    if isinstance(shape, TriangleMesh):
        _check_mesh(shape)
    elif isinstance(shape, ConvexHull):
        _check_points(shape.points, "a hull")
        if len(shape.points) < 4 or np.linalg.matrix_rank(shape.points - shape.points.mean(axis=0), 1e-9) < 3:
            raise BadSolid("the points of a hull lie in one plane: give at least 4 that span a volume")
    elif not isinstance(shape, HalfSpace):
        sizes: tuple[float, ...] = shape.half if isinstance(shape, Box) else (shape.radius,)
        if isinstance(shape, Cylinder | Capsule):
            sizes = (shape.radius, shape.half_length)
        if not all(np.isfinite(sizes)) or min(sizes) <= 0.0 or max(sizes) > 1e5:
            told = ", ".join(f"{size:g} m" for size in sizes)
            raise BadSolid(f"sizes of a {type(shape).__name__.lower()} must be positive and below 100 km: {told}")


def _check_points(points: FloatArray, what: str) -> None:
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise BadSolid(f"the vertices of {what} must be an array (n, 3), not {points.shape}")
    bad = int((~np.isfinite(points)).any(axis=1).sum())
    if bad:
        raise BadSolid(f"{bad} vertices of {what} are not finite: repair the file")


def _check_mesh(mesh: TriangleMesh) -> None:
    _check_points(mesh.vertices, "a mesh")
    faces = mesh.faces
    if faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces):
        raise BadSolid(f"the faces of a mesh must be an array (m, 3) with at least one, not {faces.shape}")
    if len(faces) > TILE_TRIANGLES:
        raise BadSolid(f"a mesh of {len(faces)} triangles: cut it into tiles of at most {TILE_TRIANGLES}")
    if faces.min() < 0 or faces.max() >= len(mesh.vertices):
        raise BadSolid(f"a face names vertex {int(faces.max())}, but there are {len(mesh.vertices)}")
    empty = int((~has_area(mesh.vertices, faces)).sum())
    if empty:
        raise BadSolid(f"{empty} triangles of a mesh have no area: drop them")


def has_area(vertices: FloatArray, faces: IntArray) -> npt.NDArray[np.bool_]:
    """Return (m) whether the height of each triangle is more than 1e-9 of its longest side. Other triangles have no normal."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    longest = np.maximum.reduce([((b - a) ** 2).sum(axis=1), ((c - b) ** 2).sum(axis=1), ((a - c) ** 2).sum(axis=1)])
    doubled: FloatArray = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    wide: npt.NDArray[np.bool_] = doubled > 1e-9 * longest
    return wide
