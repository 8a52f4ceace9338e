"""The arrays of one sonar that compiled code reads, and the rays of its fan in one ping.

The sizes of the arrays depend on the fan, so they lie in a block of their own. The record of the sonar holds the address of the block.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, IntArray
from uwserver.physics.kernel.deferred import Elsewhere, compiled
from uwserver.physics.kernel.layout import Forms, addresses, columns
from uwserver.physics.rays.raycast import Hits
from uwserver.sensors.acoustic.imaging.fan import CELL
from uwserver.sensors.acoustic.imaging.silhouettes import CUT
from uwserver.sensors.acoustic.imaging.speckle import PHASORS, WAYS
from uwserver.sensors.compiled import meet_surface

FORMS: Forms = {
    "cells": CELL,  # of the fan (n)
    "direction": columns(np.float64, 3),  # of its rays, in its own frame
    "towards": columns(np.float64, 3),  # the same in N, in this ping
    "distance": columns(np.float64),  # what these rays hit, as `Hits`; kept while finer rays are cast
    "normal": columns(np.float64, 3),
    "body": columns(np.int64),
    "material": columns(np.int64),
    "place": columns(np.float64, 2),  # as in `Fan`, like the following three
    "area": columns(np.float64),
    "across_power": columns(np.float64),
    "along_power": columns(np.float64),
    "cuts": CUT,  # (n) how its cells are cut
    "finer": CELL,  # the new cells
    # Real and imaginary part of the last ping's bins, uPa; behind them the same without errors.
    "sound": columns(np.float64, 2),
    "phasors": columns(np.float32, 2),  # of `speckle`, as is the next one
    "ways": columns(np.float64, 7),
}
"""The arrays of a block."""


block_of: Any = Elsewhere("uwserver.sensors.acoustic.imaging.block_arrays", "block_of")
"""In compiled code: return the block of a record that has its address as `block`."""


class Block:
    """Owns the arrays of a sonar.

    Attributes:
        arrays: by the names of FORMS.
        address: address of the table by which compiled code finds them.
    """

    def __init__(self, **arrays: Any) -> None:
        """Take some arrays by their names in FORMS; the others are empty."""
        empty = {name: np.zeros((0, *form.shape), form.base) for name, form in FORMS.items()}
        self.arrays: dict[str, Any] = {**empty, "phasors": PHASORS, "ways": WAYS, **arrays}
        self._table: IntArray = addresses(FORMS, self.arrays)
        self.address = int(self._table.ctypes.data)


@compiled
def turn(R: Array, ray: Array, out: Array) -> None:
    """Write a vector in N to `out` (3), from its components in the frame of a head whose axes are the columns of R. `out` may be `ray` itself."""
    x, y, z = ray[0], ray[1], ray[2]
    for j in range(3):
        out[j] = R[j, 0] * x + R[j, 1] * y + R[j, 2] * z


@compiled
def cast_fan(rays: Array, R: Array, p: Vec3, first: int, origin: Array, direction: Array) -> int:
    """Lay the rays of a fan into the arrays of all rays, from ray number `first` on. Returns the number behind the last one.

    Args:
        rays: (n, 3) in the frame of a head.
        R: (3, 3) whose columns are the axes of the head in N.
        p: common origin in N, m.
        first: number of the first ray.
        origin, direction: (m, 3) of all rays.
    """
    for i in range(len(rays)):
        origin[first + i, 0], origin[first + i, 1], origin[first + i, 2] = p
        turn(R, rays[i], direction[first + i])
    return int(first + len(rays))


@compiled
def part_of(hits: Hits, begin: int, end: int) -> Hits:
    """Return the hits from `begin` to `end`."""
    return Hits(hits.distance[begin:end], hits.normal[begin:end], hits.body[begin:end], hits.material[begin:end])


@compiled
def hit_surface(height: float, direction: Array, limit: float, hits: Hits) -> None:
    """Let rays also hit the sea surface `height` (m) above their origin, and remove hits beyond the limit (m) of this sonar."""
    for k in range(len(direction)):
        meet_surface(height, direction, limit, k, hits)


@compiled
def keep(hits: Hits, block: Any) -> Hits:
    """Copy the hits of a fan into the block of its sonar. Returns the copy."""
    met: Hits = kept(block)
    for k in range(len(hits.distance)):
        met.distance[k], met.body[k], met.material[k] = hits.distance[k], hits.body[k], hits.material[k]
        for j in range(3):
            met.normal[k, j] = hits.normal[k, j]
    return met


@compiled
def kept(block: Any) -> Hits:
    """Return the hits that `keep` has copied into a block."""
    return Hits(block.distance, block.normal, block.body, block.material)
