"""Boxes around the structures that the tables of sensors name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Placed, Solid, Sphere, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.sensors.others import Outline
from uwserver.world.members import Member


def survey_structures(member: Member, vehicle: ResolvedVehicle, static: Mapping[str, Solid]) -> None:
    """Give the sensors of a new vehicle the outlines of the structures that their tables name. static: seabed and structures in N, by name."""
    sensors = {slot.path: slot.sensor for slot in member.sensors}
    for key, config in vehicle.vehicle.sensors.items():
        names = {named.name for named in config.traits().names if named.table == "structures"} & static.keys()
        if names:
            sensor = sensors[config.port_of(member.vehicle.name, key)]
            sensor.outlines = {name: outline_of(static[name]) for name in names}


def outline_of(solid: Solid) -> Outline:
    """Return the box around a structure, along the axes of its first shape."""
    first = solid.shapes[0]
    corners = np.concatenate([_corners(placed) for placed in solid.shapes])
    local = (corners - first.p) @ first.R
    low, high = local.min(axis=0), local.max(axis=0)
    middle = first.p + first.R @ (0.5 * (low + high))
    x, y, z = middle.tolist()
    a, b, c = (0.5 * (high - low)).tolist()
    return Outline((x, y, z), first.q, (a, b, c))


def _corners(placed: Placed) -> FloatArray:
    """Return (n, 3) points of N whose bounding box is that of the shape."""
    shape = placed.shape
    if isinstance(shape, TriangleMesh):
        points: FloatArray = np.asarray(shape.vertices, dtype=np.float64)
    elif isinstance(shape, ConvexHull):
        points = np.asarray(shape.points, dtype=np.float64)
    else:
        if isinstance(shape, Box):
            half = np.array(shape.half)
        elif isinstance(shape, Sphere):
            half = np.full(3, shape.radius)
        elif isinstance(shape, Cylinder | Capsule):
            ends = shape.radius if isinstance(shape, Capsule) else 0.0
            half = np.array([shape.half_length + ends, shape.radius, shape.radius])
        else:
            raise TypeError(f"a structure cannot have the shape {type(shape).__name__}")
        signs = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
        points = signs * half
    return points @ placed.R.T + placed.p
