"""Finds the triangle that each pixel sees: the rays of a picture against everything static and moving (compiled, apart from the engine).

Directions and starts are float32, about a point near the camera. The distance to the triangle is computed in float64. The engine has no
instances, so a moving thing has a scene in its own frame, shared by things that are alike. Only rays that pass the ball around it are cast there.
Things outside the view are found without casting rays: by balls around things and a cone around all rays.
"""

from __future__ import annotations

import math
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.rays.surfaces import Picker, make_picker
from uwserver.sensors.optical.camera.faces import CLOSED

_PARTS = 6
"""Parts along each axis. A thing has at most this number to the third power of balls."""
NOTHING = -1
THING = np.dtype(
    [
        ("R", "f8", (3, 3)),  # attitude of its frame in N
        ("p", "f8", (3,)),  # origin of its faces about the base of the picture, N, m
        ("id", "i4"),  # id in pictures of mode segmentation
        ("row", "i4"),  # row of its body, -1 for a thing that never moves
    ]
)
"""The thing that faces belong to. It is filled in for each picture."""


class Balls(NamedTuple):
    """Balls around parts of a thing: centres (n, 3) and radii (n), m."""

    centre: FloatArray
    radius: FloatArray


def balls_of(corners: FloatArray) -> Balls:
    """Return balls that contain all triangles (n, 3, 3). Each ball contains the triangles of one place."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle = 0.5 * (low + high)
    first = middle.min(axis=0)
    place = ((middle - first) * (_PARTS / np.maximum(np.ptp(middle, axis=0), 1e-9))).astype(np.int64)
    keys = np.minimum(place, _PARTS - 1) @ np.array((1, _PARTS, _PARTS * _PARTS))
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    low, high = np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts)
    return Balls(0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1))


class Cone(NamedTuple):
    """A cone that contains rays that start near the origin.

    Attributes:
        axis: (3) unit vector.
        half: largest angle of a ray from the axis, rad.
        slack: largest distance of a start from the origin, m.
    """

    axis: FloatArray
    half: float
    slack: float

    def meets(self, balls: Balls) -> bool:
        """Return whether a ray may hit one of the balls."""
        far = np.linalg.norm(balls.centre, axis=1)
        radius = balls.radius + self.slack
        if bool((far <= radius).any()):
            return True
        turned = np.arccos(np.clip(balls.centre @ self.axis / far, -1.0, 1.0))
        return bool((turned <= self.half + np.arcsin(radius / far)).any())


def cone_of(direction: FloatArray, origin: FloatArray) -> Cone:
    """Return the cone about the x axis that contains rays: unit directions (n, 3) and origins (m, 3), m, in float32."""
    half = math.acos(max(min(float(direction[:, 0].min()), 1.0), -1.0))
    # 1e-3 covers the rounding of float32. Near the axis it is larger in the angle than in its cosine.
    return Cone(np.array((1.0, 0.0, 0.0)), half + 1e-3, float(np.linalg.norm(origin, axis=1).max()) + 1e-3)


class PickScene(NamedTuple):
    """Triangles in one frame, with an engine that finds the first one that a ray hits.

    Attributes:
        picker: the engine.
        centre: (3) its origin in the frame of the thing, m.
        balls: balls around its parts, from its origin.
        middle, radius: (3) centre and radius of the ball around all of it, from its origin, m.
        triangles: number of triangles.
    """

    picker: Picker
    centre: FloatArray
    balls: Balls
    middle: FloatArray
    radius: float
    triangles: int


class Placed(NamedTuple):
    """A scene in a picture.

    Attributes:
        scene: the triangles.
        thing: the row of THING that places it.
        first: its first row of FACE; the others follow.
        rows: its rows of FACE, if they are not consecutive.
    """

    scene: PickScene
    thing: int
    first: int
    rows: IntArray | None = None


def pick_scene(corners: FloatArray, centre: FloatArray) -> PickScene:
    """Return a scene of triangles (n, 3, 3) about a centre (3)."""
    about = corners - centre
    flat = about.reshape(-1, 3)
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    radius = float(np.linalg.norm(flat - middle, axis=1).max()) * (1.0 + _ROUNDING) + _ROUNDING
    picker = make_picker(np.ascontiguousarray(about, np.float64), robust=False)
    return PickScene(picker, centre, balls_of(about), middle, radius, len(corners))


_ROUNDING = 1e-4
"""A ball is larger than its contents by this length (m) and by this part of its radius, because rays are float32."""


class Buffers:
    """The rays of a camera, and what they hit.

    Attributes:
        origin, direction: (n, 3) float32, the rays in N about the base.
        distance: (n) distance of the hit, m; inf for none, 0 for a ray that begins inside a solid.
        face: (n) row of FACE that is hit, -1 for none.
        piece: most rays that are cast at once.
    """

    def __init__(self, n: int, piece: int) -> None:
        """Make the arrays for n rays, of which at most `piece` are cast at once."""
        single, self.n, self.piece = np.float32, n, piece
        self.origin: Any = np.zeros((n, 3), single)
        self.direction: Any = np.zeros((n, 3), single)
        self.distance: FloatArray = np.empty(n)
        self.face: Any = np.empty(n, np.int32)
        self._start: Any = np.empty((piece, 3), single)
        self._towards: Any = np.empty((piece, 3), single)
        self._limit: Any = np.empty(piece, single)
        self._index: Any = np.empty(piece, np.int32)

    def part(self, place: slice) -> Buffers:
        """Return some of the rays, as views of these arrays."""
        part = copy(self)
        part.origin, part.direction, part.distance, part.face = (
            self.origin[place],
            self.direction[place],
            self.distance[place],
            self.face[place],
        )
        part.n = len(part.face)
        return part

    def clear(self) -> None:
        """Forget all hits."""
        self.distance.fill(math.inf)
        self.face.fill(NOTHING)

    def cast(self, placed: Placed, things: Any, faces: Any) -> None:
        """Cast the rays at a scene. Hits that are nearer replace those so far."""
        scene, thing = placed.scene, things[placed.thing : placed.thing + 1]
        count = select(
            self.origin, self.direction, self.distance, thing, scene.middle, scene.radius, self._start, self._towards, self._limit,
            self._index,
        )  # fmt: skip
        if count == 0:
            return
        start, towards, limit = self._start[:count], self._towards[:count], self._limit[:count]
        picked, first = scene.picker.pick(start, towards, limit), placed.first
        if placed.rows is not None:
            picked, first = np.where(picked >= 0, placed.rows[picked], -1), 0
        meet(picked, first, faces, start, towards, self._index, self.distance, self.face)

    def count(self, placed: Placed, things: Any, faces: Any, without: Any) -> int:
        """Return how many rays, without some (n), would hit a scene that is alone. Forgets all hits."""
        self.clear()
        self.distance[without] = 0.0
        self.cast(placed, things, faces)
        return int(np.count_nonzero(self.face != NOTHING))

    def shade(self, placed: Placed, things: Any, points: Any, towards: Any, reach: FloatArray, lit: Any) -> None:
        """Mark the points that a scene hides from a lamp.

        Args:
            placed, things: see `cast`.
            points, towards: (m, 3) float32, the points and the directions to the lamp.
            reach: (m) distance of the lamp, m; 0 leaves a point out.
            lit: (m) uint8, becomes 0 for hidden points.
        """
        scene, thing = placed.scene, things[placed.thing : placed.thing + 1]
        count = select(
            points, towards, reach, thing, scene.middle, scene.radius, self._start, self._towards, self._limit, self._index
        )  # fmt: skip
        if count:
            picked = scene.picker.pick(self._start[:count], self._towards[:count], self._limit[:count])
            darken(picked, self._index, lit)


@entry
def turn(
    table: Array, start: Array, width: int, R: Array, p: Array, origin: Array, direction: Array
) -> None:  # fmt: skip
    """Turn the rays of a lens into N.

    Args:
        table, start: (n, 3) directions and origins in S. `start` has one row if all rays begin at the pupil.
        width: pixels in a row.
        R, p: (rows, 3, 3) and (rows, 3), pose of S in N about the base when each row of pixels is read.
        origin, direction: (n, 3) receive the rays.
    """
    single = len(start) == 1
    for row in range(len(R)):
        for column in range(width):
            k = row * width + column
            s = 0 if single else k
            for i in range(3):
                direction[k, i] = R[row, i, 0] * table[k, 0] + R[row, i, 1] * table[k, 1] + R[row, i, 2] * table[k, 2]
                origin[k, i] = (
                    p[row, i] + R[row, i, 0] * start[s, 0] + R[row, i, 1] * start[s, 1] + R[row, i, 2] * start[s, 2]
                )


@entry
def meet_floor(
    origin: Array, direction: Array, point: Array, normal: Array, face: int, distance: Array, met: Array
) -> None:  # fmt: skip
    """Let rays hit the plane of a half-space through a point, from outside."""
    a, b, c = normal[0], normal[1], normal[2]
    for k in range(len(distance)):
        approach = a * direction[k, 0] + b * direction[k, 1] + c * direction[k, 2]
        if approach < 0.0:
            height = a * (origin[k, 0] - point[0]) + b * (origin[k, 1] - point[1]) + c * (origin[k, 2] - point[2])
            reached = -height / approach
            if 0.0 <= reached < distance[k]:
                distance[k], met[k] = reached, face


@entry
def select(
    origin: Array, direction: Array, distance: Array, thing: Array, middle: Array, radius: float, start: Array, towards: Array,
    limit: Array, index: Array,
) -> int:  # fmt: skip
    """Select the rays that pass through a ball before their present hit, and transform them into the frame of the thing.

    Args:
        origin, direction: (n, 3) the rays.
        distance: (n) distance of their hits, m; 0 leaves a ray out.
        thing: (1) THING that places the ball.
        middle, radius: (3) centre and radius of the ball, from the origin of the thing, m.
        start, towards, limit, index: (n) receive these rays, and their numbers.

    Returns:
        The number of selected rays.
    """
    R, p, count, square = thing[0].R, thing[0].p, 0, radius * radius
    i, j, h = middle[0], middle[1], middle[2]
    u = R[0, 0] * i + R[0, 1] * j + R[0, 2] * h
    v = R[1, 0] * i + R[1, 1] * j + R[1, 2] * h
    w = R[2, 0] * i + R[2, 1] * j + R[2, 2] * h
    for k in range(len(distance)):
        x, y, z = p[0] - origin[k, 0], p[1] - origin[k, 1], p[2] - origin[k, 2]
        a, b, c = direction[k, 0], direction[k, 1], direction[k, 2]
        along = a * (x + u) + b * (y + v) + c * (z + w)
        size = (x + u) * (x + u) + (y + v) * (y + v) + (z + w) * (z + w)
        if distance[k] <= 0.0 or along < -radius or size - along * along > square or along - radius > distance[k]:
            continue
        for i in range(3):
            start[count, i] = -(R[0, i] * x + R[1, i] * y + R[2, i] * z)
            towards[count, i] = R[0, i] * a + R[1, i] * b + R[2, i] * c
        limit[count] = min(distance[k], 1e30)
        index[count] = k
        count += 1
    return count


@entry
def meet(
    picked: Array, first: int, faces: Array, start: Array, towards: Array, index: Array, distance: Array, met: Array
) -> None:  # fmt: skip
    """Find the distances at which rays hit the triangles that the engine has picked.

    Args:
        picked: (m) triangles of a scene, -1 for none.
        first: the first row of the scene in `faces`.
        faces: FACE.
        start, towards, index: (m) results of `select`.
        distance, met: (n) hits of all rays, are updated.
    """
    for m in range(len(picked)):
        if picked[m] >= 0:
            reached, k = _distance_to(faces[first + picked[m]].corners, start[m], towards[m]), index[m]
            if 0.0 <= reached < distance[k]:
                distance[k], met[k] = reached, first + picked[m]


_STRIDE = 61
"""One in this number of rays is tried first. It does not divide the width of a picture, so that these rays are spread over it."""


@entry
def end_inside(direction: Array, faces: Array, things: Array, distance: Array, met: Array) -> None:
    """Find rays that leave a closed solid. They began inside it, where it is dark, so they end where they begin.

    Args:
        direction: (n, 3) directions of the rays.
        faces, things: FACE and THING.
        distance, met: (n) hits of all rays; for those rays they become 0 and NOTHING.
    """
    inside = False
    for k in range(0, len(met), _STRIDE):  # if the camera is inside, nearly all rays leave
        inside = inside or _leaves(direction[k], faces, things, met[k])
    if inside:
        for k in range(len(met)):
            if _leaves(direction[k], faces, things, met[k]):
                distance[k], met[k] = 0.0, NOTHING


@compiled
def _leaves(d: Array, faces: Array, things: Array, met: int) -> bool:
    """Return whether a ray hits a closed solid from inside."""
    if met < 0 or faces[met].sided != CLOSED:
        return False
    face = faces[met]
    R, c = things[face.thing].R, face.corners
    ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    along = 0.0
    for i in range(3):
        along += (R[i, 0] * nx + R[i, 1] * ny + R[i, 2] * nz) * d[i]
    return along > 0.0


@compiled
def _distance_to(corners: Array, o: Array, d: Array) -> float:
    """Return the distance along a ray to the plane of a triangle; negative if it never gets there."""
    ax, ay, az = float(corners[0, 0]), float(corners[0, 1]), float(corners[0, 2])
    ux, uy, uz = corners[1, 0] - ax, corners[1, 1] - ay, corners[1, 2] - az
    vx, vy, vz = corners[2, 0] - ax, corners[2, 1] - ay, corners[2, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    approach = nx * d[0] + ny * d[1] + nz * d[2]
    if approach == 0.0:
        return -1.0
    return float((nx * (ax - o[0]) + ny * (ay - o[1]) + nz * (az - o[2])) / approach)


@entry
def darken(picked: Array, index: Array, lit: Array) -> None:
    """Mark rays (m) that hit something as being in shadow."""
    for m in range(len(picked)):
        if picked[m] >= 0:
            lit[index[m]] = 0


@entry
def depths(table: Array, start: Array, distance: Array, out: Array) -> None:
    """Find the distances of hits along the optical axis, mm in 16 bits; 0 if there is no hit, or if it is too far for 16 bits.

    Args:
        table, start: see `turn`.
        distance: (n) distances along the rays, m.
        out: (n) uint16, receives the distances.
    """
    single = len(start) == 1
    for k in range(len(out)):
        along = 1e3 * (distance[k] * table[k, 0] + start[0 if single else k, 0]) + 0.5
        out[k] = int(along) if distance[k] > 0.0 and 0.0 < along < 65536.0 else 0


@entry
def owners(met: Array, faces: Array, things: Array, out: Array) -> None:
    """Find the ids (n, uint16) of the objects that rays hit; 0 for none."""
    for k in range(len(out)):
        out[k] = things[faces[met[k]].thing].id if met[k] >= 0 else 0
