"""The newest samples of a sensor in all copies, as arrays by field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwserver.modifiers.columns import Columns
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.ports import Port


class Readings(Mapping[str, NDArray[Any]]):
    """The newest delivered samples of one port of n copies: ``readings["depth"]`` is an array (n, *shape of the field).

    Floats are nan if a sensor has no value, and before its first sample; truths are then false, and whole numbers -2**63. Fields of texts
    and buffers are left out. The arrays belong to the caller until these readings are given as ``out=`` to be filled again.

    Attributes:
        port: of the sensor.
        packed: (n, w) the numbers of all fields, one after the other.
        stamps: (n, 4) seq, t_ns, t_sent_ns, valid.
    """

    def __init__(self, port: Port, n: int) -> None:
        self.port, self._columns = port, Columns(port.fields)
        self.packed: FloatArray = np.full((n, self._columns.width), np.nan)
        self.stamps: IntArray = np.zeros((n, 4), np.int64)
        self._places = {
            field.name: (field, place)
            for field, place in zip(port.fields, self._columns.first, strict=True)
            if place >= 0
        }

    @property
    def seq(self) -> IntArray:
        """(n) number of the sample in the run of its copy, from 0; -1 before the first."""
        return self.stamps[:, 0]

    @property
    def t_ns(self) -> IntArray:
        """(n) simulation time of the copy at which the sample was true, ns; -1 before the first."""
        return self.stamps[:, 1]

    @property
    def t_sent_ns(self) -> IntArray:
        """(n) simulation time of its delivery, ns; -1 before the first."""
        return self.stamps[:, 2]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(n) whether there is a sample, and the sensor could measure."""
        valid: NDArray[np.bool_] = self.stamps[:, 3] != 0
        return valid

    def __getitem__(self, name: str) -> NDArray[Any]:
        field, place = self._places[name]
        part: NDArray[Any] = self.packed[:, place : place + field.size]
        if field.type == "bool":
            part = part == 1.0
        elif field.type == "int":
            part = self.packed.view(np.int64)[:, place : place + field.size].copy()
            part[self.stamps[:, 0] < 0] = -(1 << 63)
        return part.reshape(self.shape_of(name))

    def shape_of(self, name: str) -> tuple[int, ...]:
        """Return the shape (n, *shape) of a field."""
        return len(self.packed), *self._places[name][0].shape

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
