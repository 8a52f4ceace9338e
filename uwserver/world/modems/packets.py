"""Packets in the water, and their ways to each modem, as plain records that a state can keep."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from msgspec import Meta, Struct

from uwserver.modifiers.base import Number, Time
from uwserver.sensors.modem import MOST_BYTES, Signal
from uwserver.world.parts.part import State

MOST_PACKETS = 1024
"""Most packets in the water at a time. If there are more, the oldest are dropped."""
MOST_LEGS = 16_384
_Number = Annotated[int, Meta(ge=0, le=2**53)]
_Address = Annotated[int, Meta(ge=0, le=65_535)]
_Path = Annotated[str, Meta(max_length=4096)]
Number3 = tuple[Number, Number, Number]
Power = Annotated[float, Meta(ge=0, le=1e300)]


class Packet(Struct, frozen=True):
    """A packet that was sent.

    Attributes:
        number: counts the packets.
        message: id of the message; for an answer the id of the message that it answers.
        sender: port at which the sending modem reports what it hears.
        source, destination: addresses.
        data: payload.
        answer, wanted: whether it is an answer; whether it asks for one.
        held: for an answer, time from the end of the message to the beginning of the answer, s.
        left: time at which it was sent, s.
        lasts: duration, s.
        p: position of the sender in N, m.
        signal: the sound.
        v: velocity of the sender in N, m/s.
    """

    number: _Number
    message: _Number
    sender: _Path
    source: _Address
    destination: _Address
    data: Annotated[bytes, Meta(max_length=MOST_BYTES)]
    answer: bool
    wanted: bool
    held: Number
    left: Time
    lasts: Time
    p: Number3
    signal: Signal
    v: Number3 = (0.0, 0.0, 0.0)

    @property
    def over(self) -> float:
        """Time at which its end was sent, s."""
        return self.left + self.lasts


_AT_ONCE_S = 1e-6
"""Shorter than a symbol of any modem, and longer than the rounding errors of times."""
COMING: Final = 0
THERE: Final = 1
PAST: Final = 2
"""The stages of a leg: still in flight, being heard, or heard before."""


class Leg(Struct, frozen=True):
    """The way of a packet to one modem.

    Attributes:
        packet: number of the packet.
        receiver: port of the modem.
        wake: time at which something is due, s.
        stage: `COMING`, `THERE` or `PAST`; the following values hold from `THERE` on.
        begin, over: times at which its beginning and its end arrived, s.
        signal, noise, late: powers, as in `uwserver.sensors.modem.Crossing`.
        level: dB.
        bearing, elevation: rad in the frame of the modem; None if the modem cannot measure them.
        speed: rate at which the way grew longer, m/s.
    """

    packet: _Number
    receiver: _Path
    wake: Time
    stage: Literal[0, 1, 2] = COMING
    begin: Time = 0.0
    over: Time = 0.0
    signal: Power = 0.0
    noise: Power = 1.0
    late: Power = 0.0
    level: Annotated[float, Meta(ge=-1e4, le=1e4)] = 0.0
    bearing: Number | None = None
    elevation: Number | None = None
    speed: Number = 0.0

    def meets(self, begin: float, over: float) -> bool:
        """Return whether it was heard at a time between these, s. A packet that follows without a gap does not meet it."""
        return self.begin + _AT_ONCE_S < over and begin + _AT_ONCE_S < self.over


class MediumState(State, frozen=True):
    """Everything in the water.

    Attributes:
        count: packets and messages so far; it numbers them.
        packets, legs: in the order in which they began.
    """

    count: _Number
    packets: Annotated[tuple[Packet, ...], Meta(max_length=MOST_PACKETS)]
    legs: Annotated[tuple[Leg, ...], Meta(max_length=MOST_LEGS)]
