"""Bullet as an engine. The only module that knows pybullet, which it imports when an engine is made.

Bullet holds each shape as a body of its own, which is moved to the place of each question; it never steps. The answer of `getClosestPoints` depends
on the poses alone, unlike its contact manifolds.
"""

from __future__ import annotations

import ctypes
import os
import weakref
from functools import cache
from types import ModuleType
from typing import Any, cast

import numpy as np

from uwserver.physics.collision.engine import Pose
from uwserver.physics.geometry.rows import Part
from uwserver.physics.geometry.shapes import BadSolid, Box, Capsule, ConvexHull, Cylinder, Placed, Sphere
from uwserver.physics.kernel.arrays import FloatArray

_SLACK = 0.01
"""Distance up to which pairs are asked for, m. Bullet rounds edges by margins, so it may report a gap where the shapes just overlap."""


@cache
def _pybullet() -> ModuleType:
    """Import pybullet without the line that it writes to standard error at the import, so that a log does not begin with a stray date."""
    try:
        err = os.dup(2)
    except OSError:  # there is no standard error
        import pybullet

        return cast("ModuleType", pybullet)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        import pybullet

        if os.name == "posix":
            ctypes.CDLL(None).fflush(None)  # the line waits in the buffer of the C library
    finally:
        os.dup2(err, 2)
        os.close(err)
        os.close(nowhere)
    return cast("ModuleType", pybullet)


class BulletEngine:
    """Bullet as an `engine.Engine`.

    Raises:
        ImportError: pybullet is not installed.
        RuntimeError: it has no world left.
    """

    name = "bullet"

    def __init__(self) -> None:
        self._bullet: Any = _pybullet()
        self._client: int = self._bullet.connect(self._bullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("Bullet gives no further world: close some")
        # Otherwise the 29 MB of a world that nothing refers to any more would stay until the process ends.
        self._ended = weakref.finalize(self, self._bullet.disconnect, self._client)
        self._ended.atexit = False

    def close(self) -> None:
        """Implement `Engine.close`."""
        self._ended()
        self._client = -1

    def add(self, placed: Placed, rows: Part) -> int:
        """Implement `Engine.add`."""
        bullet, shape = self._bullet, placed.shape
        form: dict[str, Any]
        if isinstance(shape, Box):
            form = {"shapeType": bullet.GEOM_BOX, "halfExtents": list(shape.half)}
        elif isinstance(shape, Sphere):
            form = {"shapeType": bullet.GEOM_SPHERE, "radius": shape.radius}
        elif isinstance(shape, Cylinder | Capsule):
            kind = bullet.GEOM_CYLINDER if isinstance(shape, Cylinder) else bullet.GEOM_CAPSULE
            form = {"shapeType": kind, "radius": shape.radius, "height": 2.0 * shape.half_length}
        else:
            assert isinstance(shape, ConvexHull)
            assert rows.corners is not None
            form = {"shapeType": bullet.GEOM_MESH, "vertices": rows.corners.vertices.tolist()}
        made = bullet.createCollisionShape(physicsClientId=self._client, **form)
        if made < 0:
            raise BadSolid(f"Bullet refuses a {type(shape).__name__}")
        return int(bullet.createMultiBody(0.0, made, physicsClientId=self._client))

    def way_out(self, a: int, pose_a: Pose, b: int, pose_b: Pose) -> FloatArray:
        """Implement `Engine.way_out`."""
        self._place(a, pose_a)
        self._place(b, pose_b)
        lines = self._bullet.getClosestPoints(a, b, _SLACK, physicsClientId=self._client)
        deepest = min(lines, key=lambda line: float(line[8]), default=None)
        return np.array(deepest[7]) if deepest is not None else np.full(3, np.nan)

    def _place(self, handle: int, pose: Pose) -> None:
        self._bullet.resetBasePositionAndOrientation(
            handle, pose.p.tolist(), pose.q.tolist(), physicsClientId=self._client
        )
