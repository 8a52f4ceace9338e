"""The state of samples in flight: they are measured and not delivered yet."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from msgspec import Meta, structs

from uwserver.ports import Value
from uwserver.world.components import Count, computed
from uwserver.world.part import State

_MOST = 65536
IN_FLIGHT = np.dtype([(name, "i8") for name in ("t_sent_ns", "order", "port", "seq", "t_ns", "valid")])
"""A sample in flight in a state; `port` is its place in the ports of that state."""


class InFlightSamples(State, frozen=True, omit_defaults=True):
    """The samples in flight.

    Attributes:
        order: how many samples were ever in flight.
        ports: ports that have a sample in flight.
        entries: for each sample a record of int64, in the order of delivery: time of delivery (ns), order, place of the port in `ports`,
            seq, t_ns, valid.
        numbers: the numbers of one sample after the other, float64.
        loose: values that are no numbers, for samples of ports with such fields.
        pictures: the same for sensors that take time.
    """

    order: Count
    ports: Annotated[tuple[str, ...], Meta(max_length=_MOST)]
    entries: Annotated[bytes, Meta(max_length=_MOST * IN_FLIGHT.itemsize)]
    numbers: bytes
    loose: Annotated[tuple[tuple[Value, ...], ...], Meta(max_length=_MOST)]
    pictures: Annotated[tuple[tuple[Value, ...], ...], Meta(max_length=_MOST)] = ()

    def deciding(self) -> InFlightSamples:
        """Leave the pictures out: they follow from the other values, and may still be under computation."""
        return structs.replace(self, pictures=()) if self.pictures else self

    def completed(self) -> InFlightSamples:
        """Wait for the pictures, and put them in."""
        return structs.replace(self, pictures=computed(self.pictures))

    def checked_entries(self) -> Any:
        """Return the records (IN_FLIGHT) of the samples.

        Raises:
            ValueError: the records are not possible.
        """
        if len(self.entries) % IN_FLIGHT.itemsize:
            raise ValueError("the samples in flight end within a record")
        entries = np.frombuffer(self.entries, IN_FLIGHT)
        limits = {
            "t_sent_ns": 2**62,
            "order": self.order,
            "port": len(self.ports) - 1,
            "seq": 2**62,
            "t_ns": 2**62,
            "valid": 1,
        }
        if any(((entries[name] < 0) | (entries[name] > most)).any() for name, most in limits.items()):
            raise ValueError("a sample in flight is not possible")
        if (np.lexsort((entries["order"], entries["t_sent_ns"])) != np.arange(len(entries))).any():
            raise ValueError("the samples in flight are not in the order of their delivery")
        return entries
