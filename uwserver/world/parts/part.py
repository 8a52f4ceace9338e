"""The contract of a part: everything that lives in a world is one. A tick (`uwserver.step.tick`) stops for lists of parts and knows none of
them by name."""

# ruff: noqa: B027 - a part implements only the stages in which it acts

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from functools import cache
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from msgspec import Meta, Struct, msgpack

from uwserver.ports import Json, Sample, Service
from uwserver.ports.crossing import Later
from uwserver.world.parts.profile import Timer, kind_of, untimed

Carry = Callable[[Mapping[str, Json]], Json | Later]
"""The function of a service. It runs at the start of a tick. A long-running service returns a `Later` and answers later."""

Count = Annotated[int, Meta(ge=0, le=2**62)]
"""The limits of numbers in a state from outside. Larger numbers could not be counted up or encoded."""


class Stage(IntEnum):
    """When a part acts in a tick; `uwserver.step.tick` has the order. Autopilots step between WATCHDOGS and FORCES, and the bodies move
    between FORCES and WATER."""

    FAULTS = 1
    WATCHDOGS = 2
    FORCES = 3
    WATER = 4
    SENSORS = 5

    @property
    def title(self) -> str:
        """The name in a profile."""
        return self.name.lower()


class State(Struct, frozen=True):
    """The state of a part between two ticks: plain, immutable, typed values. Arrays and the records of components are kept as bytes."""

    def deciding(self) -> State:
        """Return the values that decide how the run goes on, for the state hash."""
        return self

    def completed(self) -> State:
        """Return the state ready to be encoded, after waiting for values under computation."""
        return self


class Part(ABC):
    """Something that lives in a world, such as a sensor, or a part that stands for all sensors.

    It acts in the stages whose methods it implements. All methods run on the simulation thread.

    Attributes:
        path: unique in its world.
        state_type: type of the state that `save` returns.
        stage: when `before` or `after` runs.
        order: place among the parts of a stage, smaller first; then by path.
        next_tick: the first tick in which `before` has something to do; None for never. It is checked in every tick.
        after_ns: before this simulation time (ns), `after` has nothing to do; for parts that act before sensors read. It is checked when
            ticks begin, and whenever a tick has needed Python.
        listens_to: paths of the ports whose delivered samples it gets.
        idle: whether it never has anything to do in a tick, though others of its class do; decided when it is made.
        services: its services, each with its function.
    """

    state_type: ClassVar[type[State]]
    stage: ClassVar[Stage] = Stage.FORCES
    order: ClassVar[int] = 0
    next_tick: int | None = None
    after_ns: int = 0
    listens_to: tuple[str, ...] = ()
    idle: bool = False
    services: tuple[tuple[Service, Carry], ...] = ()

    @property
    @abstractmethod
    def path(self) -> str:
        """Its name in the world."""

    @abstractmethod
    def save(self) -> State:
        """Return everything that decides how it goes on. It is called in a tick, so it may only take microseconds."""

    def check(self, state: Any) -> None:
        """Refuse a state from outside that has the right type but is not possible for this part. Changes nothing.

        Raises:
            ValueError: the text says what is wrong.
        """

    @abstractmethod
    def load(self, state: Any) -> None:
        """Take over a checked state, bit for bit. The arrays of the bodies have been put back before."""

    def before(self, tick: int, t_ns: int) -> None:
        """Act before the bodies move from tick to tick + 1: give set points, forces, marks."""

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """Act when the bodies are at `tick`: read them, and append samples that are delivered."""

    def on_sample(self, sample: Sample, t_ns: int) -> None:
        """Take a delivered sample of one of the ports in `listens_to`."""

    def forget(self, body: str) -> None:
        """Drop everything about a body that is about to go."""

    def leave(self, why: str) -> None:
        """Answer the callers that wait for this part. It is about to go, or the run ends."""


class Stateless(Part):
    """A part with no state of its own."""

    state_type = State

    def save(self) -> State:
        """Return an empty state."""
        return State()

    def load(self, state: Any) -> None:
        """Do nothing."""


@cache
def takes_part(kind: type[Part]) -> tuple[bool, bool]:
    """Return whether parts of a class implement `before`, and `after`."""
    return kind.before is not Part.before, kind.after is not Part.after


def is_awake(part: Part) -> bool:
    """Return whether a part acts in ticks, or gets samples of others."""
    return not part.idle and (any(takes_part(type(part))) or bool(part.listens_to))


Before = Callable[[int, int], None]
After = Callable[[int, int, list[Sample]], None]
OnSample = Callable[[Sample, int], None]


class PartSchedule(NamedTuple):
    """The work of parts in a tick, in the order of the tick.

    Attributes:
        first: before the posted requests are carried out.
        watch: after that, before autopilots.
        forces: after autopilots, before the bodies move.
        follow: after the bodies have moved, before sensors read.
        last: after the sensors.
        listeners: functions that take the samples of each port.
    """

    first: list[tuple[Part, Before]]
    watch: list[tuple[Part, Before]]
    forces: list[tuple[Part, Before]]
    follow: list[tuple[Part, After]]
    last: list[After]
    listeners: dict[str, list[OnSample]]


def _profile_name(part: Part) -> str:
    """Return the name of a part in a profile: the last part of its path if there is only one such part in the world, else its kind."""
    place, _, name = part.path.rpartition("/")
    return name if place == "world" else kind_of(part)


def schedule_of(awake: Iterable[Part], timed: Timer = untimed) -> PartSchedule:
    """Return the work of the parts that act in a tick. Each function is called through what `timed` makes of it."""
    ordered = sorted(awake, key=lambda part: (part.stage, part.order, part.path))
    acting = [part for part in ordered if takes_part(type(part))[0]]
    listeners: dict[str, list[OnSample]] = {}
    for part in ordered:
        on_sample = timed("listening", _profile_name(part), part.on_sample)
        for port in part.listens_to:
            listeners.setdefault(port, []).append(on_sample)
    before = [(part, timed(part.stage.title, _profile_name(part), part.before)) for part in acting]
    after = [
        (part, timed(part.stage.title, _profile_name(part), part.after))
        for part in ordered
        if takes_part(type(part))[1]
    ]
    return PartSchedule(
        [turn for turn in before if turn[0].stage <= Stage.FAULTS],
        [turn for turn in before if Stage.FAULTS < turn[0].stage < Stage.FORCES],
        [turn for turn in before if turn[0].stage >= Stage.FORCES],
        [turn for turn in after if turn[0].stage < Stage.SENSORS],
        [act for part, act in after if part.stage >= Stage.SENSORS],
        listeners,
    )


class RandomStream:
    """The state of a random stream (PCG64). Its increment comes from the seed and never changes, so the state leaves it out."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._bits: Any = rng.bit_generator
        self._form: Any = self._bits.state

    def save(self) -> bytes:
        """Return the state: 16 bytes, or 20 if half of a draw is left for the next one."""
        state = self._bits.state
        number: bytes = state["state"]["state"].to_bytes(16, "little")
        return number + state["uinteger"].to_bytes(4, "little") if state["has_uint32"] else number

    def load(self, data: bytes) -> None:
        """Take over a state."""
        form = self._form
        form["state"]["state"] = int.from_bytes(data[:16], "little")
        form["has_uint32"], form["uinteger"] = len(data) > 16, int.from_bytes(data[16:], "little")
        self._bits.state = form

    @staticmethod
    def check(data: bytes) -> None:
        """Raise ValueError if these bytes are no state of a random stream."""
        if len(data) not in (16, 20):
            raise ValueError(f"a random stream has 16 or 20 bytes, not {len(data)}")


record = msgpack.Encoder().encode
"""Encodes a typed record as bytes."""


def read_record(data: bytes, like: Any) -> Any:
    """Return a record of the type of another one, from bytes.

    Raises:
        ValueError: it has another type, or is outside the limits that the type declares.
    """
    return msgpack.decode(data, type=type(like))  # errors of msgspec are ValueErrors
