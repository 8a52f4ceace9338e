"""Samples of some ticks to a client that has time for all of them: made from rows of numbers and encoded in one go.

Where each port has one taker, as nearly always, nothing has to be kept for others, replaced or dropped. For those who read JSON line by line, and
take numbers and short texts alone, compiled code writes the lines: while it does, the world goes on.
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
    LineWriter,
    NotMet,
    Origin,
    Told,
    choose,
    way_here,
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
    """From a stream to its only taker: the number of that, how much it takes, what makes its values an object for the encoder, and the form of its
    lines (NOBODY where compiled code cannot write them)."""

    path: str
    taker: int
    share: Share
    record: Callable[..., object]
    form: int


class _Taker(NamedTuple):
    """A client, and whether compiled code writes for it: what it gets keeps its order, so all of it is written, or all of it made."""

    outbox: Outbox
    codec: Codec
    is_written: bool


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
        self._of_lines = _NONE, _NONE
        self._rates: list[float] = []
        self._writer: LineWriter | None = None

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
        takers, forms = self._of_lines
        taken_by = takers[chosen]  # of those that are not chosen it is the last entry
        touched, made = [], dict[int, IntArray]()
        for number, taker in enumerate(self._takers):
            places = (taken_by == number).nonzero()[0]
            if len(places):
                touched.append(taker.outbox)
                if not self._write(taker, told, places + told.first, forms[chosen[places]]):
                    made[number] = places
        if made:
            self._make(told, chosen, made, is_all=len(made) == len(touched))
        return touched

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
        takers, forms = [line.taker for line in self._lines], [line.form for line in self._lines]
        self._of_lines = np.array([*takers, NOBODY]), np.array([*forms, NOBODY])
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
        pieces = route.codec.pieces(selection.port, selection.fields)
        if pieces is not None and self._writer is None:
            self._writer = LineWriter(way_here())
        number = NOBODY if pieces is None or self._writer is None else self._writer.add(pieces)
        return _Line(path, self._taker(outbox, route.codec, pieces is not None), share, form.record, number)

    def _taker(self, outbox: Outbox, codec: Codec, is_written: bool) -> int:
        for number, taker in enumerate(self._takers):
            if taker.outbox is outbox:
                self._takers[number] = taker._replace(is_written=taker.is_written and is_written)
                return number
        self._takers.append(_Taker(outbox, codec, is_written))
        return len(self._takers) - 1

    def _write(self, taker: _Taker, told: Told, places: IntArray, forms: IntArray) -> bool:
        """Let compiled code write what was chosen for one; False where it cannot."""
        if not taker.is_written:
            return False
        assert self._writer is not None
        try:
            encoded = self._writer.write(told, places, forms)
        except ValueError:  # a text of one of them; the others are sent
            return False
        self._sent(taker.outbox, encoded, len(places))
        return True

    def _make(self, told: Told, chosen: IntArray, made: Mapping[int, IntArray], is_all: bool) -> None:
        """Make messages of what was chosen for these, by place behind the first; `is_all`: for nobody else something was."""
        numbers = chosen.tolist()
        messages: dict[int, list[Struct]] = {number: [] for number in made}
        if is_all:  # in one go
            entries = told.entries()
            for line, entry, values in zip(numbers, entries, told.values(entries), strict=True):
                if line != NOBODY:
                    messages[self._lines[line].taker].append(_notice(self._lines[line], entry, values))
        else:
            for number, places in made.items():
                messages[number] = [_alone(told.at(told.first + n), self._lines[numbers[n]]) for n in places.tolist()]
        for number, some in messages.items():
            self._give(self._takers[number], some)

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


def _alone(told: Told, line: _Line) -> Struct:
    entries = told.entries()
    (values,) = told.values(entries)
    return _notice(line, entries[0], values)


_NONE: IntArray = np.zeros(0, np.int64)
