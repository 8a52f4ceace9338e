"""Collects the values of both versions, which are measured in pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from uwserver_bench.against.figures import Figure
from uwserver_bench.processes import BenchFailed

Say = Callable[[str], None]
SIDES = ("ours", "theirs")


class Kind(NamedTuple):
    """Group, name and unit of a figure; see `Figure`."""

    group: str
    name: str
    unit: str
    bar: float | None = None


class Unable(Exception):
    """One version cannot do this; the text is its error."""


class Pairs:
    """Collects the values of all figures. A figure that the other version cannot do is left out from then on.

    Args:
        only: only figures whose group and name contain this text are measured.
    """

    def __init__(self, only: str = "") -> None:
        self._only = only.lower()
        self._values: dict[Kind, dict[str, list[float]]] = {}
        self._unable: dict[Kind, str] = {}

    def wanted(self, kind: Kind) -> bool:
        """Return whether a figure is to be measured."""
        return self._only in f"{kind.group}: {kind.name}".lower() and kind not in self._unable

    def left_out(self, kind: Kind) -> bool:
        """Return whether a figure was left out because it cannot be measured."""
        return kind in self._unable

    def add(self, kind: Kind, side: str, value: float) -> None:
        """Add a value of one side. The k-th values of both sides are a pair."""
        self._values.setdefault(kind, {name: [] for name in SIDES})[side].append(value)

    def measure(self, kind: Kind, turns: Sequence[str], cost: Callable[[str], float]) -> None:
        """Measure a pair: the cost of each turn. A side may have several turns; the value is their mean.

        Raises:
            BenchFailed: our version cannot do it.
        """
        if not self.wanted(kind):
            return
        found: dict[str, list[float]] = {name: [] for name in SIDES}
        for side in turns:
            try:
                found[side].append(cost(side))
            except Unable as error:
                if side == "ours":
                    raise BenchFailed(f"{kind.name}: {error}") from error
                self.leave_out(kind, f"their version: {error}")
                return
        for side, values in found.items():
            self.add(kind, side, sum(values) / len(values))

    def leave_out(self, kind: Kind, why: str) -> None:
        """Leave a figure out from now on, and give the reason in the report."""
        self._unable[kind] = why
        self._values[kind] = {name: [] for name in SIDES}

    def figures(self, order: Mapping[str, int]) -> Iterator[Figure]:
        """Return all figures, by group."""
        for kind in sorted(self._values, key=lambda kind: order[kind.group]):
            ours, theirs = (tuple(self._values[kind][side]) for side in SIDES)
            yield Figure(kind.group, kind.name, kind.unit, ours, theirs, kind.bar, self._unable.get(kind, ""))


def in_turns(pair: int) -> tuple[str, ...]:
    """Return the turns of a pair: ours, theirs, theirs, ours; in the next pair the reverse. So a drift of the machine affects both sides alike."""
    first, second = SIDES if pair % 2 == 0 else SIDES[::-1]
    return (first, second, second, first)
