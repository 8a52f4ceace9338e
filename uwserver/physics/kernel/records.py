"""Rows of records end to end."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from uwserver.physics.kernel.arrays import Records


def joined(rows: Iterable[Records], dtype: np.dtype[np.void]) -> Records:
    """All rows as one new array of their dtype, which is empty for none.

    As plain bytes: numpy compares records field by field before it joins them, which for a world of vehicles takes longer than a tick.
    """
    data = b"".join([row.tobytes() for row in rows])
    made: Records = np.empty(len(data) // dtype.itemsize, dtype)
    made.view(np.uint8)[:] = np.frombuffer(data, np.uint8)
    return made
