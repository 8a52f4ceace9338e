"""Makes one time base that never runs backwards from the time stamps of a log."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwserver.units import NANOSECONDS

Times = NDArray[np.int64]

LATE_NS = 2 * NANOSECONDS
"""Entries that are late by up to this are sorted into place. A larger step back means that the clock was set back."""
AHEAD_NS = 86_400 * NANOSECONDS
"""A step of more than a day means that the clock was set ahead; a shorter step is a gap."""
_STAYS = 16
"""The clock was set when this many entries in a row agree with each other. Fewer, between entries of the old time, have damaged stamps."""
FIRST_UTC_NS = 946_684_800 * NANOSECONDS
"""2000-01-01. A clock that shows an earlier time was never set."""
LAST_NS = 1 << 62
"""Largest time that is kept, 146 years; larger ones are clipped so that sums stay within 64 bits."""
_MOST_REMARKS = 8


class Timebase(NamedTuple):
    """The times of the entries of a log, in the order of the file.

    Attributes:
        t_ns: (n,) ns since the first entry, with steps of the clock removed.
        order: (n,) indices that sort `t_ns`; entries with equal times keep their order.
        epoch_ns: UTC of time 0, if the stamps are UTC and the clock was set; else None.
        remarks: sentences about steps of the clock and damaged stamps.
    """

    t_ns: Times
    order: NDArray[np.intp]
    epoch_ns: int | None
    remarks: tuple[str, ...]


def time_base(stamps: Times, utc: bool) -> Timebase:
    """Return the time base of entries with these stamps.

    Args:
        stamps: (n,) ns of the log's clock, in the order of the file.
        utc: whether that clock shows UTC once it is set.
    """
    if not len(stamps):
        return Timebase(np.zeros(0, np.int64), np.zeros(0, np.intp), None, ())
    stamps = np.clip(stamps, -LAST_NS, LAST_NS)
    steps = np.diff(stamps)
    remarks: list[str] = []
    if len(steps) and (steps.min() < -LATE_NS or steps.max() > AHEAD_NS):
        t_ns, remarks = _set_clocks(stamps.tolist())
    else:
        t_ns = stamps - stamps[0]
    # An entry that was written late may be older than the first one.
    t_ns = t_ns - t_ns.min()
    epoch = None
    valid = np.flatnonzero(stamps >= FIRST_UTC_NS)
    if utc and len(valid):
        epoch = int(stamps[valid[0]] - t_ns[valid[0]])
        if valid[0]:
            set_at = seconds(int(t_ns[valid[0]]))
            remarks.append(
                f"the clock was not set before {set_at}; the UTC of earlier entries is computed back from there"
            )
    return Timebase(t_ns, np.argsort(t_ns, kind="stable"), epoch, tuple(remarks))


def log_times(stamps: Times) -> Timebase:
    """Return the time base of a log that is read in the order of its stamps, not in the order of the file; MCAP files are read so."""
    stamps = np.clip(stamps, 0, LAST_NS)
    first = int(stamps.min()) if len(stamps) else 0
    t_ns = stamps - first
    epoch = first if first >= FIRST_UTC_NS else None
    return Timebase(t_ns, np.argsort(t_ns, kind="stable"), epoch, ())


def _set_clocks(stamps: Sequence[int]) -> tuple[Times, list[str]]:
    """Return the times since the first stamp, and remarks. Where the clock was set, times continue from the newest time before.

    Entries that do not fit the time before them wait in `run`. They become the new time when `_STAYS` of them agree with each other, or
    when the log ends; they count as damaged when the old time continues, or when they contradict each other.
    """
    t_ns = np.zeros(len(stamps), np.int64)
    offset, newest = -stamps[0], stamps[0]
    run: list[int] = []
    top = 0  # newest stamp of the run
    damaged: list[int] = []
    sets: list[str] = []
    for k, stamp in enumerate(stamps):
        fits = -LATE_NS <= stamp - newest <= AHEAD_NS
        if run and (fits or not -LATE_NS <= stamp - top <= AHEAD_NS):
            damaged += run
            t_ns[run] = newest + offset
            run = []
        if fits:
            newest = max(newest, stamp)
            t_ns[k] = stamp + offset
            continue
        top = max(top, stamp) if run else stamp
        run.append(k)
        if len(run) == _STAYS or k == len(stamps) - 1:
            here, start = newest + offset, min(stamps[j] for j in run)
            direction = "back" if start < newest else "ahead"
            sets.append(f"the clock was set {direction} by {seconds(abs(start - newest))} at {seconds(here)}")
            offset, newest = here - start, top
            t_ns[run] = np.array([stamps[j] for j in run], np.int64) + offset
            run = []
    remarks = shortened(sets)
    if sets:
        remarks.append(
            "where the clock was set, times continue from the last time before: the true duration is unknown"
        )
    if damaged:
        at = seconds(int(t_ns[damaged[0]]))
        remarks.append(
            f"{len(damaged)} entries have stamps that contradict their neighbours, the first at {at}; they got the times of these"
        )
    return t_ns, remarks


def gaps(name: str, t_ns: Times) -> list[str]:
    """Return a remark where a regular topic with sorted times fell silent: for ten times its usual period, and more than 2 s."""
    if len(t_ns) < 10:
        return []
    periods = np.diff(t_ns)
    usual = int(np.median(periods))
    silent = np.flatnonzero(periods > max(10 * usual, LATE_NS))
    if np.quantile(periods, 0.9) > 3 * usual or not len(silent):
        return []
    worst = silent[np.argmax(periods[silent])]
    more = f", and {len(silent) - 1} shorter gaps" if len(silent) > 1 else ""
    return [f"{name}: no data for {seconds(int(periods[worst]))} from {seconds(int(t_ns[worst]))}{more}"]


def shortened(remarks: Sequence[str]) -> list[str]:
    """Return the first few remarks, and the number of those that are left out."""
    more = len(remarks) - _MOST_REMARKS
    return [*remarks[:_MOST_REMARKS], f"and {more} more of these"] if more > 0 else list(remarks)


def seconds(t_ns: int) -> str:
    """Return a time or duration as text: seconds to the millisecond, or days when it is long."""
    if abs(t_ns) >= 10 * AHEAD_NS:
        return f"{t_ns / AHEAD_NS:.1f} days"
    return f"{t_ns / NANOSECONDS:.3f} s"


def utc_text(utc_ns: int) -> str:
    """Return an instant (ns since 1970) in RFC 3339 to the millisecond; the bare number when it is beyond the calendar."""
    try:
        moment = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(microseconds=utc_ns // 1000)
    except OverflowError:
        return f"{utc_ns} ns since 1970"
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def utc_ns(text: str) -> int | None:
    """Return the ns since 1970 of an RFC 3339 instant, UTC when it names no zone; None when the text is not one."""
    try:
        moment = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=timezone.utc)
    # Division of timedeltas is exact; a float of seconds would not be.
    return (moment - datetime(1970, 1, 1, tzinfo=timezone.utc)) // timedelta(microseconds=1) * 1000
