"""Encodes the samples of a few ticks in one go, from rows of numbers, for clients that keep up with them.

This is the quick way for ports with one subscriber each, as nearly all are: no sample has to be kept for a second client, replaced by a newer one or
dropped.
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
    SampleBatch,
    choose,
)
from uwserver.ports import Value
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.messages import sample_message
from uwserver_adapters.native.outbox import Outbox
from uwserver_adapters.native.routes import Selection
from uwserver_adapters.native.shares import Share

IntArray = npt.NDArray[np.int64]

log = logging.getLogger(__name__)


class _Line(NamedTuple):
    """The line from a stream to the only client that takes it.

    Attributes:
        path: path of the port.
        outbox, codec: those of the client.
        share: how much the client takes.
        record: makes an object of the values that an encoder writes as a map.
    """

    path: str
    outbox: Outbox
    codec: Codec
    share: Share
    record: Callable[..., object]


class Together:
    """Sends samples of a `Fanout` in this way if possible. The fan-out sends the others.

    Args:
        selections: returns all selections of a port.
        stats: counts encoded samples and errors.
    """

    def __init__(self, selections: Callable[[str], Mapping[Any, Selection]], stats: AdapterStats) -> None:
        self._selections = selections
        self._stats = stats
        self._origins: Mapping[int, Origin] = {}
        self.forget()

    def forget(self) -> None:
        """Forget all lines, because a client takes another port, or more or less of one."""
        self._lines: list[_Line] = []
        # The number of the line of each stream, or NOBODY or UNKNOWN.
        self._line_of: IntArray = np.zeros(0, np.int64)
        self._rates: list[float] = []

    def send(self, batch: SampleBatch) -> list[Outbox] | None:
        """Queue all samples for their clients.

        Returns:
            The outboxes that have to be flushed. None if nothing was done, because a port has no client or several clients, a client is behind, a
            sample holds more than numbers, such as a picture, or time was set back.
        """
        if batch.origins is not self._origins:
            self.forget()
            self._origins = batch.origins
        try:
            chosen = self._choose(batch)
        except NotMet:
            self._find_new_lines(batch)
            chosen = self._choose(batch)
        if chosen is None:
            return None
        messages: dict[Outbox, tuple[Codec, list[Struct]]] = {}
        entries = batch.entries()
        for number, entry, values in zip(chosen.tolist(), entries, batch.values(entries), strict=True):
            if number != NOBODY:
                line = self._lines[number]
                messages.setdefault(line.outbox, (line.codec, []))[1].append(_message(line, entry, values))
        for outbox, (codec, some) in messages.items():
            self._send_to(outbox, codec, some)
        return list(messages)

    def _choose(self, batch: SampleBatch) -> IntArray | None:
        """Return the line of each sample, or NOBODY; None if it cannot be decided here. Raises `NotMet` for a new stream."""
        shares = [line.share for line in self._lines]
        newest = [share.newest for share in shares]
        ready = [line.outbox.is_ready for line in self._lines]
        starts = [share.start_ns for share in shares]
        chosen = choose(batch, self._line_of, ready, self._rates, starts, newest)
        if chosen is not None:
            for share, interval in zip(shares, newest, strict=True):
                share.newest = interval
        return chosen

    def _find_new_lines(self, batch: SampleBatch) -> None:
        """Find the lines of new streams, and begin their intervals."""
        first_ns = {stream: t_ns for _, _, stream, _, t_ns, _, _ in reversed(batch.entries())}
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
        return _Line(path, outbox, route.codec, share, form.record)

    def _send_to(self, outbox: Outbox, codec: Codec, messages: Sequence[Struct]) -> None:
        try:
            encoded, number = codec.together(messages), len(messages)
        except (TypeError, ValueError, OverflowError):
            # One message cannot be encoded. The others are sent.
            parts = [part for message in messages if (part := self._encoded(codec, message))]
            encoded, number = b"".join(parts), len(parts)
        self._stats.encoded += number
        outbox.put_at_once(encoded, number)

    def _encoded(self, codec: Codec, message: Struct) -> bytes:
        try:
            return codec.message(message)
        except Exception:
            self._stats.errors += 1
            log.exception("a sample could not be sent")
            return b""


def _message(line: _Line, entry: Sequence[int], values: Sequence[Value]) -> Struct:
    t_sent_ns, _, _, seq, t_ns, valid, _ = entry
    return sample_message(line.path, seq, t_ns, t_sent_ns, valid != 0, line.record(*values))
