"""The arrays of a sonar's block, as compiled code finds them by the address in its record. Imports numba."""

from __future__ import annotations

from typing import Any, NamedTuple

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import inlined
from uwserver.physics.kernel.handles import arrays_at, lay
from uwserver.sensors.acoustic.imaging.blocks import FORMS


class Laid(NamedTuple):
    """Of `blocks.FORMS`."""

    cells: Array
    direction: Array
    towards: Array
    distance: Array
    normal: Array
    body: Array
    material: Array
    place: Array
    area: Array
    across_power: Array
    along_power: Array
    cuts: Array
    finer: Array
    sound: Array
    phasors: Array
    ways: Array


_COUNT = len(FORMS)
_laid_at = arrays_at(Laid, FORMS)


@inlined
def block_of(row: Any) -> Any:
    """The block of a record with its `block`."""
    return _laid_at(lay(row.block, 2 * _COUNT).reshape((_COUNT, 2)))
