"""Triangles of solids, of which the one that a ray meets first is found: in compiled code by our own tree (`meeting`), in Python by a picker. The
picker is Embree, which works in float32, or our tree if Embree is not installed. Range and normal are computed from the triangle in float64,
and each surface is kept about an origin near it."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import cached_property
from importlib.util import find_spec
from typing import Any, NamedTuple, Protocol

import numpy as np

from uwserver.physics.geometry.shapes import HalfSpace, Solid, check_shape
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.rays import hits
from uwserver.physics.rays.meeting import SURFACE
from uwserver.physics.rays.raycast import Hits
from uwserver.physics.rays.rows import Facets, facets, middle, sides
from uwserver.physics.rays.tree import TreePicker, grow

FEW = 96
"""Most triangles of a moving solid, as eight boxes have, for which one by one is faster than the engine."""
LATTICE_M = 1024.0
"""Distance between the origins of static solids. No small thing is farther than half of it from its own origin along an axis, where the steps of
float32 are 0.03 mm: within this distance of its edge a triangle may be missed or hit by mistake."""
_HIDDEN_SIDES = 16
"""A ray ends behind this many hidden sides."""
_KEPT = 16
"""Most numbers of rays for which a surface keeps arrays."""


class Picker(Protocol):
    """Finds the first of some triangles (t, 3, 3) that each ray meets, from either side."""

    def pick(self, origin: FloatArray, direction: FloatArray, limit: FloatArray | None = None) -> IntArray:
        """Return the numbers (n) of triangles, -1 for none, for rays (n, 3) with unit directions. A limit (n) is in m, and so is the origin."""


def has_embree() -> bool:
    """Return whether Embree is installed. Without it the results are the same, more slowly."""
    return find_spec("embreex") is not None


def make_picker(corners: FloatArray, robust: bool = True) -> Picker:
    """Return the fastest picker that is installed, for triangles (t, 3, 3) about the origin. If it need not be `robust`, a ray may slip through an
    edge."""
    if has_embree():
        return EmbreePicker(corners, robust)
    return TreePicker(corners)


class _Work(NamedTuple):
    """Arrays for a number of rays, and the table by which kernels find them."""

    batch: hits.Batch
    table: IntArray


class Surface:
    """Triangles of solids in one frame.

    Args:
        solids: by id; the ids are reported if a ray is cast without an id for the whole surface.
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
    def _ray_targets(self) -> dict[str, Any]:
        tree = grow(self._sides["corners"], self._sides["sided"])
        return {**tree._asdict(), "sides": self._sides, "owners": self._owners, "box": self._box}

    @cached_property
    def table(self) -> IntArray:
        """The table of `meeting.SURFACE`, for compiled code."""
        return addresses(SURFACE, self._ray_targets)

    def apart(self) -> Surface:
        """Return the same triangles for one other thread, with work space of its own; always the same object. The picker is safe in many threads."""
        if self._apart is None:
            _ = self._picker  # made now, as both share it
            self._apart = other = copy(self)
            other.__dict__["_works"] = {}
        return self._apart

    def cast(
        self, x: FloatArray, body: int, origin: FloatArray, direction: FloatArray, limit: float, answer: Hits
    ) -> None:
        """Add the hits of rays (n, 3) to the answer. The state x (13) places the frame."""
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
        """Return arrays for n rays. They are kept for the next ones, as making them takes longer than casting a few rays."""
        if len(self._works) >= _KEPT:
            self._works.clear()
        batch = hits.Batch(
            self._sides, self._owners, self._box, np.empty((3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n, np.int64), np.empty(n),
            np.empty((n, 7), np.float32),
        )  # fmt: skip
        self._works[n] = work = _Work(batch, addresses(hits.BATCH, batch._asdict()))
        return work


class Surfaces:
    """The surfaces of the solids of a world, or of several worlds with the same solids that are stepped in one thread. They are kept for later
    worlds."""

    def __init__(self) -> None:
        self._moving: dict[int, tuple[Solid, Surface | None]] = {}
        self._still: dict[tuple[tuple[int, int], ...], tuple[Mapping[int, Solid], tuple[Surface, ...]]] = {}

    def of(self, solid: Solid) -> Surface | None:
        """Return the surface of a solid in its own frame; None if it has few triangles. Raise BadSolid if it is impossible."""
        if id(solid) not in self._moving:
            for placed in solid.shapes:
                check_shape(placed.shape)
            surface = Surface({0: solid}) if len(facets(solid).corners) > FEW else None
            self._moving[id(solid)] = solid, surface  # kept, so that no other object gets this id
        return self._moving[id(solid)][1]

    def still(self, solids: Mapping[int, Solid]) -> tuple[Surface, ...]:
        """Return the surfaces of static solids, by ids: one for each point of the lattice. The last result is cached."""
        key = tuple((body, id(solid)) for body, solid in solids.items())
        if key not in self._still:
            made = tuple(Surface(there, about) for about, there in _by_origin(solids).items())
            self._still = {key: (dict(solids), made)}
        return self._still[key][1]


def _by_origin(solids: Mapping[int, Solid]) -> dict[tuple[float, ...], dict[int, Solid]]:
    """Return the meshed static solids, by the point of the lattice about which each is kept."""
    found: dict[tuple[float, ...], dict[int, Solid]] = {}
    for body, solid in solids.items():
        if any(not isinstance(placed.shape, HalfSpace) for placed in solid.shapes):
            centre, _ = middle(facets(solid))
            about = tuple((LATTICE_M * np.round(centre / LATTICE_M)).tolist())
            found.setdefault(about, {})[body] = solid
    return found


class EmbreePicker:
    """Embree as a `Picker`, in float32. Without `robust` it is a fifth faster, but a ray may slip through between two triangles: for pictures."""

    def __init__(self, corners: FloatArray, robust: bool = True) -> None:
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh
        from embreex.rtcore_scene import EmbreeScene

        n = len(corners)
        self._scene = EmbreeScene(robust=robust)
        flat = corners.reshape(-1, 3).astype(np.float32)
        self._mesh = EmbreeMesh(self._scene, flat, np.arange(3 * n, dtype=np.int32).reshape(-1, 3))

    def pick(self, origin: FloatArray, direction: FloatArray, limit: FloatArray | None = None) -> IntArray:
        """Implement `Picker.pick`."""
        picked: IntArray = self._scene.run(origin, direction, limit)
        return picked
