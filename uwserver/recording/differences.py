"""Computes the differences between the samples of one port in two recordings. Samples are paired by their times, or interpolated if these differ."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uwserver.recording.channels import Column
from uwserver.units import NANOSECONDS

PATIENCE_NS = 10 * NANOSECONDS
"""Simulation time for which a sample is kept until the other recording has a partner for it."""

Timed = tuple[int, bool, Mapping[str, Any]]
"""A sample: its time (ns), whether it is valid, and its values by field."""


@dataclass
class Distance:
    """The differences of one field.

    Attributes:
        column: the field. The distance of quaternions is the angle between them, rad; of other arrays it is the length of the difference.
        count: number of pairs of numbers.
        squares: sum of their squared distances.
        largest: largest distance.
        largest_ns: time of the largest distance; None before the first pair that differs.
        unequal: number of pairs of texts, flags, or with one missing value, that differ.
        first_ns: time of the first pair at one time that differs; None for none.
    """

    column: Column
    count: int = 0
    squares: float = 0.0
    largest: float = 0.0
    largest_ns: int | None = None
    unequal: int = 0
    first_ns: int | None = None

    @property
    def rms(self) -> float:
        """Return the root mean square of the distances; 0 without pairs."""
        return math.sqrt(self.squares / self.count) if self.count else 0.0

    @property
    def is_same(self) -> bool:
        """Return whether no pair differs."""
        return self.largest == 0.0 and self.unequal == 0

    def add(self, one: Any, other: Any, t_ns: int, exact: bool) -> None:
        """Add a pair. Texts and missing values are compared only if the pair is `exact`, that is, both samples have the same time."""
        is_numeric = not self.column.is_word and one is not None and other is not None
        distance = _distance(self.column, one, other) if is_numeric else None
        if distance is not None:
            self.count += 1
            self.squares += distance * distance
            if distance > self.largest:
                self.largest, self.largest_ns = distance, t_ns
        elif exact and (is_numeric or one != other):
            self.unequal += 1
        else:
            return
        if exact and distance != 0.0 and self.first_ns is None:
            self.first_ns = t_ns


def _distance(column: Column, one: Any, other: Any) -> float | None:
    """Return the distance of two values; None if they have different lengths, or only one has a number at some place."""
    ours, theirs = (value if column.size else [value] for value in (one, other))
    if len(ours) != len(theirs) or any((x is None) != (y is None) for x, y in zip(ours, theirs, strict=True)):
        return None
    pairs = [(x, y) for x, y in zip(ours, theirs, strict=True) if x is not None]
    if column.is_quaternion and len(pairs) == 4:
        return _angle(one, other)
    return math.hypot(*(_step(column, x, y) for x, y in pairs))


def _step(column: Column, before: float, after: float) -> float:
    """Return the difference of two numbers; of angles in the shorter direction."""
    return math.remainder(after - before, math.tau) if column.unit == "rad" else after - before


def _angle(one: Sequence[float], other: Sequence[float]) -> float:
    """Return the angle between two attitudes, rad, whatever their signs. It is exactly 0 for equal attitudes."""
    if one == other:
        return 0.0
    sign = 1.0 if sum(x * y for x, y in zip(one, other, strict=True)) >= 0.0 else -1.0
    # Computed from the chord, which stays accurate for small angles; the arc cosine of the product does not.
    half = 0.5 * math.hypot(*(x - sign * y for x, y in zip(one, other, strict=True)))
    return 4.0 * math.asin(min(1.0, half))


class Pairing:
    """Pairs the samples of one port of both recordings, and keeps no more samples than that needs.

    Attributes:
        valid: differences of the flag `valid`.
        fields: differences of the fields, by name.
        samples: numbers of samples of both sides.
        pairs: numbers of pairs: with equal times, and interpolated.
        alone: number of samples without a partner, on the side that has fewer.
        disordered: number of samples that are older than the sample before them; they are left out.
    """

    def __init__(self, columns: Sequence[Column], holds: bool, asks: int) -> None:
        """Pair the samples of a port.

        Args:
            columns: fields of the port, the same on both sides.
            holds: a value holds until the next one, as for commands; otherwise it changes linearly between samples.
            asks: the side, 0 or 1, at whose times values are compared: the one with fewer samples.
        """
        self.valid = Distance(Column("valid", "1", "boolean"))
        self.fields = {column.name: Distance(column) for column in columns}
        self.samples, self.pairs, self.alone, self.disordered = [0, 0], [0, 0], 0, 0
        self._holds, self._asks = holds, asks
        self._waiting: tuple[deque[Timed], deque[Timed]] = (deque(), deque())
        self._newest: list[int | None] = [None, None]

    def put(self, side: int, sample: Timed) -> None:
        """Add a sample of a side, in the order of its recording."""
        self.samples[side] += 1
        newest, waiting = self._newest[side], self._waiting[side]
        if newest is not None and sample[0] <= newest:
            if self._holds and sample[0] == newest and waiting:
                waiting[-1] = sample  # of several commands at one time the last acts
            else:
                self.disordered += 1
            return
        self._newest[side] = sample[0]
        waiting.append(sample)

    def pair(self, reached: Sequence[float]) -> None:
        """Pair all samples that can be paired. `reached` is the time up to which each side was read, ns; infinite at its end."""
        asking, other = self._waiting[self._asks], self._waiting[1 - self._asks]
        limit, patience = reached[1 - self._asks], PATIENCE_NS
        # At the time reached another command may still come, and replace one that acts then.
        while asking and (not self._holds or asking[0][0] < reached[self._asks]):
            t = asking[0][0]
            while len(other) > 1 and other[1][0] <= t:
                other.popleft()
            if other and other[0][0] == t and (not self._holds or limit > t):
                self._pair(asking.popleft(), other[0], exact=True)
            elif other and other[0][0] > t:
                asking.popleft()
                self.alone += 1
            elif other and self._holds and (len(other) > 1 or limit > t):
                self._pair(asking.popleft(), other[0], exact=False)
            elif len(other) > 1 and not self._holds:
                now = asking.popleft()
                self._pair(now, _between(other[0], other[1], now, self.fields), exact=False)
            elif limit > t + patience:
                asking.popleft()
                self.alone += 1
            else:
                break
        while not asking and len(other) > 1 and other[1][0] < reached[self._asks] - patience:
            other.popleft()

    def _pair(self, asking: Timed, other: Timed, exact: bool) -> None:
        self.pairs[0 if exact else 1] += 1
        one, two = (other, asking) if self._asks else (asking, other)
        t_ns = asking[0]
        if exact:
            self.valid.add(one[1], two[1], t_ns, exact=True)
        for name, distance in self.fields.items():
            distance.add(one[2].get(name), two[2].get(name), t_ns, exact)


def _between(before: Timed, after: Timed, now: Timed, fields: Mapping[str, Distance]) -> Timed:
    """Interpolate between two samples: linearly, or along the shorter arc."""
    part = (now[0] - before[0]) / (after[0] - before[0])
    values = {
        name: _mixed(distance.column, before[2].get(name), after[2].get(name), part)
        for name, distance in fields.items()
    }
    return now[0], before[1] and after[1], values


def _mixed(column: Column, one: Any, other: Any, part: float) -> Any:
    if column.is_word or one is None or other is None:
        return None
    if column.type == "integer":
        return one
    if not column.size:
        return one + part * _step(column, one, other)
    if len(one) != len(other):
        return None
    if column.is_quaternion and None not in one and None not in other:
        return _slerp(one, other, part)
    pairs = zip(one, other, strict=True)
    return [None if x is None or y is None else x + part * _step(column, x, y) for x, y in pairs]


def _slerp(one: Sequence[float], other: Sequence[float], part: float) -> list[float]:
    dot = sum(x * y for x, y in zip(one, other, strict=True))
    sign, angle = math.copysign(1.0, dot), math.acos(min(1.0, abs(dot)))
    if angle < 1e-6:
        a, b = 1.0 - part, part
    else:
        a, b = (math.sin(s * angle) / math.sin(angle) for s in (1.0 - part, part))
    mixed = [a * x + sign * b * y for x, y in zip(one, other, strict=True)]
    length = math.hypot(*mixed) or 1.0
    return [x / length for x in mixed]
