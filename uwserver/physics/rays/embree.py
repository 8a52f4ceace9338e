"""Embree as a picker of triangles, in float32. The only module that knows embreex, and it is imported only where that is installed."""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene

from uwserver.physics.kernel.arrays import FloatArray, IntArray


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
