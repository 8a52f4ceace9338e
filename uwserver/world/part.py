"""What lives in a world: the contract of a part. The tick (`uwserver.world.world`) runs over lists of parts and knows none of them by name."""

# ruff: noqa: B027 - a part implements the stages in which it takes part, and no others

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from msgspec import Struct, msgpack

from uwserver.ports import Json, Sample, Service
from uwserver.ports.crossing import Later

Carry = Callable[[Mapping[str, Json]], Json | Later]
"""What a service does; runs at the start of a tick. A long-running one gives its answers later."""


class Stage(IntEnum):
    """When in a tick a part acts; `World.advance` says why in this order."""

    FAULTS = 1
    WATCHDOGS = 3
    PILOTS = 4
    FORCES = 5
    WATER = 7
    SENSORS = 8


class State(Struct, frozen=True):
    """What is kept of a part between two ticks: plain, immutable, typed values; arrays and the records of components as bytes."""

    def deciding(self) -> State:
        """What of it decides how the run goes on, for the state hash."""
        return self


class Part(ABC):
    """Something that lives in a world, alone or for many.

    It takes part in those stages whose methods it implements. All of them run on the simulation thread.

    Attributes:
        path: unique in its world.
        state_type: of what `save` gives.
        stage: when `before` or `after` runs.
        order: place among the parts of a stage, smaller first; then by path.
        next_tick: the first tick in which `before` has something to do; None for never. Looked at in every tick.
        hears: paths of the ports whose delivered samples it gets.
        services: what it can be asked, and what that does.
    """

    state_type: ClassVar[type[State]]
    stage: ClassVar[Stage] = Stage.FORCES
    order: ClassVar[int] = 0
    next_tick: int | None = None
    hears: tuple[str, ...] = ()
    services: tuple[tuple[Service, Carry], ...] = ()

    @property
    @abstractmethod
    def path(self) -> str:
        """Its name in the world."""

    @abstractmethod
    def save(self) -> State:
        """All that decides how it goes on; costs microseconds, as it is called in a tick."""

    def check(self, state: Any) -> None:
        """Refuse a state from outside, of the right type, that cannot be of this part; changes nothing.

        Raises:
            ValueError: the text says what is wrong.
        """

    @abstractmethod
    def load(self, state: Any) -> None:
        """Take over a state that was checked, bit for bit. The bodies' arrays have been put back before."""

    def before(self, tick: int, t_ns: int) -> None:
        """Act before the bodies move from tick to tick + 1: set points, wrenches, marks."""

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """The bodies stand at `tick`: read them, and append what is delivered."""

    def hear(self, sample: Sample, t_ns: int) -> None:
        """A sample of one of the ports that it `hears` was delivered."""

    def leave(self, why: str) -> None:
        """It goes, or the run ends: whoever waits for it is answered."""


def takes_part(part: Part, method: str) -> bool:
    """Whether a part implements one of the optional methods."""
    return getattr(type(part), method) is not getattr(Part, method)


def stream_state(rng: np.random.Generator) -> bytes:
    """A random stream (PCG64) as 37 bytes."""
    state = rng.bit_generator.state
    inner = state["state"]
    numbers = inner["state"].to_bytes(16, "little") + inner["inc"].to_bytes(16, "little")
    return numbers + bytes((state["has_uint32"],)) + state["uinteger"].to_bytes(4, "little")  # type: ignore[no-any-return]


def check_stream(state: bytes) -> None:
    """Raise ValueError where these bytes are no random stream."""
    if len(state) != 37 or state[32] > 1 or not state[16] & 1:  # the increment of a PCG is odd
        raise ValueError("a random stream has 37 bytes, with an odd increment")


def set_stream(rng: np.random.Generator, state: bytes) -> None:
    """Put a random stream where `stream_state` found it."""
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {
            "state": int.from_bytes(state[:16], "little"),
            "inc": int.from_bytes(state[16:32], "little"),
        },
        "has_uint32": state[32],
        "uinteger": int.from_bytes(state[33:], "little"),
    }


record = msgpack.Encoder().encode
"""A typed record as bytes."""


def read_record(data: bytes, like: Any) -> Any:
    """A record of the type of another, from bytes.

    Raises:
        ValueError: it is of another type, or outside the limits that the type declares.
    """
    return msgpack.decode(data, type=type(like))  # msgspec's errors are ValueErrors
