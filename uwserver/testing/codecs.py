"""Checks a codec without input and output against a table of bytes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol


class ReadingCodec(Protocol):
    """What the checks need of a codec."""

    def receive(self, data: bytes) -> None:
        """Store bytes, without parsing them."""

    def next_event(self) -> Any:
        """Return the next message, or the sentinel if more bytes are needed."""


@dataclass(frozen=True)
class CodecCase:
    """A row of the table.

    Attributes:
        name: name of the case, for the text of a failure.
        data: the bytes of whole messages on the wire.
        events: the messages that a codec reads from them, in order.
        write: makes `data` with a new codec; None for messages that our side never sends.
    """

    name: str
    data: bytes
    events: tuple[object, ...] = ()
    write: Callable[[Any], bytes] | None = None


def check_codec(
    make_codec: Callable[[], ReadingCodec],
    cases: Sequence[CodecCase],
    *,
    need_data: object,
    garbage: Sequence[bytes] = (),
    resynchronises: bool = False,
) -> None:
    """Run a table of bytes through a codec in both directions.

    Args:
        make_codec: makes a codec for a new connection.
        cases: the table.
        need_data: the sentinel of `next_event`.
        garbage: bytes that are no message, with a delimiter if the protocol has one. They must never raise.
        resynchronises: whether the codec understands the next message after garbage, as in a protocol with delimiters or checksums.

    Raises:
        AssertionError: the text names the case and what differs.
    """
    for case in cases:
        if case.write is not None:
            written = case.write(make_codec())
            assert written == case.data, f"{case.name}: wrote {written!r}, the table says {case.data!r}"
        if case.events:
            _check_reading(make_codec, case, need_data)
            _check_truncated(make_codec, case, need_data)
    whole = CodecCase(
        "all cases in one piece", b"".join(c.data for c in cases if c.events), sum((c.events for c in cases), ())
    )
    _check_reading(make_codec, whole, need_data)
    for junk in garbage:
        _check_garbage(make_codec, junk, [case for case in cases if case.events] if resynchronises else [], need_data)


def read_all(codec: ReadingCodec, pieces: Sequence[bytes], need_data: object) -> list[object]:
    """Feed pieces one by one and return all events; raises AssertionError if a piece yields events without end."""
    events: list[object] = []
    most = sum(map(len, pieces)) + 16
    for piece in pieces:
        codec.receive(piece)
        bound = len(events) + len(piece) + most
        while (event := codec.next_event()) is not need_data:
            events.append(event)
            assert len(events) <= bound, f"{piece[:60]!r} yields events without end: {event!r}"
    return events


def _check_reading(make_codec: Callable[[], ReadingCodec], case: CodecCase, need_data: object) -> None:
    ways = {
        "whole": [case.data],
        "byte by byte": [case.data[i : i + 1] for i in range(len(case.data))],
        "in threes": [case.data[i : i + 3] for i in range(0, len(case.data), 3)],
    }
    for way, pieces in ways.items():
        events = read_all(make_codec(), pieces, need_data)
        assert events == list(case.events), f"{case.name}, {way}: read {events!r}, the table says {list(case.events)!r}"


def _check_truncated(make_codec: Callable[[], ReadingCodec], case: CodecCase, need_data: object) -> None:
    for cut in range(len(case.data)):
        events = read_all(make_codec(), [case.data[:cut]], need_data)
        expected = list(case.events)[: len(events)]
        assert events == expected, f"{case.name}, cut after {cut} bytes: read {events!r}"
        assert len(events) < len(case.events), f"{case.name}, cut after {cut} bytes: read all of what is not complete"


def _check_garbage(
    make_codec: Callable[[], ReadingCodec], junk: bytes, cases: Sequence[CodecCase], need_data: object
) -> None:
    for way in ([junk], [junk[i : i + 1] for i in range(len(junk))]):
        read_all(make_codec(), way, need_data)
        for case in cases:
            events = read_all(make_codec(), [*way, case.data], need_data)
            understood = events[-len(case.events) :]
            assert understood == list(case.events), f"{case.name} after garbage {junk[:60]!r}: read {events!r}"
