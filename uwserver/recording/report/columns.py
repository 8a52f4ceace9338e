"""Collects the values of a field as columns of numbers. Echoes of sonars, also those in pictures, become one row per ping."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from array import array
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from uwserver.adapter.pictures import amplitudes
from uwserver.ports import Buffer, Field

FloatArray = npt.NDArray[np.float64]

ACROSS = 256
"""Numbers that are kept of a row of echoes, each the largest of its neighbours. A plot of pings over time has fewer pixels."""
_ECHOES: Mapping[str, Mapping[str, int]] = {
    "SonarImage": {"image": 2},
    "SonarPing": {"bins": 1},
    "SideScan": {"port": 1, "starboard": 1},
}
"""Number of dimensions of the fields that contain echoes over range, by the standard message of the sonar."""


class Column(ABC):
    """The numbers of one field, `size` of them per message."""

    def __init__(self, size: int) -> None:
        self.size, self.numbers = size, array("d")

    @abstractmethod
    def add(self, value: Any) -> None:
        """Add the value of a message. Raises ValueError or TypeError, and adds nothing, when it does not fit."""

    def whole(self, count: int) -> FloatArray:
        """Return the numbers (count, size) of the first messages."""
        return np.frombuffer(self.numbers, dtype=np.float64)[: count * self.size].reshape(count, self.size)


class Numbers(Column):
    """The column of a field of numbers."""

    def add(self, value: Any) -> None:
        if value is None:
            self.numbers.extend([math.nan] * self.size)
        elif self.size == 1 and not isinstance(value, list):
            self.numbers.append(value)
        elif isinstance(value, list) and len(value) == self.size:
            try:
                self.numbers.extend(value)
            except TypeError:
                del self.numbers[len(self.numbers) // self.size * self.size :]
                self.numbers.extend([math.nan if v is None else v for v in value])
        else:
            raise ValueError(f"{value!r} instead of {self.size} numbers")


class Echoes(Column):
    """The column of a buffer of echoes over range: their amplitudes; of a picture those of the strongest beam at each range."""

    def __init__(self, dimensions: int) -> None:
        super().__init__(ACROSS)
        self._dimensions = dimensions

    def add(self, value: Any) -> None:
        row: FloatArray = np.full(1, math.nan)
        if value is not None:
            heard = amplitudes(msgspec.convert(value, Buffer), self._dimensions)
            if heard.ndim != self._dimensions or not heard.size:
                raise ValueError(f"echoes of shape {list(heard.shape)}")
            row = heard.max(axis=1).astype(np.float64) if heard.ndim == 2 else heard.astype(np.float64)
        self.numbers.extend(np.maximum.reduceat(row, np.arange(ACROSS) * len(row) // ACROSS))


def columns_of(message: str, fields: Mapping[str, Field]) -> Iterator[tuple[str, Column]]:
    """Yield names and empty columns of the fields of a port that fits this message. Texts and other buffers have no column."""
    echoes = _ECHOES.get(message, {})
    for name, field in fields.items():
        if field.type not in ("str", "bytes", "buffer"):
            yield name, Numbers(field.size)
        elif name in echoes and field.type != "str":
            yield name, Echoes(echoes[name])
