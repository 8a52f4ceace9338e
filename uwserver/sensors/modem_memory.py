"""The memory of a modem: messages to send, messages that wait for an answer, events to report, and counters."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from uwserver.modifiers.base import Memory, Number, Time

MOST_BYTES = 1 << 16
HIGHEST_ADDRESS = 65_535
MOST_INBOX = 256
"""Events that wait to be reported. If there are more, the oldest is lost."""
MOST_QUEUE = 64
MOST_SEEN = 16
Address = Annotated[int, Meta(ge=0, le=HIGHEST_ADDRESS)]
_Whole = Annotated[int, Meta(ge=0, le=2**53)]
_Data = Annotated[bytes, Meta(max_length=MOST_BYTES)]
Event = Literal["data", "delivered", "failed"]


class Outgoing(Struct, frozen=True):
    """A message that waits to be sent.

    Attributes:
        id: id of the message; an answer has the id of the message that it answers.
        destination: address of the receiver.
        data: payload.
        answer: it answers a message that `wanted` an answer.
        wanted: it asks for an answer.
        after: earliest time of sending, s.
        tries: how often it may still be sent, if it asks for an answer.
        heard: for an answer, the time at which the message that it answers had arrived, s.
        patience: how long the modem waits for an answer, s; 0 for the longest time that one can take.
        ranging: a caller waits for the range.
    """

    id: _Whole
    destination: Address
    data: _Data = b""
    answer: bool = False
    wanted: bool = False
    after: Time = 0.0
    tries: Annotated[int, Meta(ge=0, le=17)] = 0
    heard: Time = 0.0
    patience: Time = 0.0
    ranging: bool = False


class Waiting(Struct, frozen=True):
    """A message that was sent and not answered yet.

    Attributes:
        message: the message.
        over: time at which the end of the packet was sent, s.
        until: time until which the modem waits, s.
    """

    message: Outgoing
    over: Time
    until: Time


class ModemReport(Struct, frozen=True):
    """An event that a modem reports.

    Attributes:
        event: data has arrived, or the outcome of a message that asked for an answer.
        source, destination: addresses.
        data: payload.
        begin, over: time at which its signal began to arrive, and at which it ended, s.
        level, snr: dB.
        range: m.
        bearing, elevation: rad in S.
        speed: rate at which the path of the sound grows, m/s.
    """

    event: Event
    source: Address
    destination: Address
    data: _Data
    begin: Time
    over: Time
    level: Number | None = None
    snr: Number | None = None
    range: Number | None = None
    bearing: Number | None = None
    elevation: Number | None = None
    speed: Number | None = None


class Counts(Struct, frozen=True):
    """The counters of a modem since the start of the run. Losses count messages to this modem.

    Attributes:
        sent: packets, answers included.
        heard: messages reported.
        collided: lost in the signals of other modems.
        deaf: lost because this modem was sending.
        smeared: lost in their own late echoes.
        faint: lost in noise, or not detected.
        doppler: lost because the modems moved too fast relative to each other.
        unanswered: messages that asked for an answer and got none.
        dropped: messages that were not reported in time.
    """

    sent: _Whole = 0
    heard: _Whole = 0
    collided: _Whole = 0
    deaf: _Whole = 0
    smeared: _Whole = 0
    faint: _Whole = 0
    doppler: _Whole = 0
    unanswered: _Whole = 0
    dropped: _Whole = 0


class ModemMemory(Memory):
    """Attributes:
    busy: time until which it sends, s.
    queue: messages that wait to be sent.
    waiting: messages that were sent and not answered yet.
    seen: ids of the last messages that arrived. If an answer is lost, the same message arrives twice.
    inbox: events to report.
    counts: see `Counts`."""

    busy: Time = 0.0
    queue: Annotated[tuple[Outgoing, ...], Meta(max_length=2 * MOST_QUEUE)] = ()
    waiting: Annotated[tuple[Waiting, ...], Meta(max_length=2 * MOST_QUEUE)] = ()
    seen: Annotated[tuple[_Whole, ...], Meta(max_length=MOST_SEEN)] = ()
    inbox: Annotated[tuple[ModemReport, ...], Meta(max_length=MOST_INBOX)] = ()
    counts: Counts = Counts()
