"""Which bodies touch each other, directly or through others: islands, solved one by one (compiled)."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled


@compiled
def _root(parent: Array, i: int) -> int:
    while parent[i] != i:
        i = parent[i]
    return i


@compiled
def fill_slots(body: Array, slot_of: Array, bodies: Array, count: int, slots: Array) -> int:
    """Give each body a place in `bodies`, in the order in which the contacts name them; returns how many there are."""
    for c in range(body.shape[0]):
        row = body[c]
        slots[c] = -1
        if row >= 0:
            if slot_of[row] < 0:
                slot_of[row] = count
                bodies[count] = row
                count += 1
            slots[c] = slot_of[row]
    return count


@compiled
def find_islands(slot_a: Array, slot_b: Array, m: int, order: Array, bounds: Array) -> int:
    """Sort the contacts by islands, which keep the order of their first contacts; returns the number of islands."""
    k = slot_a.shape[0]
    parent = np.arange(m)
    for c in range(k):
        if slot_b[c] >= 0:
            a, b = _root(parent, slot_a[c]), _root(parent, slot_b[c])
            parent[max(a, b)] = min(a, b)
    island = np.full(m, -1)
    size = np.zeros(m + 1, np.int64)
    count = 0
    for c in range(k):
        root = _root(parent, slot_a[c])
        if island[root] < 0:
            island[root] = count
            count += 1
        size[island[root]] += 1
    bounds[0] = 0
    for i in range(count):
        bounds[i + 1] = bounds[i] + size[i]
        size[i] = bounds[i]
    for c in range(k):
        i = island[_root(parent, slot_a[c])]
        order[size[i]] = c
        size[i] += 1
    return count
