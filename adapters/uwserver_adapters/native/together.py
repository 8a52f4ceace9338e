"""Encodes the samples of a few ticks in one go, from rows of numbers, for clients that keep up with them.

This is the quick way, for ports that have one subscriber each, as nearly always: then no sample has to be kept for a second client, replaced by a
newer one or dropped.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from uwserver.adapter import (
    NOBODY,
    NOT_BEGUN,
    UNKNOWN,
    AdapterStats,
    NotMet,
    Origin,
    Told,
    choose,
)
from uwserver.ports import Value
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.encoding import sample_notice
from uwserver_adapters.native.outbox import Outbox
from uwserver_adapters.native.routes import Selection
from uwserver_adapters.native.shares import Share

IntArray = npt.NDArray[np.int64]

log = logging.getLogger(__name__)


class _Line(NamedTuple):
    """The line from a stream to its only taker.

    Attributes:
        path: of the port.
        taker: number of the client.
        share: how much the client takes.
        record: makes an object for the encoder of the values.
    """

    path: str
    taker: int
    share: Share
    record: Callable[..., object]


class _Taker(NamedTuple):
    """A client that takes samples."""

    outbox: Outbox
    codec: Codec


class Together:
    """Sends what it can of a `Fanout`; the rest is not its.

    Args:
        selections: of a port, by what they are.
        stats: counts.
    """

    def __init__(self, selections: Callable[[str], Mapping[Any, Selection]], stats: AdapterStats) -> None:
        self._selections = selections
        self._stats = stats
        self._origins: Mapping[int, Origin] = {}
        self.forget()

    def forget(self) -> None:
        """Somebody takes another port, or more or less of one."""
        self._lines: list[_Line] = []
        self._takers: list[_Taker] = []
        self._line_of = _NONE
        self._rates: list[float] = []

    def send(self, told: Told) -> list[Outbox] | None:
        """Give all of them to their takers, who have to `flush` then. None where that cannot be, and nothing was done: a port has no taker, or
        several; one has no time; a sample takes more than its numbers, as a picture; or time was set back."""
        if told.origins is not self._origins:
            self.forget()
            self._origins = told.origins
        try:
            chosen = self._choose(told)
        except NotMet:
            self._meet(told)
            chosen = self._choose(told)
        if chosen is None:
            return None
        messages: dict[int, list[Struct]] = {}
        entries = told.entries()
        for number, entry, values in zip(chosen.tolist(), entries, told.values(entries), strict=True):
            if number != NOBODY:
                line = self._lines[number]
                messages.setdefault(line.taker, []).append(_notice(line, entry, values))
        for taker, some in messages.items():
            self._give(self._takers[taker], some)
        return [self._takers[taker].outbox for taker in messages]

    def _choose(self, told: Told) -> IntArray | None:
        shares = [line.share for line in self._lines]
        newest = [share.newest for share in shares]
        has_time = [taker.outbox.has_time for taker in self._takers]
        ready = [has_time[line.taker] for line in self._lines]
        starts = [share.start_ns for share in shares]
        chosen = choose(told, self._line_of, ready, self._rates, starts, newest)
        if chosen is not None:
            for share, interval in zip(shares, newest, strict=True):
                share.newest = interval
        return chosen

    def _meet(self, told: Told) -> None:
        """Find the lines of streams that are met for the first time, and let their intervals begin."""
        first_ns = {stream: t_ns for _, _, stream, _, t_ns, _, _ in reversed(told.entries())}
        known = len(self._line_of)
        line_of = np.full(max(known, 1 + max(first_ns)), UNKNOWN)
        line_of[:known] = self._line_of
        for stream, t_ns in first_ns.items():
            if line_of[stream] == UNKNOWN:
                line = self._new_line(self._origins[stream].path)
                line_of[stream] = NOBODY if line is None else len(self._lines)
                self._lines += [] if line is None else [line]
            if line_of[stream] != NOBODY and (share := self._lines[line_of[stream]].share).start_ns == NOT_BEGUN:
                share.begin(t_ns)
        self._line_of = line_of
        self._rates = [line.share.rate_hz for line in self._lines]

    def _new_line(self, path: str) -> _Line | None:
        selections = self._selections(path)
        if len(selections) != 1:
            return None
        (selection,) = selections.values()
        if len(selection.routes) != 1 or selection.is_jpeg:
            return None
        (route,) = selection.routes.values()
        form, share, outbox = selection.form, route.only, route.outbox
        if share is None or form.record is None or form.is_long or not isinstance(outbox, Outbox):
            return None
        return _Line(path, self._taker(outbox, route.codec), share, form.record)

    def _taker(self, outbox: Outbox, codec: Codec) -> int:
        for number, taker in enumerate(self._takers):
            if taker.outbox is outbox:
                return number
        self._takers.append(_Taker(outbox, codec))
        return len(self._takers) - 1

    def _give(self, taker: _Taker, messages: Sequence[Struct]) -> None:
        codec = taker.codec
        try:
            encoded, number = codec.together(messages), len(messages)
        except (TypeError, ValueError, OverflowError):  # one of them; the others are sent
            parts = [part for message in messages if (part := self._encoded(codec, message))]
            encoded, number = b"".join(parts), len(parts)
        self._sent(taker.outbox, encoded, number)

    def _sent(self, outbox: Outbox, encoded: bytes, number: int) -> None:
        self._stats.encoded += number
        outbox.put_at_once(encoded, number)

    def _encoded(self, codec: Codec, message: Struct) -> bytes:
        try:
            return codec.together([message])
        except Exception:
            self._stats.errors += 1
            log.exception("a sample could not be sent")
            return b""


def _notice(line: _Line, entry: Sequence[int], values: Sequence[Value]) -> Struct:
    t_sent_ns, _, _, seq, t_ns, valid, _ = entry
    return sample_notice(line.path, seq, t_ns, t_sent_ns, valid != 0, line.record(*values))


_NONE: IntArray = np.zeros(0, np.int64)
