"""What lives in a world: the contract of a part. A tick (`uwserver.step.tick`) stops for lists of parts and knows none of them by name."""

# ruff: noqa: B027 - a part implements the stages in which it takes part, and no others

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from msgspec import Struct, msgpack

from uwserver.ports import Json, Sample, Service
from uwserver.ports.crossing import Later
from uwserver.world.profile import Timer, kind_of, untimed

Carry = Callable[[Mapping[str, Json]], Json | Later]
"""What a service does; runs at the start of a tick. A long-running one gives its answers later."""


class Stage(IntEnum):
    """When in a tick a part acts; `uwserver.step.tick` says why in this order. Between WATCHDOGS and FORCES autopilots step, between FORCES and WATER
    the bodies move."""

    FAULTS = 1
    WATCHDOGS = 2
    FORCES = 3
    WATER = 4
    SENSORS = 5

    @property
    def title(self) -> str:
        """As in a profile."""
        return self.name.lower()


class State(Struct, frozen=True):
    """What is kept of a part between two ticks: plain, immutable, typed values; arrays and the records of components as bytes."""

    def deciding(self) -> State:
        """What of it decides how the run goes on, for the state hash."""
        return self

    def settled(self) -> State:
        """The same, to be encoded: what is under computation has been waited for."""
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
        after_ns: time before which `after` has nothing to do, ns of simulation; of a part that acts before sensors read. Looked at when ticks begin,
            and whenever one has needed Python.
        hears: paths of the ports whose delivered samples it gets.
        idle: it has nothing to do in any tick, though others of its kind do; decided when it is made.
        services: what it can be asked, and what that does.
    """

    state_type: ClassVar[type[State]]
    stage: ClassVar[Stage] = Stage.FORCES
    order: ClassVar[int] = 0
    next_tick: int | None = None
    after_ns: int = 0
    hears: tuple[str, ...] = ()
    idle: bool = False
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

    def forget(self, body: str) -> None:
        """A body is about to go: drop what is about it."""

    def leave(self, why: str) -> None:
        """It goes, or the run ends: whoever waits for it is answered."""


@cache
def takes_part(kind: type[Part]) -> tuple[bool, bool]:
    """Whether parts of a kind implement `before`, and `after`."""
    return kind.before is not Part.before, kind.after is not Part.after


def is_awake(part: Part) -> bool:
    """Whether it acts in a tick, or hears what others measure."""
    return not part.idle and (any(takes_part(type(part))) or bool(part.hears))


Before = Callable[[int, int], None]
After = Callable[[int, int, list[Sample]], None]
Hear = Callable[[Sample, int], None]


class Turns(NamedTuple):
    """What parts do in a tick, in its order.

    Attributes:
        first: before what was posted is carried out.
        watch: after that, before autopilots.
        forces: after these, before the bodies move.
        follow: when they have moved, before sensors read.
        last: after these.
        ears: who hears each port.
    """

    first: list[tuple[Part, Before]]
    watch: list[tuple[Part, Before]]
    forces: list[tuple[Part, Before]]
    follow: list[tuple[Part, After]]
    last: list[After]
    ears: dict[str, list[Hear]]


def _what(part: Part) -> str:
    """What it is called in a profile: its name, where there is one in the world, else its kind."""
    place, _, name = part.path.rpartition("/")
    return name if place == "world" else kind_of(part)


def in_turn(awake: Iterable[Part], timed: Timer = untimed) -> Turns:
    """The order of a tick of parts that do something in it, each called through what `timed` makes of it."""
    everybody = sorted(awake, key=lambda part: (part.stage, part.order, part.path))
    acting = [part for part in everybody if takes_part(type(part))[0]]
    ears: dict[str, list[Hear]] = {}
    for part in everybody:
        hear = timed("listening", _what(part), part.hear)
        for port in part.hears:
            ears.setdefault(port, []).append(hear)
    before = [(part, timed(part.stage.title, _what(part), part.before)) for part in acting]
    after = [
        (part, timed(part.stage.title, _what(part), part.after)) for part in everybody if takes_part(type(part))[1]
    ]
    return Turns(
        [turn for turn in before if turn[0].stage <= Stage.FAULTS],
        [turn for turn in before if Stage.FAULTS < turn[0].stage < Stage.FORCES],
        [turn for turn in before if turn[0].stage >= Stage.FORCES],
        [turn for turn in after if turn[0].stage < Stage.SENSORS],
        [act for part, act in after if part.stage >= Stage.SENSORS],
        ears,
    )


class RandomStream:
    """A random stream (PCG64) as something to save. Its increment comes with the seed and never changes, so that it is no part of the state."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._bits: Any = rng.bit_generator
        self._form: Any = self._bits.state

    def save(self) -> bytes:
        """Where it stands: 16 bytes, or 20 where half of a draw is left for the next one."""
        state = self._bits.state
        number: bytes = state["state"]["state"].to_bytes(16, "little")
        return number + state["uinteger"].to_bytes(4, "little") if state["has_uint32"] else number

    def load(self, data: bytes) -> None:
        """Go on from there."""
        form = self._form
        form["state"]["state"] = int.from_bytes(data[:16], "little")
        form["has_uint32"], form["uinteger"] = len(data) > 16, int.from_bytes(data[16:], "little")
        self._bits.state = form

    @staticmethod
    def check(data: bytes) -> None:
        """Raise ValueError where these bytes are no state of one."""
        if len(data) not in (16, 20):
            raise ValueError(f"a random stream has 16 or 20 bytes, not {len(data)}")


record = msgpack.Encoder().encode
"""A typed record as bytes."""


def read_record(data: bytes, like: Any) -> Any:
    """A record of the type of another, from bytes.

    Raises:
        ValueError: it is of another type, or outside the limits that the type declares.
    """
    return msgpack.decode(data, type=type(like))  # msgspec's errors are ValueErrors
