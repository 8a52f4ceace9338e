"""coal (the successor of hpp-fcl) as an engine. The only module that knows coal; it imports it when an engine is made.

Its ways out of an overlap come from its GJK and EPA in float64. It keeps no state between questions.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from uwserver.frames import matrix
from uwserver.physics.collision.engine import Pose
from uwserver.physics.geometry.rows import Part
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Sphere
from uwserver.physics.kernel.arrays import FloatArray


class CoalEngine:
    """coal as an `engine.Engine`.

    Raises:
        ImportError: coal is not installed.
    """

    name = "coal"

    def __init__(self) -> None:
        import coal

        self._coal: Any = coal
        self._shapes: dict[int, Any] = {}
        self._next = 0
        self._request = coal.DistanceRequest()
        self._request.enable_signed_distance = True

    def close(self) -> None:
        """Implement `Engine.close`."""
        self._shapes.clear()

    def add(self, placed: Placed, rows: Part) -> int:
        """Implement `Engine.add`."""
        handle, self._next = self._next, self._next + 1
        self._shapes[handle] = self._shape(placed, rows)
        return handle

    def _shape(self, placed: Placed, rows: Part) -> Any:
        coal, shape = self._coal, placed.shape
        if isinstance(shape, Box):
            return coal.Box(*(2.0 * half for half in shape.half))
        if isinstance(shape, Sphere):
            return coal.Sphere(shape.radius)
        if isinstance(shape, Cylinder | Capsule):
            kind = coal.Cylinder if isinstance(shape, Cylinder) else coal.Capsule
            return kind(shape.radius, 2.0 * shape.half_length)
        assert isinstance(shape, ConvexHull)
        assert rows.corners is not None
        fans = [(ring[0], *side) for ring in rows.corners.faces for side in pairwise(ring[1:])]
        points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for vertex in rows.corners.vertices:
            points.append(vertex)
        for triangle in fans:
            faces.append(coal.Triangle(*triangle))
        return coal.Convex(points, faces)

    def way_out(self, a: int, pose_a: Pose, b: int, pose_b: Pose) -> FloatArray:
        """Implement `Engine.way_out`."""
        answer = self._coal.DistanceResult()
        self._coal.distance(
            self._shapes[a], self._placed(pose_a), self._shapes[b], self._placed(pose_b), self._request, answer
        )
        way: FloatArray = -np.array(answer.normal, dtype=np.float64)
        return way

    def _placed(self, pose: Pose) -> Any:
        x, y, z, w = pose.q.tolist()
        return self._coal.Transform3s(np.array(matrix((w, x, y, z))), pose.p)
