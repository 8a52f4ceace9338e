"""How far the samples of one port in two recordings are apart, as they come: paired by their times, or interpolated where these differ."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uwserver.recording.channels import Column
from uwserver.units import NANOSECONDS

PATIENCE_NS = 10 * NANOSECONDS
"""Simulation time by which the other recording may be behind before a sample has no partner: samples are kept no longer."""

Told = tuple[int, bool, Mapping[str, Any]]
"""A sample: its time (ns), whether it is valid, its values by field."""


@dataclass
class Distance:
    """How far one field is apart.

    Attributes:
        column: the field; of a quaternion the distance is the angle between both, rad; of other arrays the length of the difference.
        count: of pairs of numbers.
        squares: sum of their squared distances.
        largest: of the distances.
        largest_ns: when; None before the first pair that is apart.
        unequal: pairs of words, of flags or of which one has no value, that are not the same.
        first_ns: the first pair at one time that is not the same; None for none.
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
        """Root mean square of the distances; 0 without any."""
        return math.sqrt(self.squares / self.count) if self.count else 0.0

    @property
    def is_same(self) -> bool:
        """Whether no pair differs in anything."""
        return self.largest == 0.0 and self.unequal == 0

    def add(self, one: Any, other: Any, t_ns: int, exact: bool) -> None:
        """Take a pair in; words and missing values only where both are `exact`, of one time."""
        if self.column.is_word or one is None or other is None:
            if exact and one != other:
                self._unlike(t_ns)
            return
        distance = _distance(self.column, one, other)
        if distance is None:
            if exact:
                self._unlike(t_ns)
            return
        self.count += 1
        self.squares += distance * distance
        if distance > self.largest:
            self.largest, self.largest_ns = distance, t_ns
        if exact and distance and self.first_ns is None:
            self.first_ns = t_ns

    def _unlike(self, t_ns: int) -> None:
        self.unequal += 1
        if self.first_ns is None:
            self.first_ns = t_ns


def _distance(column: Column, one: Any, other: Any) -> float | None:
    """None where values are missing in one of them alone, or their numbers differ."""
    if not column.size:
        difference = one - other
        return abs(math.remainder(difference, math.tau)) if column.unit == "rad" else abs(difference)
    if len(one) != len(other) or any((x is None) != (y is None) for x, y in zip(one, other, strict=True)):
        return None
    pairs = [(x, y) for x, y in zip(one, other, strict=True) if x is not None]
    if column.is_quaternion and len(pairs) == 4:
        return _angle(one, other)
    if column.unit == "rad":
        return math.hypot(*(math.remainder(x - y, math.tau) for x, y in pairs))
    return math.hypot(*(x - y for x, y in pairs))


def _angle(one: Sequence[float], other: Sequence[float]) -> float:
    """Between two attitudes, rad: of the rotation from one to the other, whatever their signs. Exactly 0 for equal ones."""
    if one == other:
        return 0.0
    sign = 1.0 if sum(x * y for x, y in zip(one, other, strict=True)) >= 0.0 else -1.0
    # By the chord, which keeps its digits where the angle is small.
    half = 0.5 * math.hypot(*(x - sign * y for x, y in zip(one, other, strict=True)))
    return 4.0 * math.asin(min(1.0, half))


class Pairing:
    """The samples of one port on both sides, of which as few are kept as pairing needs.

    Attributes:
        valid: whether both say that they are valid.
        fields: of the port, by name.
        samples: on either side.
        pairs: at one time, and interpolated.
        alone: samples without a partner, of the side that has fewer.
        disordered: samples that were true before the one that was told before them; they are left out.
    """

    def __init__(self, columns: Sequence[Column], holds: bool, asks: int) -> None:
        """Of a port.

        Args:
            columns: of both sides.
            holds: values stand until the next ones, as commands do; else they change evenly between two.
            asks: the side, 0 or 1, whose times count: that with fewer samples.
        """
        self.valid = Distance(Column("valid", "1", "boolean"))
        self.fields = {column.name: Distance(column) for column in columns}
        self.samples, self.pairs, self.alone, self.disordered = [0, 0], [0, 0], 0, 0
        self._holds, self._asks = holds, asks
        self._waiting: tuple[deque[Told], deque[Told]] = (deque(), deque())
        self._newest: list[int | None] = [None, None]

    def put(self, side: int, told: Told) -> None:
        """Take in a sample of a side; each side's in their order."""
        self.samples[side] += 1
        newest, waiting = self._newest[side], self._waiting[side]
        if newest is not None and told[0] <= newest:
            if self._holds and told[0] == newest and waiting:
                waiting[-1] = told  # of several commands at one time the last acts
            else:
                self.disordered += 1
            return
        self._newest[side] = told[0]
        waiting.append(told)

    def settle(self, reached: Sequence[float]) -> None:
        """Pair what can be paired; `reached`: time up to which either side is read, ns; infinite at its end."""
        asking, other = self._waiting[self._asks], self._waiting[1 - self._asks]
        limit, patience = reached[1 - self._asks], PATIENCE_NS
        # A command that acts at the time reached may still be replaced by another one.
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

    def _pair(self, asking: Told, other: Told, exact: bool) -> None:
        self.pairs[0 if exact else 1] += 1
        one, two = (other, asking) if self._asks else (asking, other)
        t_ns = asking[0]
        if exact:
            self.valid.add(one[1], two[1], t_ns, exact=True)
        for name, distance in self.fields.items():
            distance.add(one[2].get(name), two[2].get(name), t_ns, exact)


def _between(before: Told, after: Told, now: Told, fields: Mapping[str, Distance]) -> Told:
    """What it was at a time between two samples: along the line, or the shorter arc."""
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
        return _number(column, one, other, part)
    if len(one) != len(other):
        return None
    if column.is_quaternion and None not in one and None not in other:
        return _slerp(one, other, part)
    return [None if x is None or y is None else _number(column, x, y, part) for x, y in zip(one, other, strict=True)]


def _number(column: Column, one: float, other: float, part: float) -> float:
    step = math.remainder(other - one, math.tau) if column.unit == "rad" else other - one
    return one + part * step


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
