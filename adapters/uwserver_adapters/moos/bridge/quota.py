"""Limits of how often writers may ask, and of how often refusals are told. All clients get the refusals, so one client could flood the others."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from uwserver.adapter import AdapterStats, RateMeter
from uwserver.ports import Fault

WRITERS = 128
"""Writers that are counted apart. All others share one count, as a client can claim any name."""
SHARE = 4
"""All writers together may ask this many times as often as one."""
FAULTS_PER_S = 20
"""Most refusals of one writer that are told in a second."""

Value = float | str | bytes
Clock = Callable[[], float]


class Quota:
    """Counts the requests of each writer, and of all writers together.

    Args:
        most: requests of one writer in a second; all together may ask `SHARE` times as often.
        steady: a clock that never jumps, s.

    Attributes:
        most: as given.
    """

    def __init__(self, most: int, steady: Clock) -> None:
        self.most = most
        self._steady = steady
        self._all = RateMeter(SHARE * most)
        self._writers: dict[str, RateMeter] = {}

    def take(self, writer: str) -> bool:
        """Count one request. Returns whether it is still allowed."""
        now = self._steady()
        return self._meter(writer, now).take(now) and self._all.take(now)

    def is_first_too_many(self, writer: str) -> bool:
        """Return whether the last request of this writer was the first one in this second that was not allowed."""
        meter = self._meter(writer, self._steady())
        return meter.count == meter.most + 1 or (meter.count <= meter.most and self._all.count == self._all.most + 1)

    def _meter(self, writer: str, now: float) -> RateMeter:
        meter = self._writers.get(writer)
        if meter is None:
            if len(self._writers) >= WRITERS:  # forget those whose second is over
                self._writers = {name: other for name, other in self._writers.items() if now < other.end}
            if len(self._writers) >= WRITERS:
                writer = ""
            meter = self._writers.setdefault(writer, RateMeter(self.most))
        return meter


class Faults:
    """Tells refusals to all clients in one variable, within a limit.

    Args:
        stats: counts all refusals.
        tell: publishes the text.
        steady: a clock that never jumps, s.
    """

    def __init__(self, stats: AdapterStats, tell: Callable[[str], None], steady: Clock) -> None:
        self._stats = stats
        self._tell = tell
        self._quota = Quota(FAULTS_PER_S, steady)
        self._untold = 0

    def note(self, name: str, value: Value, writer: str, fault: Fault) -> None:
        """Tell that a write of a variable was refused."""
        self._stats.count_error(f"{name}: {fault.text}")
        if self._quota.take(writer):
            self._put(name, value, writer, fault)
        else:
            self._untold += 1

    def flush(self) -> None:
        """Tell how many refusals were not told; to be called each second."""
        untold, self._untold = self._untold, 0
        if untold:
            self._put("", "", "", Fault("overload", f"{untold} more refusals in the last second were not told"))

    def _put(self, name: str, value: Value, writer: str, fault: Fault) -> None:
        said = {"variable": name, "value": _shown(value), "src": writer}
        text = msgspec.json.encode({**said, "code": fault.code, "message": fault.text, "where": fault.where})
        self._tell(text.decode())


def _shown(value: Value) -> float | str:
    """Return the value that a refusal repeats."""
    if isinstance(value, bytes):
        return f"<binary> {len(value)} bytes"
    return value[:80] if isinstance(value, str) else value
