"""Rays of a fan in one ping: cast, kept while finer ones are cast, and heard (compiled)."""

from __future__ import annotations

from typing import Any

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.rays.raycast import Hits
from uwserver.sensors.bank import meet_surface


@compiled
def turn(R: Array, ray: Array, out: Array) -> None:
    """Components in N (3) of a vector in the frame of a head, whose axes are the columns of R; both may lie in one place."""
    x, y, z = ray[0], ray[1], ray[2]
    for j in range(3):
        out[j] = R[j, 0] * x + R[j, 1] * y + R[j, 2] * z


@compiled
def cast_fan(rays: Array, R: Array, p: Vec3, first: int, origin: Array, direction: Array) -> int:
    """Cast rays (n, 3), given in the frame of a head with the axes R, from a point of N (m): into the arrays of all rays, from `first` on.
    Returns the place behind them."""
    for i in range(len(rays)):
        origin[first + i, 0], origin[first + i, 1], origin[first + i, 2] = p
        turn(R, rays[i], direction[first + i])
    return int(first + len(rays))


@compiled
def part_of(hits: Hits, begin: int, end: int) -> Hits:
    """Some of all hits."""
    return Hits(hits.distance[begin:end], hits.normal[begin:end], hits.body[begin:end], hits.material[begin:end])


@compiled
def see(height: float, direction: Array, limit: float, hits: Hits) -> None:
    """Have hits be those of one sonar, which sees no farther than a limit (m), under a surface `height` (m) above it."""
    for k in range(len(direction)):
        meet_surface(height, direction, limit, k, hits)


@compiled
def keep(hits: Hits, block: Any) -> Hits:
    """A copy of hits of a fan in the block of its sonar."""
    met: Hits = kept(block)
    for k in range(len(hits.distance)):
        met.distance[k], met.body[k], met.material[k] = hits.distance[k], hits.body[k], hits.material[k]
        for j in range(3):
            met.normal[k, j] = hits.normal[k, j]
    return met


@compiled
def kept(block: Any) -> Hits:
    """The hits that are kept there."""
    return Hits(block.distance, block.normal, block.body, block.material)
