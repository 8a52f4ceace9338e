"""Reduces the points of a profile of sound speed: rays are found faster in fewer layers."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import entry


@entry
def thin_out(depth: Array, speed: Array, tolerance: float) -> Array:
    """Choose points of a profile such that the lines between them miss no other point by more than the tolerance (m/s; Douglas and Peucker, 1973).

    Args:
        depth, speed: (n) m ascending, and m/s.
        tolerance: m/s.

    Returns:
        (m) numbers of the chosen points, ascending; the first and the last point are always among them.
    """
    n = len(depth)
    kept, stack = np.zeros(n, np.bool_), np.empty((n + 1, 2), np.int64)
    kept[0] = kept[n - 1] = True
    stack[0, 0], stack[0, 1], size = 0, n - 1, 1
    while size:
        size -= 1
        low, high = stack[size]
        slope = (speed[high] - speed[low]) / (depth[high] - depth[low])
        worst, most = -1, tolerance
        for i in range(low + 1, high):
            off = abs(speed[i] - speed[low] - slope * (depth[i] - depth[low]))
            if off > most:
                worst, most = i, off
        if worst > 0:
            kept[worst] = True
            stack[size, 0], stack[size, 1], stack[size + 1, 0], stack[size + 1, 1] = low, worst, worst, high
            size += 2
    return np.nonzero(kept)[0]
