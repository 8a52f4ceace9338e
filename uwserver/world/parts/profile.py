"""Measures where the time of ticks goes, by stage and kind. The caller brings a clock, as a world knows no wall time.

Functions that are called in a tick are wrapped by a `Timer` when members are added or removed. The timer `untimed` returns the function
itself, so that a world without a profile pays nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, ParamSpec, Protocol, TypeVar

from uwserver.ports import Json
from uwserver.units import NANOSECONDS

P = ParamSpec("P")
R = TypeVar("R")

STAGES = (
    "faults", "requests", "watchdogs", "autopilots", "forces", "physics", "contact", "water", "sensors", "delivery", "samples", "listening",
    "recording", "publishing", "tick",
)  # fmt: skip
"""The order in which stages are reported, which is that of a tick. ``tick`` is the time that is left of it: the calls themselves, and the
measuring."""


class Timer(Protocol):
    """Wraps a function so that its time is measured."""

    def __call__(self, stage: str, what: str, function: Callable[P, R], readings: int = 0) -> Callable[P, R]:
        """Return the wrapped function. `stage` is one of `STAGES`, `what` the kind of component, and `readings` how many readings of
        sensors one call makes."""


def untimed(stage: str, what: str, function: Callable[P, R], readings: int = 0) -> Callable[P, R]:
    """Return the function itself: the timer of a world without a profile."""
    return function


def kind_of(thing: object) -> str:
    """Return the name of a component's kind in a profile: the name of its module."""
    return type(thing).__module__.rpartition(".")[2]


class Line(NamedTuple):
    """The time of one stage or kind, without functions called within it that have a line of their own.

    Attributes:
        stage, what: as for `Timer`.
        calls, readings: how many.
        mean_us: microseconds per tick, over all ticks.
        worst_us: in the worst tick.
    """

    stage: str
    what: str
    calls: int
    readings: int
    mean_us: float
    worst_us: float


@dataclass(frozen=True)
class Report:
    """Where the time went.

    Attributes:
        seconds: measured wall time.
        ticks: ticks that began in it.
        mean_us, worst_us: time of a whole tick.
        lines: in the order of `STAGES`, and the largest first.
    """

    seconds: float
    ticks: int
    mean_us: float
    worst_us: float
    lines: tuple[Line, ...]

    def as_json(self) -> dict[str, Json]:
        """Return the answer of ``world/profile``."""
        lines: list[Json] = [
            {**line._asdict(), "mean_us": round(line.mean_us, 3), "worst_us": round(line.worst_us, 3)}
            for line in self.lines
        ]
        return {
            "seconds": round(self.seconds, 6),
            "ticks": self.ticks,
            "mean_us": round(self.mean_us, 3),
            "worst_us": round(self.worst_us, 3),
            "lines": lines,
        }

    def table(self) -> str:
        """Return a table for people."""
        if not self.ticks:
            return f"profile: no tick in {self.seconds:.1f} s"
        busy = 100.0 * self.mean_us * self.ticks / (1e6 * self.seconds) if self.seconds > 0.0 else 0.0
        title = (
            f"profile of {self.ticks} ticks in {self.seconds:.1f} s: a tick takes {self.mean_us:.1f} us, the worst "
            f"{self.worst_us:.0f} us; {busy:.0f} % of the time"
        )
        each = f"{'us each':>9}"
        rows = [title, f"{'':32}{'us a tick':>10}{'%':>6}{'worst':>9}{'calls':>10}{each}{'readings':>10}{each}"]
        stage = ""
        for line in self.lines:
            title, stage = "" if line.stage == stage else line.stage, line.stage
            total = line.mean_us * self.ticks
            share = 100.0 * line.mean_us / self.mean_us if self.mean_us else 0.0
            of_readings = f"{line.readings:10}{total / line.readings:9.2f}" if line.readings else ""
            rows.append(
                f"{title:12}{line.what:20}{line.mean_us:10.2f}{share:6.1f}{line.worst_us:9.1f}"
                f"{line.calls:10}{total / line.calls:9.2f}{of_readings}"
            )
        return "\n".join(rows)


_Key = tuple[str, str]
"""A stage and a kind."""
_TICK: _Key = ("tick", "the rest")


@dataclass(slots=True)
class _Sum:
    """The counts of one stage and kind, in a tick or over all ticks of a window."""

    calls: int = 0
    readings: int = 0
    ns: int = 0
    worst_ns: int = 0

    def add(self, calls: int, readings: int, ns: int) -> None:
        """Add the counts of a call, or of a tick."""
        self.calls += calls
        self.readings += readings
        self.ns += ns
        self.worst_ns = max(self.worst_ns, ns)


@dataclass(eq=False)
class Window:
    """A span of time over which is measured. Only `Profile` uses its values."""

    since_ns: int
    whole: _Sum = field(default_factory=_Sum)
    sums: defaultdict[_Key, _Sum] = field(default_factory=lambda: defaultdict(_Sum))


class Profile:
    """Measures ticks, for one or more windows at a time. It is used on the thread that steps the world, between ticks.

    Args:
        now_ns: gives the time of a clock, ns.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._tick_sums: defaultdict[_Key, _Sum] = defaultdict(_Sum)
        self._windows: list[Window] = []
        self._inner_ns = self._began_ns = 0

    @property
    def is_needed(self) -> bool:
        """Whether a window is open."""
        return bool(self._windows)

    def open(self) -> Window:
        """Begin to measure with the next tick."""
        self._add_tick()
        window = Window(self._now_ns())
        self._windows.append(window)
        return window

    def report(self, window: Window) -> Report:
        """Return what was measured in a window so far."""
        self._add_tick()
        return _report(window, self._now_ns())

    def close(self, window: Window) -> Report:
        """Return what was measured in a window, and end it."""
        report = self.report(window)
        self._windows.remove(window)
        return report

    def timed(self, stage: str, what: str, function: Callable[P, R], readings: int = 0) -> Callable[P, R]:
        """Wrap a function, as `Timer`. The time of a timed function that runs within another one counts only for the inner one."""
        key, now_ns = (stage, what), self._now_ns

        def run(*args: P.args, **kwargs: P.kwargs) -> R:
            outer_ns, self._inner_ns = self._inner_ns, 0
            began_ns = now_ns()
            try:
                return function(*args, **kwargs)
            finally:
                whole_ns = now_ns() - began_ns
                self._tick_sums[key].add(1, readings, whole_ns - self._inner_ns)
                self._inner_ns = outer_ns + whole_ns

        return run

    def unit(
        self, function: Callable[..., int], *args: object, name: Callable[[int], tuple[str, str, int] | None]
    ) -> int:
        """Call a function whose result says what it did. `name` makes stage, kind and readings of the result, or None if the time has no
        line of its own. Returns the result."""
        began_ns = self._now_ns()
        result = function(*args)
        named = name(result)
        if named is not None:
            stage, what, readings = named
            took_ns = self._now_ns() - began_ns
            self._tick_sums[stage, what].add(1, readings, took_ns)
            self._inner_ns += took_ns
        return result

    def begin(self) -> None:
        """Begin a tick. What was done since the last tick ended, such as handing its samples on, counts for that tick."""
        self._add_tick()
        self._inner_ns = 0
        self._began_ns = self._now_ns()

    def end(self) -> None:
        """End a tick."""
        self._tick_sums[_TICK].add(1, 0, self._now_ns() - self._began_ns - self._inner_ns)

    def _add_tick(self) -> None:
        """Add what was measured since the last tick began to the windows."""
        whole_ns = sum([each.ns for each in self._tick_sums.values()])
        ticks = self._tick_sums.get(_TICK, _Sum()).calls  # no tick may have ended since
        for window in self._windows:
            window.whole.add(ticks, 0, whole_ns)
            for key, each in self._tick_sums.items():
                window.sums[key].add(each.calls, each.readings, each.ns)
        self._tick_sums.clear()


def _report(window: Window, now_ns: int) -> Report:
    ticks = window.whole.calls

    def mean_us(total: _Sum) -> float:
        return total.ns * 1e-3 / max(1, ticks)

    lines = [
        Line(stage, what, total.calls, total.readings, mean_us(total), total.worst_ns * 1e-3)
        for (stage, what), total in window.sums.items()
    ]
    lines.sort(key=lambda line: (STAGES.index(line.stage), -line.mean_us))
    seconds = (now_ns - window.since_ns) / NANOSECONDS
    return Report(seconds, ticks, mean_us(window.whole), window.whole.worst_ns * 1e-3, tuple(lines))
