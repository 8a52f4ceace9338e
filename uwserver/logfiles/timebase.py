"""One time base from the stamps of a log, whatever its clock did."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwserver.units import NANOSECONDS

Times = NDArray[np.int64]

LATE_NS = 2 * NANOSECONDS
"""Entries may be written later than others by so much: they are sorted. What falls further back is a clock that was set back."""
AHEAD_NS = 86_400 * NANOSECONDS
"""A day without an entry is a clock that was set ahead; a shorter pause is a gap."""
_STAYS = 16
"""A clock was set when as many entries in a row agree with each other; fewer, between others of the old time, have damaged stamps."""
_FIRST_UTC_NS = 946_684_800 * NANOSECONDS
"""2000-01-01. A clock that shows less was never set."""
_LAST_NS = 1 << 62
_TOLD = 8


class Timebase(NamedTuple):
    """The times of the entries of a log, in the order in which they stand in it.

    Attributes:
        t_ns: (n,) ns since the first entry, free of what happened to the clock.
        order: (n,) indices that sort `t_ns`; entries of one time keep their order.
        epoch_ns: UTC of time 0, when the stamps are UTC and the clock was set; else None.
        remarks: what happened to the clock.
    """

    t_ns: Times
    order: NDArray[np.intp]
    epoch_ns: int | None
    remarks: tuple[str, ...]


def time_base(stamps: Times, utc: bool) -> Timebase:
    """The time base of entries with these stamps.

    Args:
        stamps: (n,) ns of the log's clock, in the order of the file.
        utc: whether that clock tells UTC when it is set.
    """
    if not len(stamps):
        return Timebase(np.zeros(0, np.int64), np.zeros(0, np.intp), None, ())
    stamps = np.clip(stamps, -_LAST_NS, _LAST_NS)
    first = int(stamps[0])
    steps = np.diff(stamps)
    remarks: list[str] = []
    if len(steps) and (steps.min() < -LATE_NS or steps.max() > AHEAD_NS):
        t_ns, remarks = _set_clocks(stamps.tolist())
    else:
        t_ns = stamps - first
    # An entry that was written late may be older than the first one.
    t_ns = t_ns - t_ns.min()
    epoch = None
    if utc:
        valid = np.flatnonzero(stamps >= _FIRST_UTC_NS)
        if len(valid):
            epoch = int(stamps[valid[0]] - t_ns[valid[0]])
            if valid[0]:
                told = seconds(int(t_ns[valid[0]]))
                remarks.append(
                    f"the clock was not set before {told}; the UTC of what came before is reckoned back from there"
                )
    return Timebase(t_ns, np.argsort(t_ns, kind="stable"), epoch, tuple(remarks))


def log_times(stamps: Times) -> Timebase:
    """The time base of a log that is read in the order of its stamps, wherever the entries stand: as MCAP files are."""
    stamps = np.clip(stamps, 0, _LAST_NS)
    first = int(stamps.min()) if len(stamps) else 0
    t_ns = stamps - first
    epoch = first if first >= _FIRST_UTC_NS else None
    return Timebase(t_ns, np.argsort(t_ns, kind="stable"), epoch, ())


def _set_clocks(stamps: Sequence[int]) -> tuple[Times, list[str]]:
    """Times since the first stamp, where a clock that was set goes on from the time before."""
    t_ns = np.zeros(len(stamps), np.int64)
    offset, newest = -stamps[0], stamps[0]
    run: list[int] = []  # entries in a row that fit each other, but not those before
    top = 0
    damaged: list[int] = []
    sets: list[str] = []
    for k, stamp in enumerate(stamps):
        if -LATE_NS <= stamp - newest <= AHEAD_NS:
            damaged += run
            t_ns[run] = newest + offset
            run = []
            newest = max(newest, stamp)
            t_ns[k] = stamp + offset
            continue
        if run and not -LATE_NS <= stamp - top <= AHEAD_NS:
            damaged += run
            t_ns[run] = newest + offset
            run = []
        top = max(top, stamp) if run else stamp
        run.append(k)
        if len(run) == _STAYS or k == len(stamps) - 1:
            here, start = newest + offset, min(stamps[j] for j in run)
            way = "back" if start < newest else "ahead"
            sets.append(f"the clock was set {way} by {seconds(abs(start - newest))} at {seconds(here)}")
            offset, newest = here - start, top
            t_ns[run] = np.array([stamps[j] for j in run], np.int64) + offset
            run = []
    remarks = shortened(sets)
    if sets:
        remarks.append("where the clock was set, times go on from the last one before: how long it took is not known")
    if damaged:
        at = seconds(int(t_ns[damaged[0]]))
        remarks.append(
            f"{len(damaged)} entries have stamps that do not fit those around them, the first at {at}; they stand beside these"
        )
    return t_ns, remarks


def gaps(name: str, t_ns: Times) -> list[str]:
    """Where a topic with sorted times that comes regularly fell silent: ten times its usual period, and more than 2 s."""
    if len(t_ns) < 10:
        return []
    periods = np.diff(t_ns)
    usual = int(np.median(periods))
    if np.quantile(periods, 0.9) > 3 * usual:
        return []
    silent = np.flatnonzero(periods > max(10 * usual, LATE_NS))
    if not len(silent):
        return []
    worst = silent[np.argmax(periods[silent])]
    more = f", and {len(silent) - 1} shorter gaps" if len(silent) > 1 else ""
    return [f"{name}: nothing for {seconds(int(periods[worst]))} from {seconds(int(t_ns[worst]))}{more}"]


def shortened(remarks: Sequence[str]) -> list[str]:
    """The first remarks of many, and how many more there are."""
    more = len(remarks) - _TOLD
    return [*remarks[:_TOLD], f"and {more} more of these"] if more > 0 else list(remarks)


def seconds(t_ns: int) -> str:
    """A time or duration for people: seconds to the millisecond, or days when it is long."""
    if abs(t_ns) >= 10 * AHEAD_NS:
        return f"{t_ns / AHEAD_NS:.1f} days"
    return f"{t_ns / NANOSECONDS:.3f} s"


def utc_text(utc_ns: int) -> str:
    """RFC 3339 to the millisecond; the bare number where no calendar reaches."""
    try:
        moment = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(microseconds=utc_ns // 1000)
    except OverflowError:
        return f"{utc_ns} ns since 1970"
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def utc_ns(text: str) -> int | None:
    """ns since 1970 of an RFC 3339 instant; None when it is none."""
    try:
        moment: Any = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=timezone.utc)
    passed = moment - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return int(passed.days * 86_400 + passed.seconds) * NANOSECONDS + int(passed.microseconds) * 1000
