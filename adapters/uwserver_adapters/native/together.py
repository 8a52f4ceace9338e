"""Samples of some ticks to a client that has time for all of them: made from rows of numbers and encoded in one go.

Where each port has one taker, as nearly always, nothing has to be kept for others, replaced or dropped. For those who read JSON line by line, and
take numbers and short texts alone, compiled code writes the lines: while it does, the world goes on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

from msgspec import Struct

from uwserver.adapter import AdapterStats, LineWriter, Origin, Told
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.encoding import sample_notice
from uwserver_adapters.native.outbox import Outbox
from uwserver_adapters.native.routes import Selection
from uwserver_adapters.native.shares import Share

log = logging.getLogger(__name__)


class _Gathered(NamedTuple):
    """What gathers for one client: messages for its encoder; or places in a log, and the forms of the lines that are written of them."""

    codec: Codec
    messages: list[Struct]
    places: list[int]
    forms: list[int]


class _Line(NamedTuple):
    """From a stream to its only taker: how much it takes, what makes its values an object for the encoder, the form of its lines (None where compiled
    code cannot write them), and where they gather."""

    path: str
    share: Share
    record: Callable[..., object]
    form: int | None
    outbox: Outbox
    gathered: _Gathered


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
        self._lines: dict[int, _Line | None] = {}
        self._gathered: dict[Outbox, _Gathered] = {}
        self._writer: LineWriter | None = None

    def forget(self) -> None:
        """Somebody takes another port, or more or less of one."""
        self._lines.clear()
        self._gathered.clear()
        self._writer = None

    def send(self, told: Told) -> list[Outbox] | None:
        """Give all of them to their takers, who have to `flush` then. None where that cannot be, and nothing was done: a port has no taker, or
        several; one has no time; or a sample takes more than its numbers, as a picture."""
        if told.origins is not self._origins:
            self.forget()
            self._origins = told.origins
        entries = told.entries()
        streams = {entry[2] for entry in entries}
        lines = {stream: line for stream in streams if (line := self._line(stream)) is not None}
        if len(lines) < len(streams) or any(not line.outbox.has_time for line in lines.values()):
            return None
        # What one client gets keeps its order: all of it is written, or all of it made.
        slow = {line.outbox for line in lines.values() if line.form is None}
        if all(line.outbox in slow for line in lines.values()):
            self._make(told, entries, lines)
        else:
            self._choose(told, entries, lines, slow)
        return [
            outbox
            for outbox, gathered in self._gathered.items()
            if self._write(outbox, gathered, told) or self._give(outbox, gathered)
        ]

    def _make(self, told: Told, entries: Sequence[Sequence[int]], lines: Mapping[int, _Line]) -> None:
        for (t_sent_ns, _, stream, seq, t_ns, valid, _), values in zip(entries, told.values(entries), strict=True):
            path, share, record, _, _, gathered = lines[stream]
            if share.passes(t_ns):
                gathered.messages.append(sample_notice(path, seq, t_ns, t_sent_ns, valid != 0, record(*values)))

    def _choose(
        self, told: Told, entries: Sequence[Sequence[int]], lines: Mapping[int, _Line], slow: Collection[Outbox]
    ) -> None:
        """Of each sample a message for those clients that are `slow`, its place for the others."""
        for place, entry in enumerate(entries, told.first):
            line = lines[entry[2]]
            if not line.share.passes(entry[4]):
                continue
            if line.outbox in slow:
                line.gathered.messages.append(_notice(told, place, line))
            else:
                line.gathered.places.append(place)
                line.gathered.forms.append(line.form)  # type: ignore[arg-type]  # none of these is None

    def _line(self, stream: int) -> _Line | None:
        try:
            return self._lines[stream]
        except KeyError:
            line = self._lines[stream] = self._new_line(self._origins[stream].path)
            return line

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
        gathered = self._gathered.setdefault(outbox, _Gathered(route.codec, [], [], []))
        pieces = route.codec.pieces(selection.port, selection.fields)
        if pieces is not None and self._writer is None:
            self._writer = LineWriter()
        number = None if pieces is None or self._writer is None else self._writer.add(pieces)
        return _Line(path, share, form.record, number, outbox, gathered)

    def _write(self, outbox: Outbox, gathered: _Gathered, told: Told) -> bool:
        """Let compiled code write what has gathered for one; False where there is nothing, or it cannot: messages are made of it then."""
        places, forms = [*gathered.places], [*gathered.forms]
        if not places:
            return False
        # Before anything can fail: in another log they would be places of other samples, or of none.
        gathered.places.clear()
        gathered.forms.clear()
        assert self._writer is not None
        try:
            encoded = self._writer.write(told, places, forms)
        except ValueError:  # a text of one of them; the others are sent
            streams = told.streams
            lines = ((place, self._lines[streams[place - told.first]]) for place in places)
            gathered.messages.extend(_notice(told, place, line) for place, line in lines if line is not None)
            return False
        self._sent(outbox, encoded, len(places))
        return True

    def _give(self, outbox: Outbox, gathered: _Gathered) -> bool:
        codec, messages, _, _ = gathered
        if not messages:
            return False
        try:
            encoded, number = codec.together(messages), len(messages)
        except (TypeError, ValueError, OverflowError):  # one of them; the others are sent
            parts = [part for message in messages if (part := self._alone(codec, message))]
            encoded, number = b"".join(parts), len(parts)
        messages.clear()
        self._sent(outbox, encoded, number)
        return True

    def _sent(self, outbox: Outbox, encoded: bytes, number: int) -> None:
        self._stats.encoded += number
        outbox.put_at_once(encoded, number)

    def _alone(self, codec: Codec, message: Struct) -> bytes:
        try:
            return codec.together([message])
        except Exception:
            self._stats.errors += 1
            log.exception("a sample could not be sent")
            return b""


def _notice(told: Told, place: int, line: _Line) -> Struct:
    (sample,) = told.at(place)
    value = line.record(*sample.value)
    return sample_notice(line.path, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid, value)
