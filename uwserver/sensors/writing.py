"""Sensors that tell what others know, and for which compiled code can write."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from uwserver.ports import Value


class Writing(NamedTuple):
    """How compiled code writes the readings of a sensor: as it does those of autopilots (`autopilot.entries.tell_one`).

    Attributes:
        row: its number there.
        texts: by what that tells, the values that are no numbers.
    """

    row: int
    texts: Sequence[tuple[Value, ...]]
