"""How compiled code finds the arrays of a sonar's block by the address in its record. Imports numba."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

from uwserver.physics.kernel.compiled import inlined
from uwserver.physics.kernel.handles import arrays_at, view_at
from uwserver.sensors.acoustic.imaging.blocks import FORMS

Arrays = namedtuple("Arrays", list(FORMS))  # type: ignore[misc]  # mypy wants to see the names
_arrays_at = arrays_at(Arrays, FORMS)
_COUNT = len(FORMS)


@inlined
def block_of(row: Any) -> Any:
    """Return the arrays of the block whose address is `row.block`."""
    return _arrays_at(view_at(row.block, 2 * _COUNT).reshape((_COUNT, 2)))
