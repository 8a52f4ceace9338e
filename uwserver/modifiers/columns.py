"""Readings as rows of plain numbers, for compiled code: the places of the fields in a row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import Any

import numpy as np

from uwserver.ports import Field, Value

WIDEST = 4096
"""Most whole numbers that a field in a row may have: as many as a ping has bins. A field with more is a picture rather than a reading."""
NO_INT = -(1 << 63)
"""Stands for a missing whole number, as NaN does for a missing float."""


@lru_cache(maxsize=1024)
def columns_of(fields: tuple[Field, ...]) -> Columns:
    """Return the columns of some fields; all sensors with these fields share them."""
    return Columns(fields)


class Columns:
    """The places of the fields of a port in a row of float64.

    Each component of a float, a truth value (0 or 1) or a whole number (as the 64 bits of an int64) has a place, in the order of the fields. Fields
    without a place are loose: texts, bytes, buffers, and pictures of whole numbers.

    Attributes:
        fields: fields of the port.
        width: width of a row.
        first: place of the first component of each field; -1 for loose fields.
        loose: positions of the loose fields.
        is_small: whether all loose fields are texts.
    """

    def __init__(self, fields: Sequence[Field]) -> None:
        self.fields = tuple(fields)
        first, width = [], 0
        for field in self.fields:
            fits = field.type in ("float", "bool") or (field.type == "int" and field.size <= WIDEST)
            first.append(width if fits else -1)
            width += field.size if fits else 0
        self.first, self.width = tuple(first), width
        self.loose = tuple(k for k, place in enumerate(first) if place < 0)
        self.is_small = all(self.fields[k].type == "str" for k in self.loose)
        self._kept = [(f, k, f.size) for f, k in zip(self.fields, first, strict=True)]
        self._whole = [k + i for f, k, size in self._kept if f.type == "int" and k >= 0 for i in range(size)]
        self._only_floats = not self.loose and all(field.type == "float" for field in self.fields)
        self._split = _splitter(self._kept)
        numbered = [(i, f, k, size) for i, (f, k, size) in enumerate(self._kept) if k >= 0]
        self._flags = [(i, k) for i, f, k, _ in numbered if f.type == "bool" and not f.shape]
        self._flag_rows = [(i, k, size) for i, f, k, size in numbered if f.type == "bool" and f.shape]
        self._wholes = [entry for entry in numbered if entry[1].type == "int"]

    def loose_of(self, values: Sequence[Value]) -> tuple[Value, ...]:
        """Return the values of a reading that have no place in a row."""
        return tuple([values[k] for k in self.loose])

    def pack(self, values: Sequence[Value], row: Any) -> None:
        """Write a reading into a row (width) of float64."""
        numbers: list[Any] = []
        for value, (_, k, size) in zip(values, self._kept, strict=True):
            if k < 0:
                continue
            if isinstance(value, tuple):
                numbers += value
            elif value is None:
                numbers += (None,) * size
            else:
                numbers.append(value)
        # One assignment, because each single one would cost as much as this. numpy makes NaN of None.
        row[:] = numbers
        if self._whole:
            row.view(np.int64)[self._whole] = [NO_INT if numbers[k] is None else numbers[k] for k in self._whole]

    def unpack(self, row: Any, loose: Sequence[Value] = ()) -> tuple[Value, ...]:
        """Return the reading in a row. `loose` are the values without a place there, in their order."""
        return self.values(row.tolist(), row.view(np.int64), 0, loose)

    def values(self, numbers: list[Any], whole: Any, first: int, loose: Sequence[Value] = ()) -> tuple[Value, ...]:
        """Return the reading of the numbers of a row. Whole numbers are read from `whole`, an int64 array in which the row begins at `first`."""
        # The sum is NaN if a number is NaN. It may also overflow to NaN, but then the list is only copied.
        if (total := sum(numbers)) != total:
            numbers = [None if number != number else number for number in numbers]
        values: tuple[Any, ...] = self._split(tuple(numbers))
        if self._only_floats:
            return values
        mixed = list(values)
        for i, k in self._flags:
            number = numbers[k]
            mixed[i] = None if number is None else number != 0.0
        for i, k, size in self._flag_rows:
            mixed[i] = tuple([None if n is None else n != 0.0 for n in numbers[k : k + size]])
        for i, field, k, size in self._wholes:
            at = first + k
            if field.shape:
                mixed[i] = tuple([None if n == NO_INT else n for n in whole[at : at + size].tolist()])
            else:
                n = whole.item(at)
                mixed[i] = None if n == NO_INT else n
        for i, value in zip(self.loose, loose, strict=True):
            mixed[i] = value
        return tuple(mixed)


def _splitter(kept: Sequence[tuple[Field, int, int]]) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
    """Return a function that splits the numbers of a row into those of each field; a loose field gets ()."""
    places = [slice(k, k + size) if field.shape or k < 0 else k for field, k, size in kept]
    if len(places) > 1:
        return itemgetter(*places)
    return lambda numbers: tuple([numbers[place] for place in places])
