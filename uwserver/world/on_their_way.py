"""What is kept of samples that are measured and not delivered yet."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from msgspec import Meta, structs

from uwserver.ports import Value
from uwserver.world.components import Count, computed
from uwserver.world.part import State

_MOST = 65536
WAY = np.dtype([(name, "i8") for name in ("t_sent_ns", "order", "port", "seq", "t_ns", "valid")])
"""A sample on its way in a state; `port` counts the ports of that state."""


class OnTheirWay(State, frozen=True, omit_defaults=True):
    """Samples that are measured and not delivered yet.

    Attributes:
        order: how many were on their way before.
        ports: that have one on its way.
        entries: a record of int64 each, in the order of their delivery: when (ns), order, port by its place in `ports`, seq, t_ns, valid.
        numbers: of one after the other, float64.
        loose: of those of ports with such fields, the values that are no numbers.
        pictures: the same of sensors that take time.
    """

    order: Count
    ports: Annotated[tuple[str, ...], Meta(max_length=_MOST)]
    entries: Annotated[bytes, Meta(max_length=_MOST * WAY.itemsize)]
    numbers: bytes
    loose: Annotated[tuple[tuple[Value, ...], ...], Meta(max_length=_MOST)]
    pictures: Annotated[tuple[tuple[Value, ...], ...], Meta(max_length=_MOST)] = ()

    def deciding(self) -> OnTheirWay:
        """Pictures follow from the rest, and may be under computation."""
        return structs.replace(self, pictures=()) if self.pictures else self

    def settled(self) -> OnTheirWay:
        """With the pictures computed."""
        return structs.replace(self, pictures=computed(self.pictures))

    def checked_entries(self) -> Any:
        """Records (WAY) of the samples.

        Raises:
            ValueError: they cannot be.
        """
        if len(self.entries) % WAY.itemsize:
            raise ValueError("samples on their way that end within one")
        entries = np.frombuffer(self.entries, WAY)
        limits = {
            "t_sent_ns": 2**62,
            "order": self.order,
            "port": len(self.ports) - 1,
            "seq": 2**62,
            "t_ns": 2**62,
            "valid": 1,
        }
        if any(((entries[name] < 0) | (entries[name] > most)).any() for name, most in limits.items()):
            raise ValueError("a sample on its way that cannot be")
        if (np.lexsort((entries["order"], entries["t_sent_ns"])) != np.arange(len(entries))).any():
            raise ValueError("samples on their way that are not in the order of their delivery")
        return entries
