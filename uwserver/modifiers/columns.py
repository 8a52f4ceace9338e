"""Readings as plain numbers, on which compiled code works: which numbers of a row are those of which field."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import Any

import numpy as np

from uwserver.ports import Field, Value

WIDEST = 4096
"""Whole numbers of a field that still stand among the others, as many as a ping has bins; more are a picture rather than a reading."""
NO_INT = -(1 << 63)
"""Stands for a missing whole number, as NaN does for a missing float."""


@lru_cache(maxsize=1024)
def columns_of(fields: tuple[Field, ...]) -> Columns:
    """Those of some fields, the same for all sensors that have them."""
    return Columns(fields)


class Columns:
    """Where the fields of a port stand in a row of float64: each component of floats, truths (0 or 1) and whole numbers (as the 64 bits of an
    int64) has a place, in the order of the fields. What has none is loose: texts, bytes, buffers and pictures of whole numbers.

    Attributes:
        fields: of the port.
        width: of a row.
        first: of each field, the place of its first component; -1 of those that are loose.
        loose: positions of the fields that have no place.
        is_small: these hold texts alone.
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
        """Those of a reading that have no place in a row."""
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
        # At once, as each number by itself would cost as much as all; numpy makes NaN of None.
        row[:] = numbers
        if self._whole:
            row.view(np.int64)[self._whole] = [NO_INT if numbers[k] is None else numbers[k] for k in self._whole]

    def unpack(self, row: Any, loose: Sequence[Value] = ()) -> tuple[Value, ...]:
        """The reading of a row; `loose`: the values that have no place there, in their order."""
        return self.values(row.tolist(), row.view(np.int64), 0, loose)

    def values(self, numbers: list[Any], whole: Any, first: int, loose: Sequence[Value] = ()) -> tuple[Value, ...]:
        """The same of its numbers; those that are whole stand in an array of int64 `whole`, in which the row begins at `first`."""
        if (total := sum(numbers)) != total:  # one is NaN; or they are too large, and no harm is done
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
    """From the numbers of a row to those of each field; nothing for a loose one."""
    places = [slice(k, k + size) if field.shape or k < 0 else k for field, k, size in kept]
    if len(places) > 1:
        return itemgetter(*places)
    return lambda numbers: tuple([numbers[place] for place in places])
