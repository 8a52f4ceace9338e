"""Measured figures with their bars and verdicts, and the report of a benchmark: facts of the machine, a table for people, JSON for programs."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from statistics import median
from typing import Literal

from uwserver.simulation.clock import utc_text

Verdict = Literal["ok", "miss", "info", "absent"]
FORMAT = "uwserver-bench-1"
_PACKAGES = ("uwserver", "numpy", "numba", "msgspec", "pybullet", "mujoco")


@dataclass(frozen=True)
class Row:
    """A figure of the report.

    Attributes:
        group: "physics", "server" or "start".
        name: what was measured.
        unit: unit of the values.
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


@dataclass(frozen=True)
class Report:
    """All rows of one run.

    Attributes:
        quick: whether it was made with --quick; then the values only show that everything runs.
        machine: see `machine_facts`.
    """

    quick: bool
    machine: dict[str, object]
    rows: tuple[Row, ...]

    def as_json(self) -> dict[str, object]:
        """Return plain values: all rows with their raw repeats."""
        rows = [{**asdict(row), "median": row.value, "verdict": row.verdict} for row in self.rows]
        return {"format": FORMAT, "quick": self.quick, "machine": self.machine, "rows": rows}

    def table(self) -> str:
        """Return a table with a line for each row, by groups."""
        lines = [_machine_line(self.machine)]
        if self.quick:
            lines.append("--quick: too short to judge speed by")
        width = max(len(row.name) for row in self.rows)
        for group in dict.fromkeys(row.group for row in self.rows):
            lines += ["", f"{group:{width}}  {'median':>10}  {'':10}  {'bar':>9}  verdict  (smallest .. largest)"]
            lines += [_line(row, width) for row in self.rows if row.group == group]
        missed = [f"{row.group}: {row.name}" for row in self.rows if row.verdict == "miss"]
        lines += ["", *(f"missed its bar: {name}" for name in missed)] if missed else ["", "every bar is met"]
        return "\n".join(lines)


def machine_facts() -> dict[str, object]:
    """Return processor, cores, load before the run, operating system, and the versions of what is measured."""
    load = os.getloadavg() if hasattr(os, "getloadavg") else None
    return {
        "time_utc": utc_text(),
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "load_average_1min": round(load[0], 2) if load else None,
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def _cpu_model() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _machine_line(machine: dict[str, object]) -> str:
    return (
        f"{machine['cpu']}, {machine['cores']} cores, load average {machine['load_average_1min']} before the run, "
        f"{machine['system']}, {machine['python']}"
    )


def _line(row: Row, width: int) -> str:
    value = row.value
    if value is None:
        return f"{row.name:{width}}  {row.note}"
    bar = ""
    if row.at_least is not None:
        bar = f">= {row.at_least:g}"
    elif row.at_most is not None:
        bar = f"<= {row.at_most:g}"
    verdict = "" if row.verdict == "info" else row.verdict
    spread = f"({_figures(min(row.values))} .. {_figures(max(row.values))})" if len(row.values) > 1 else ""
    note = f"  {row.note}" if row.note else ""
    return f"{row.name:{width}}  {_figures(value):>10}  {row.unit:10}  {bar:>9}  {verdict:7}  {spread}{note}".rstrip()


def _figures(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
