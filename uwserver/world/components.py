"""What a world keeps of each component: sensors, actuators, and the bodies that carry them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Annotated, Any

from msgspec import Meta, Struct, structs

from uwserver.actuators import Actuator
from uwserver.modifiers import Modifier
from uwserver.modifiers.columns import Columns, columns_of
from uwserver.modifiers.operations import Operation
from uwserver.ports import Fault, Items, Port, Value
from uwserver.ports.checks import check_given
from uwserver.world.computing import Loose, settled
from uwserver.world.part import Part, State, read_record, record

Held = tuple[bool, tuple[Value, ...]] | None
"""A reading: whether it is valid, and its values; None before the first."""
NEVER = -(10**18)
"""A tick before all others."""
Tick = Annotated[int, Meta(ge=NEVER, le=2**62)]
Count = Annotated[int, Meta(ge=0, le=2**62)]
"""Limits of a state from outside, beyond which numbers could no longer be counted on and encoded."""


@dataclass(slots=True, eq=False)
class SensorStream:
    """A stream of samples: the sensor's own, or one more, with errors of its own; `ideal`: of what the device would read without any.

    Texts, pictures and other values that are no numbers are loose: they have no place in the arrays.

    Attributes:
        port: where its samples come out.
        modifiers: its errors.
        columns: which numbers of a row are which of its values.
        operations: its errors, where compiled code carries out all of them.
        is_ready_made: its readings are made in Python.
        fresh: loose values of the present reading.
        loose: of the last one that was not lost; empty before the first.
        coming: of those that are not delivered yet, by sequence number.
        newest: of the newest delivered sample.
    """

    port: Port
    modifiers: tuple[Modifier, ...] = ()
    ideal: bool = False
    columns: Columns = field(init=False)
    operations: tuple[Operation, ...] = field(init=False)
    is_ready_made: bool = field(init=False)
    fresh: Loose = ()
    loose: Loose = ()
    coming: dict[int, Loose] = field(default_factory=dict)
    newest: Loose = ()

    def __post_init__(self) -> None:
        self.columns = columns_of(self.port.fields)
        operations = tuple([m for m in self.modifiers if isinstance(m, Operation)])
        self.is_ready_made = len(operations) < len(self.modifiers)
        self.operations = () if self.is_ready_made else operations

    @property
    def kept(self) -> int:
        """How many numbers are kept of it: the last reading, and what its operations remember."""
        return self.columns.width + sum([len(operation.numbers) for operation in self.operations])


class SensorState(State, frozen=True, omit_defaults=True):
    """What one sensor remembers.

    Attributes:
        number: readings made; with it the random numbers go on.
        active, divisor: of the slot.
        settings, memory: of the sensor; empty where it has none.
        held: HELD of each stream (`uwserver.step.streams`), its own first.
        numbers: float64, of each stream the last reading, and what its operations remember.
        loose: of each stream the values of the last reading that are no numbers; empty where it has none.
        modifiers: memories of those modifiers whose streams are made in Python.
        pictures: in place of `loose` of a sensor that takes time.
    """

    number: Count
    active: bool
    divisor: Annotated[int, Meta(ge=1, le=2**32)]
    settings: bytes
    memory: bytes
    held: bytes
    numbers: bytes
    loose: tuple[tuple[Value, ...], ...]
    modifiers: tuple[bytes, ...]
    pictures: tuple[tuple[Value, ...], ...] = ()

    def deciding(self) -> SensorState:
        """Pictures follow from the rest, and may be under computation."""
        return structs.replace(self, pictures=()) if self.pictures else self

    def settled(self) -> SensorState:
        """With the pictures computed."""
        return structs.replace(self, pictures=computed(self.pictures))


def computed(pictures: Iterable[Loose]) -> tuple[tuple[Value, ...], ...]:
    """Values of pictures, some of which may be under computation."""
    return tuple([settled(loose) for loose in pictures])


class Sources(Struct, frozen=True):
    """Who commanded an actuator, who else did, and how often they disagreed or fell silent."""

    source: Annotated[str, Meta(max_length=4096)] = ""
    other_tick: Tick = NEVER
    conflicts: Count = 0
    timeouts: Count = 0


class ActuatorState(State, frozen=True):
    """What one actuator's slot remembers; where the device itself stands is in the bodies' arrays, or in the record `memory`."""

    active: bool
    timeout_ticks: Count
    last_tick: Tick
    last_value: Items
    memory: bytes
    sources: Sources

    def deciding(self) -> ActuatorState:
        """Who commanded does not change the run."""
        return structs.replace(self, sources=Sources())


@dataclass(slots=True, eq=False)
class ActuatorSlot(Part):
    """An actuator in the world: who commanded it last, when it goes to neutral, and why it takes no commands now ("" when it does)."""

    state_type = ActuatorState

    port: Port
    actuator: Actuator
    rate_hz: Fraction
    timeout_ticks: int
    active: bool = True
    last_tick: int = -1
    last_value: Items = ()
    source: str = ""
    other_tick: int = NEVER
    conflicts: int = 0
    timeouts: int = 0
    refusal: str = ""

    @property
    def path(self) -> str:
        """Of the port."""
        return self.port.path

    @property
    def takes_each(self) -> bool:
        """Whether every command counts, as of a modem: none replaces another, and two sources are no conflict."""
        return bool(getattr(self.actuator, "takes_each", False))

    def objection(self, value: Items) -> Fault | None:
        """Why the device takes no such value, though its fields allow it; None where it does. It changes nothing."""
        object_to: Callable[[Items], Fault | None] | None = getattr(self.actuator, "objection", None)
        return None if object_to is None else object_to(value)

    def set_timeout(self, ticks: int) -> None:
        """Set the watchdog; 0 ticks for none."""
        self.timeout_ticks = ticks
        self.port = structs.replace(self.port, timeout_s=float(ticks / self.rate_hz) or None)

    def save(self) -> ActuatorState:
        """All that it remembers."""
        memory = getattr(self.actuator, "memory", None)
        return ActuatorState(
            self.active,
            self.timeout_ticks,
            self.last_tick,
            self.last_value,
            b"" if memory is None else record(memory),
            Sources(self.source, self.other_tick, self.conflicts, self.timeouts),
        )

    def check(self, state: Any) -> None:
        """The last command fits the fields."""
        memory = getattr(self.actuator, "memory", None)
        if memory is not None:
            read_record(state.memory, memory)
        elif state.memory:
            raise ValueError("a memory of an actuator that has none")
        if state.last_value:
            check_given(self.port.fields, state.last_value)

    def load(self, state: ActuatorState) -> None:
        """Go on from there."""
        self.active, self.last_tick, self.last_value = state.active, state.last_tick, state.last_value
        if state.timeout_ticks != self.timeout_ticks:
            self.set_timeout(state.timeout_ticks)
        memory = getattr(self.actuator, "memory", None)
        if memory is not None:
            self.actuator.memory = read_record(state.memory, memory)  # type: ignore[attr-defined]  # those that remember
        by = state.sources
        self.source, self.other_tick = by.source, by.other_tick
        self.conflicts, self.timeouts = by.conflicts, by.timeouts
