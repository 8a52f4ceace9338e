"""What a modem remembers: messages that it is to send, that it waits for, and that it has to tell; and what it has counted."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from uwserver.modifiers.base import Memory, Number, Time

MOST_BYTES = 1 << 16
HIGHEST_ADDRESS = 65_535
MOST_INBOX = 256
"""Messages that wait to be told; of more the oldest is lost."""
MOST_QUEUE = 64
MOST_SEEN = 16
_Address = Annotated[int, Meta(ge=0, le=HIGHEST_ADDRESS)]
_Id = Annotated[int, Meta(ge=0, le=2**53)]
_Data = Annotated[bytes, Meta(max_length=MOST_BYTES)]
Event = Literal["data", "delivered", "failed"]


class Outgoing(Struct, frozen=True):
    """A message that waits to be sent.

    Attributes:
        id: of the message; an answer has that of what it answers.
        destination: address.
        data: payload.
        answer: it answers a message, that `wanted` one.
        wanted: it asks for an answer.
        after: not before this time, s.
        tries: that are left, of one that asks for an answer.
        heard: of an answer: when the message it answers had been heard, s.
        patience: how long an answer is waited for, s; 0 for as long as one can take.
        ranging: a caller waits for the range.
    """

    id: _Id
    destination: _Address
    data: _Data = b""
    answer: bool = False
    wanted: bool = False
    after: Time = 0.0
    tries: Annotated[int, Meta(ge=0, le=17)] = 0
    heard: Time = 0.0
    patience: Time = 0.0
    ranging: bool = False


class Waiting(Struct, frozen=True):
    """A message that was sent, and whose answer has not come.

    Attributes:
        message: that was sent.
        over: when its last sound had left, s.
        until: when nobody waits any more, s.
    """

    message: Outgoing
    over: Time
    until: Time


class Message(Struct, frozen=True):
    """What a modem has to tell.

    Attributes:
        event: data that came, or what became of a message that asked for an answer.
        source, destination: addresses.
        data: payload.
        begin, over: when it began and ended to arrive, s.
        level, snr: dB.
        range: m.
        bearing, elevation: rad in S.
        speed: with which the way of the sound grows longer, m/s.
    """

    event: Event
    source: _Address
    destination: _Address
    data: _Data
    begin: Time
    over: Time
    level: Number | None = None
    snr: Number | None = None
    range: Number | None = None
    bearing: Number | None = None
    elevation: Number | None = None
    speed: Number | None = None


Count = Annotated[int, Meta(ge=0, le=2**53)]


class Counts(Struct, frozen=True):
    """What a modem has counted since the start of the run. Losses are of messages for it.

    Attributes:
        sent: packets, answers too.
        heard: messages told.
        collided: lost in the sound of other modems.
        deaf: lost because it was sending itself.
        smeared: lost in their own late arrivals.
        faint: lost in noise, or not noticed.
        doppler: lost because the modems moved too fast against each other.
        unanswered: messages that asked for an answer in vain.
        dropped: messages that nobody fetched in time.
    """

    sent: Count = 0
    heard: Count = 0
    collided: Count = 0
    deaf: Count = 0
    smeared: Count = 0
    faint: Count = 0
    doppler: Count = 0
    unanswered: Count = 0
    dropped: Count = 0


class ModemMemory(Memory):
    """Attributes:
    busy: until when it sends, s.
    queue: what waits to be sent.
    waiting: what was sent, and is not answered.
    seen: messages that came last: an answer that was lost lets one come twice.
    inbox: what is to be told.
    counts: see `Counts`."""

    busy: Time = 0.0
    queue: Annotated[tuple[Outgoing, ...], Meta(max_length=2 * MOST_QUEUE)] = ()
    waiting: Annotated[tuple[Waiting, ...], Meta(max_length=2 * MOST_QUEUE)] = ()
    seen: Annotated[tuple[_Id, ...], Meta(max_length=MOST_SEEN)] = ()
    inbox: Annotated[tuple[Message, ...], Meta(max_length=MOST_INBOX)] = ()
    counts: Counts = Counts()
