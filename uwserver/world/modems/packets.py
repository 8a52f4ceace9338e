"""Packets in the water, and what of them is on its way to each modem: plain records, as a state keeps them."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from msgspec import Meta, Struct

from uwserver.modifiers.base import Number, Time
from uwserver.sensors.messages import MOST_BYTES
from uwserver.sensors.modem import Signal
from uwserver.world.part import State

MOST_PACKETS = 1024
"""In the water at a time; of more the oldest are forgotten."""
MOST_LEGS = 16_384
_Number = Annotated[int, Meta(ge=0, le=2**53)]
_Address = Annotated[int, Meta(ge=0, le=65_535)]
_Path = Annotated[str, Meta(max_length=4096)]
Number3 = tuple[Number, Number, Number]
Power = Annotated[float, Meta(ge=0, le=1e300)]


class Packet(Struct, frozen=True):
    """A packet that was sent.

    Attributes:
        number: counts them.
        message: id of the message; of an answer that of the message it answers.
        sender: port of the modem that tells what it hears.
        source, destination: addresses.
        data: payload.
        answer, wanted: it answers; it asks for an answer.
        held: of an answer: from the end of the message to its own beginning, s.
        left: when, s.
        lasts: s.
        p: where, in N, m.
        signal: what it sounds like.
        v: how its sender moved, in N, m/s.
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
        """When its end had left, s."""
        return self.left + self.lasts


_AT_ONCE_S = 1e-6
"""Less than a symbol of any modem, and more than times are uncertain by."""
COMING: Final = 0
THERE: Final = 1
PAST: Final = 2
"""It is still under way, it is being heard, or it has been."""


class Leg(Struct, frozen=True):
    """A packet's way to one modem.

    Attributes:
        packet: number.
        receiver: port of the modem.
        wake: when there is something to do about it, s.
        stage: `COMING`, `THERE` or `PAST`; what follows holds from `THERE` on.
        begin, over: when it began and ended to arrive, s.
        signal, noise, late: powers, as of `uwserver.sensors.modem.Crossing`.
        level: dB.
        bearing, elevation: rad in the frame of the modem; None where it cannot tell.
        speed: with which its way grew longer, m/s.
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
        """Whether it was heard at a time between these, s; what follows at once does not meet it."""
        return self.begin + _AT_ONCE_S < over and begin + _AT_ONCE_S < self.over


class MediumState(State, frozen=True):
    """What is in the water.

    Attributes:
        count: packets and messages so far, which numbers them.
        packets, legs: in the order in which they began.
    """

    count: _Number
    packets: Annotated[tuple[Packet, ...], Meta(max_length=MOST_PACKETS)]
    legs: Annotated[tuple[Leg, ...], Meta(max_length=MOST_LEGS)]
