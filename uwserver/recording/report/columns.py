"""Values of a field as columns of numbers: plain numbers as they are, rows of echoes and pictures of them as one row each."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from uwserver.adapter.pictures import amplitudes
from uwserver.ports import Buffer, Field

FloatArray = npt.NDArray[np.float64]

ACROSS = 256
"""Numbers that are kept of a row of echoes, each the largest of its neighbours: more than a plot of pings over time is high."""
_ECHOES: Mapping[str, Mapping[str, int]] = {
    "multibeam": {"image": 2},
    "scanning_sonar": {"bins": 1},
    "side_scan": {"port": 1, "starboard": 1},
}
"""Fields of sonars that hold echoes over range, by kind, and their dimensions."""


class Column(Protocol):
    """Numbers of one field as they come; `size` of them a message."""

    size: int
    numbers: array[float]

    def add(self, value: Any) -> None:
        """Take the value of a message; ValueError or TypeError, with nothing taken, where it does not fit."""

    def whole(self, count: int) -> FloatArray:
        """(count, size) of the first messages."""


class _Column:
    def __init__(self, size: int) -> None:
        self.size, self.numbers = size, array("d")

    def whole(self, count: int) -> FloatArray:
        return np.frombuffer(self.numbers, dtype=np.float64)[: count * self.size].reshape(count, self.size)


class Numbers(_Column):
    """Of a field of numbers."""

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
            raise ValueError(f"{value!r} where {self.size} numbers should stand")


class Echoes(_Column):
    """Of a buffer of echoes over range: the amplitude, of a picture that of the strongest beam at each range."""

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


def columns_of(kind: str, fields: Mapping[str, Field]) -> Iterator[tuple[str, Column]]:
    """Names and empty columns of the fields of a port of this kind; texts and other buffers have none."""
    echoes = _ECHOES.get(kind, {})
    for name, field in fields.items():
        if field.type not in ("str", "bytes", "buffer"):
            yield name, Numbers(field.size)
        elif name in echoes and field.type != "str":
            yield name, Echoes(echoes[name])
