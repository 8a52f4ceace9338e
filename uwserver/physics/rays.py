"""Rays against everything solid in a world, through Embree: the engine of all ranging sensors.

Embree works in float32, so it only picks the triangle; range and normal are computed from it in float64, and its scenes are kept about an
origin of their own. It knows no instances: what moves has a scene in its own frame, shared by equal solids, and only rays that pass it go
there. Imported only when a world has something solid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene

from uwserver.physics import hits
from uwserver.physics.facets import Facets, facets
from uwserver.physics.geometry import FloatArray, Hits, IntArray, no_hits
from uwserver.physics.layout import P, Q
from uwserver.physics.shapes import HalfSpace, Solid, check_shape, turned

_HIDDEN_SIDES = 16
"""A ray gives up behind this many hidden sides."""
_UPRIGHT = np.eye(3)


class _Scene:
    """Triangles of solids in one frame, about their own centre.

    Args:
        solids: by id; an id is told only if a ray is cast without one.
    """

    def __init__(self, solids: Mapping[int, Solid]) -> None:
        each = {body: facets(solid) for body, solid in solids.items()}
        parts = Facets(*(np.concatenate(columns) for columns in zip(*each.values(), strict=True)))
        self.owners: IntArray = np.repeat(
            np.array([*each], dtype=np.int64), [len(part.corners) for part in each.values()]
        )
        low, high = parts.corners.min(axis=(0, 1)), parts.corners.max(axis=(0, 1))
        self.centre: FloatArray = 0.5 * (low + high)
        self.radius = float(np.linalg.norm(parts.corners - self.centre, axis=2).max())
        self.corners: FloatArray = parts.corners - self.centre
        self.material, self.sided = parts.material, parts.sided
        self._scene = EmbreeScene(robust=True)
        n = len(self.corners)
        self._mesh = EmbreeMesh(
            self._scene, self.corners.reshape(-1, 3).astype(np.float32), np.arange(3 * n, dtype=np.int32).reshape(-1, 3)
        )

    def cast(
        self, origin: FloatArray, direction: FloatArray, rays: IntArray, R: FloatArray, body: int, answer: Hits
    ) -> None:
        """Enter the hits of rays (m, 3), given in the frame of the scene, into the answer at their places `rays` (m)."""
        start = np.zeros(len(origin))
        # What float32 cannot tell apart.
        step = 1e-6 * (self.radius + float(np.abs(origin).max(initial=0.0)))
        origin = origin - self.centre
        for _ in range(_HIDDEN_SIDES):
            ahead = origin if not start.any() else origin + start[:, None] * direction
            picked = self._scene.run(ahead.astype(np.float32), direction.astype(np.float32))
            again = np.empty(len(origin), np.int64)
            count = hits.settle(
                origin, direction, rays, picked, start, self.corners, self.sided, R, body, self.owners, self.material,
                answer.distance, answer.normal, answer.body, answer.material, again,
            )  # fmt: skip
            if count == 0:
                return
            behind = again[:count]
            origin, direction, rays, start = origin[behind], direction[behind], rays[behind], start[behind] + step


@dataclass(frozen=True)
class _Moving:
    scene: _Scene
    row: int


class Rays:
    """All solids of one world, by ids that the caller chooses. Not thread-safe.

    Only the outside of a solid is hit: a ray that starts inside, as from a sensor within its vehicle's own shape, leaves unhindered.
    """

    def __init__(self) -> None:
        self._static: dict[int, Solid] = {}
        self._moving: dict[int, _Moving] = {}
        self._scenes: dict[int, tuple[Solid, _Scene]] = {}
        self._still: _Scene | None = None

    def add_static(self, body: int, solid: Solid) -> None:
        """Add something that never moves. Raises BadSolid."""
        for placed in solid.shapes:
            check_shape(placed.shape)
        self._static[body] = solid
        self._still = None

    def add_moving(self, body: int, solid: Solid, row: int) -> None:
        """Add what the body in `row` of the state array carries. Raises BadSolid."""
        for placed in solid.shapes:
            check_shape(placed.shape)
        key = id(solid)
        if key not in self._scenes:
            self._scenes[key] = solid, _Scene({0: solid})
        self._moving[body] = _Moving(self._scenes[key][1], row)

    def remove(self, body: int) -> None:
        """Take a solid away; KeyError if there is none of this id."""
        if body in self._moving:
            gone = self._moving.pop(body).scene
            if all(moving.scene is not gone for moving in self._moving.values()):
                self._scenes = {key: kept for key, kept in self._scenes.items() if kept[1] is not gone}
            return
        del self._static[body]
        self._still = None

    def at(self, state: FloatArray) -> Instant:
        """The solids where a state (n, 13) puts them."""
        return Instant(self, state)

    def cast(self, state: FloatArray, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """See `uwserver.physics.geometry.Geometry.raycast`; moving bodies stand where `state` says."""
        origin, direction = (np.ascontiguousarray(v, dtype=np.float64) for v in (origin, direction))
        answer = no_hits(len(origin))
        limit = np.nextafter(max_range, np.inf)
        answer.distance[:] = limit
        for body, solid in self._static.items():
            for placed in solid.shapes:
                if isinstance(placed.shape, HalfSpace):
                    material = solid.material if placed.material < 0 else placed.material
                    hits.meet_plane(
                        origin, direction, np.array(placed.p), -turned(placed.q)[:, 2], body, material, answer.distance,
                        answer.normal, answer.body, answer.material,
                    )  # fmt: skip
        still = self._still_scene()
        if still is not None:
            still.cast(origin, direction, np.arange(len(origin)), _UPRIGHT, -1, answer)
        near = np.empty(len(origin), np.int64)
        for body, moving in self._moving.items():
            p, R = state[moving.row, P : P + 3], turned(tuple(state[moving.row, Q : Q + 4].tolist()))
            centre = p + R @ moving.scene.centre
            count = hits.passing(origin, direction, centre, moving.scene.radius, answer.distance, near)
            if count:
                some = near[:count]
                moving.scene.cast((origin[some] - p) @ R, direction[some] @ R, some, R, body, answer)
        answer.distance[answer.body < 0] = np.inf
        return answer

    def _still_scene(self) -> _Scene | None:
        """All static triangles, gathered at the first rays after a change."""
        meshed = {b: s for b, s in self._static.items() if any(not isinstance(x.shape, HalfSpace) for x in s.shapes)}
        if self._still is None and meshed:
            self._still = _Scene(meshed)
        return self._still


class Instant:
    """A `uwserver.physics.geometry.Geometry`: solids where a state (n, 13) puts them, read when rays are cast."""

    def __init__(self, rays: Rays, state: FloatArray) -> None:
        self._rays, self._state = rays, state

    def raycast(self, origin: FloatArray, direction: FloatArray, max_range: float) -> Hits:
        """The nearest solid that each ray meets."""
        return self._rays.cast(self._state, origin, direction, max_range)
