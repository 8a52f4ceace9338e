"""Triangles of solids, of which is found which one a ray meets first: in compiled code by a tree of our own (`meeting`), in Python by a picker, which
is Embree, that works in float32, or where that is not installed the tree. Range and normal are computed from the triangle in float64, and each
surface is kept about an origin near it.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import cached_property
from importlib.util import find_spec
from typing import Any, NamedTuple, Protocol

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene

from uwserver.physics.geometry.shapes import HalfSpace, Solid, check_shape
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.rays import hits
from uwserver.physics.rays.meeting import SURFACE
from uwserver.physics.rays.raycast import Hits
from uwserver.physics.rays.rows import Facets, facets, middle, sides
from uwserver.physics.rays.tree import grow

FEW = 96
"""Triangles of a moving solid, as eight boxes have, up to which one by one is quicker than the engine."""
LATTICE_M = 1024.0
"""Between origins of what never moves. Nothing small is farther than half of it from its own along an axis, where float32 has steps of 0.03 mm:
that far beside its edge a triangle may be missed, or met."""
_HIDDEN_SIDES = 16
"""A ray gives up behind this many hidden sides."""
_KEPT = 16
"""Numbers of rays for which a surface keeps arrays."""


class Picker(Protocol):
    """Triangles (t, 3, 3), of which it finds the first that each ray meets, from either side."""

    def pick(self, origin: FloatArray, direction: FloatArray, limit: FloatArray | None = None) -> IntArray:
        """Numbers (n) of triangles, -1 for none, of rays (n, 3) whose directions have length one; a limit (n) is in m, and so is the origin."""


def has_embree() -> bool:
    """Whether Embree is installed. Without it the same is seen, more slowly."""
    return find_spec("embreex") is not None


def make_picker(corners: FloatArray, robust: bool = True) -> Picker:
    """The quickest picker that is installed, of triangles (t, 3, 3) about the origin; if it need not be `robust`, a ray may slip through an edge."""
    if has_embree():
        return EmbreePicker(corners, robust)
    from uwserver.physics.rays.tree import TreePicker

    return TreePicker(corners)


class _Work(NamedTuple):
    """Arrays for a number of rays, and the table by which kernels find them."""

    batch: hits.Batch
    table: IntArray


class Surface:
    """Triangles of solids in one frame.

    Args:
        solids: by id; an id is given only if a ray is cast without one.
        origin: (3) of the picker in that frame, m; default: their centre.
    """

    def __init__(self, solids: Mapping[int, Solid], origin: tuple[float, ...] | None = None) -> None:
        each = {body: facets(solid) for body, solid in solids.items()}
        parts = Facets(*(np.concatenate(columns) for columns in zip(*each.values(), strict=True)))
        owners: IntArray = np.repeat(np.array([*each], dtype=np.int64), [len(part.corners) for part in each.values()])
        centre, half = middle(parts)
        about = centre if origin is None else np.array(origin)
        self._box = np.array((about, half + np.abs(centre - about)))
        self._sides, self._owners = sides(parts, self._box[0]), owners
        self._works: dict[int, _Work] = {}
        self._apart: Surface | None = None

    @cached_property
    def _picker(self) -> Picker:
        return make_picker(self._sides["corners"])

    @cached_property
    def _met(self) -> dict[str, Any]:
        tree = grow(self._sides["corners"], self._sides["sided"])
        return {**tree._asdict(), "sides": self._sides, "owners": self._owners, "box": self._box}

    @cached_property
    def table(self) -> IntArray:
        """Of `meeting.SURFACE`, for compiled code."""
        return addresses(SURFACE, self._met)

    def apart(self) -> Surface:
        """The same triangles for one other thread, with work space of its own; always the same answer. What picks is safe in many threads."""
        if self._apart is None:
            _ = self._picker  # which both share
            self._apart = other = copy(self)
            other.__dict__["_works"] = {}
        return self._apart

    def cast(
        self, x: FloatArray, body: int, origin: FloatArray, direction: FloatArray, limit: float, answer: Hits
    ) -> None:
        """Add the hits of rays (n, 3) to the answer; the state x (13) places the frame."""
        work = self._works.get(len(origin)) or self._buffers(len(origin))
        batch = work.batch
        count = hits.select_rays(work.table, origin, direction, limit, x, answer.distance)
        if count == 0:
            return
        engine = batch.engine[:count]
        picked = self._picker.pick(engine[:, :3], engine[:, 3:6], engine[:, 6])
        for _ in range(_HIDDEN_SIDES):
            count = hits.refine(work.table, picked, limit, body, *answer)
            if count == 0:
                return
            start, towards, ahead = batch.start[:count], batch.towards[:count], batch.ahead[:count]
            ahead += hits.ROUNDING * (np.abs(start).max() + self._box[1].max())
            picked = self._picker.pick(
                (start + ahead[:, None] * towards).astype(np.float32), towards.astype(np.float32)
            )

    def _buffers(self, n: int) -> _Work:
        """Arrays for n rays, kept for the next ones, as to make them costs more than to cast a few rays."""
        if len(self._works) >= _KEPT:
            self._works.clear()
        batch = hits.Batch(
            self._sides, self._owners, self._box, np.empty((3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n, np.int64), np.empty(n),
            np.empty((n, 7), np.float32),
        )  # fmt: skip
        self._works[n] = work = _Work(batch, addresses(hits.BATCH, batch._asdict()))
        return work


class Surfaces:
    """Of the solids of a world, or of several worlds with the same solids that are stepped in one thread. Kept for the next who has the same."""

    def __init__(self) -> None:
        self._moving: dict[int, tuple[Solid, Surface | None]] = {}
        self._still: dict[tuple[tuple[int, int], ...], tuple[Mapping[int, Solid], tuple[Surface, ...]]] = {}

    def of(self, solid: Solid) -> Surface | None:
        """In its own frame; None where it has few triangles. Raises BadSolid."""
        if id(solid) not in self._moving:
            for placed in solid.shapes:
                check_shape(placed.shape)
            surface = Surface({0: solid}) if len(facets(solid).corners) > FEW else None
            self._moving[id(solid)] = solid, surface  # so that nobody else gets this id
        return self._moving[id(solid)][1]

    def still(self, solids: Mapping[int, Solid]) -> tuple[Surface, ...]:
        """Of what never moves, by ids: one for each point of the lattice. The last that were asked for are kept."""
        key = tuple((body, id(solid)) for body, solid in solids.items())
        if key not in self._still:
            made = tuple(Surface(there, about) for about, there in _by_origin(solids).items())
            self._still = {key: (dict(solids), made)}
        return self._still[key][1]


def _by_origin(solids: Mapping[int, Solid]) -> dict[tuple[float, ...], dict[int, Solid]]:
    """What is meshed, by the point of the lattice that each is kept about."""
    found: dict[tuple[float, ...], dict[int, Solid]] = {}
    for body, solid in solids.items():
        if any(not isinstance(placed.shape, HalfSpace) for placed in solid.shapes):
            centre, _ = middle(facets(solid))
            about = tuple((LATTICE_M * np.round(centre / LATTICE_M)).tolist())
            found.setdefault(about, {})[body] = solid
    return found


class EmbreePicker:
    """A `surfaces.Picker`. One that is not `robust` is a fifth quicker, and a ray may slip through between two triangles: for pictures."""

    def __init__(self, corners: FloatArray, robust: bool = True) -> None:
        n = len(corners)
        self._scene = EmbreeScene(robust=robust)
        flat = corners.reshape(-1, 3).astype(np.float32)
        self._mesh = EmbreeMesh(self._scene, flat, np.arange(3 * n, dtype=np.int32).reshape(-1, 3))

    def pick(self, origin: FloatArray, direction: FloatArray, limit: FloatArray | None = None) -> IntArray:
        """As `surfaces.Picker`."""
        picked: IntArray = self._scene.run(origin, direction, limit)
        return picked
