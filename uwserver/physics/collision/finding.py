"""What compiled code needs to look for contacts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.collision.contacts import NUMBERS
from uwserver.physics.kernel.arrays import FloatArray, IntArray


class Finding(NamedTuple):
    """What compiled code needs to look for contacts, as `Solids.find_contacts` does where no engine has to be asked; until something comes or goes.

    Attributes:
        find_pairs, find_lines, find_contacts: where the code of the stages lies (`kernel.calling`): of `broad_phase`, `directions`, `narrow_phase`.
        table: of the shapes.
        margin: of the search, m.
        pairs, line_first, lines, overlapping: what the first two receive.
        bodies, numbers, keys, coefficients: what the last one receives.
        led: rows of bodies that yield to nothing, which have no contacts with what does not move, nor with their like.
    """

    find_pairs: int
    find_lines: int
    find_contacts: int
    table: IntArray
    margin: float
    pairs: IntArray
    line_first: IntArray
    lines: FloatArray
    overlapping: Any
    bodies: IntArray
    numbers: FloatArray
    keys: IntArray
    coefficients: FloatArray
    led: IntArray


_NO_ROWS: IntArray = np.zeros(0, np.int64)
_NO_TABLE: IntArray = np.zeros((0, 2), np.int64)
NO_FINDING = Finding(
    0, 0, 0, _NO_TABLE, 0.0, _NO_TABLE, np.zeros(1, np.int64), np.zeros((0, 7)), np.zeros(0, np.bool_), _NO_TABLE, np.zeros((0, NUMBERS)), _NO_ROWS,
    np.zeros((0, 2)), _NO_ROWS,
)  # fmt: skip
"""Where nothing can touch anything."""
