"""Arrays of one sonar that compiled code reads. Their sizes are those of its fan, so they lie in a block of its own: its record holds the address."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.deferred import Elsewhere
from uwserver.physics.kernel.layout import Forms, addresses, columns
from uwserver.sensors.acoustic.imaging.fan import CELL
from uwserver.sensors.acoustic.imaging.silhouettes import CUT
from uwserver.sensors.acoustic.imaging.speckle import PHASORS, WAYS

FORMS: Forms = {
    "cells": CELL,  # of the fan (n)
    "direction": columns(np.float64, 3),  # of its rays, in its own frame
    "towards": columns(np.float64, 3),  # and in N, of this ping
    "distance": columns(np.float64),  # what these meet, as `Hits`, while finer rays are cast
    "normal": columns(np.float64, 3),
    "body": columns(np.int64),
    "material": columns(np.int64),
    "place": columns(np.float64, 2),  # of `Fan`, as the following three
    "area": columns(np.float64),
    "across_power": columns(np.float64),
    "along_power": columns(np.float64),
    "cuts": CUT,  # (n) how its cells are cut
    "finer": CELL,  # the new ones
    # Real and imaginary part of the last ping's bins, uPa; behind them of what it would be without errors.
    "sound": columns(np.float64, 2),
    "phasors": columns(np.float32, 2),  # of `speckle`
    "ways": columns(np.float64, 7),
}
"""Of the table of a block."""


block_of: Any = Elsewhere("uwserver.sensors.acoustic.imaging.laid", "block_of")
"""In compiled code: the block of a record with its `block`."""


class Block:
    """Keeps the arrays.

    Attributes:
        arrays: by the names of FORMS.
        address: of the table by which compiled code finds them.
    """

    def __init__(self, **arrays: Any) -> None:
        """Of some arrays; those that are not given are empty."""
        empty = {name: np.zeros((0, *form.shape), form.base) for name, form in FORMS.items()}
        self.arrays: dict[str, Any] = {**empty, "phasors": PHASORS, "ways": WAYS, **arrays}
        self._table: IntArray = addresses(FORMS, self.arrays)
        self.address = int(self._table.ctypes.data)
