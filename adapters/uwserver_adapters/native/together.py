"""Samples of some ticks to a client that has time for all of them: made from rows of numbers and encoded in one go.

Where each port has one taker, as nearly always, nothing has to be kept for others, replaced or dropped.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from msgspec import Struct

from uwserver.adapter import AdapterStats, Origin, Told
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.encoding import sample_notice
from uwserver_adapters.native.outbox import Outbox
from uwserver_adapters.native.routes import Selection
from uwserver_adapters.native.shares import Share

log = logging.getLogger(__name__)


class _Line(NamedTuple):
    """From a stream to its only taker: how much it takes, what makes its values an object for the encoder, and where its messages gather."""

    path: str
    share: Share
    record: Callable[..., object]
    outbox: Outbox
    messages: list[Struct]


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
        self._gathered: dict[Outbox, tuple[Codec, list[Struct]]] = {}

    def forget(self) -> None:
        """Somebody takes another port, or more or less of one."""
        self._lines.clear()
        self._gathered.clear()

    def send(self, told: Told) -> list[Outbox] | None:
        """Give all of them to their takers, who have to `flush` then. None where that cannot be, and nothing was done: a port has no taker, or
        several; one has no time; or a sample takes more than its numbers, as a picture."""
        if told.origins is not self._origins:
            self.forget()
            self._origins = told.origins
        entries = told.entries()
        lines = [self._line(entry[2]) for entry in entries]
        if None in lines:
            return None
        busy = [outbox for outbox in self._gathered if not outbox.has_time]
        if busy and any(line.outbox in busy for line in lines if line is not None):
            return None
        for (t_sent_ns, _, _, seq, t_ns, valid, _), line, values in zip(
            entries, lines, told.values(entries), strict=True
        ):
            path, share, record, _, messages = line  # type: ignore[misc]  # none is None
            if share.passes(t_ns):
                messages.append(sample_notice(path, seq, t_ns, t_sent_ns, valid != 0, record(*values)))
        return [outbox for outbox, (codec, messages) in self._gathered.items() if self._give(outbox, codec, messages)]

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
        messages = self._gathered.setdefault(outbox, (route.codec, []))[1]
        return _Line(path, share, form.record, outbox, messages)

    def _give(self, outbox: Outbox, codec: Codec, messages: list[Struct]) -> bool:
        if not messages:
            return False
        try:
            encoded, count = codec.together(messages), len(messages)
        except (TypeError, ValueError, OverflowError):  # one of them; the others are sent
            parts = [part for message in messages if (part := self._alone(codec, message))]
            encoded, count = b"".join(parts), len(parts)
        messages.clear()
        self._stats.encoded += count
        outbox.put_at_once(encoded, count)
        return True

    def _alone(self, codec: Codec, message: Struct) -> bytes:
        try:
            return codec.together([message])
        except Exception:
            self._stats.errors += 1
            log.exception("a sample could not be sent")
            return b""
