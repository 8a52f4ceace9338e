"""One measured figure with its repeats, its bar and its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

Verdict = Literal["ok", "miss", "info", "absent"]


@dataclass(frozen=True)
class Row:
    """A figure of the report.

    Attributes:
        group: "physics", "server" or "start".
        name: what was measured.
        unit: of the values.
        values: one for each repeat, in their order; empty if the figure could not be measured.
        at_least, at_most: the bar: least or largest allowed median; both are None for information only.
        note: why it could not be measured, or a condition of the value.
    """

    group: str
    name: str
    unit: str
    values: tuple[float, ...]
    at_least: float | None = None
    at_most: float | None = None
    note: str = ""

    @property
    def value(self) -> float | None:
        """The median of the repeats."""
        return median(self.values) if self.values else None

    @property
    def verdict(self) -> Verdict:
        """The verdict: whether the median meets the bar."""
        value = self.value
        if value is None:
            return "absent"
        if self.at_least is None and self.at_most is None:
            return "info"
        low = self.at_least is None or value >= self.at_least
        high = self.at_most is None or value <= self.at_most
        return "ok" if low and high else "miss"


def quantile(values: Sequence[float], part: float) -> float:
    """Return the smallest value that at least the part `part` (0..1) of all values do not exceed. `values` must not be empty."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, -int(-part * len(ordered) // 1) - 1))]
