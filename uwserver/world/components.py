"""What a world keeps for each component: the streams and states of sensors, and the slots of actuators."""

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
from uwserver.world.computing import Loose, wait_for_values
from uwserver.world.part import Part, State, read_record, record

Held = tuple[bool, tuple[Value, ...]] | None
"""The last reading: whether it is valid, and its values. None before the first reading."""
NEVER = -(10**18)
"""A tick before all others."""
Tick = Annotated[int, Meta(ge=NEVER, le=2**62)]
Count = Annotated[int, Meta(ge=0, le=2**62)]
"""The limits of numbers in a state from outside. Larger numbers could not be counted up or encoded."""


@dataclass(slots=True, eq=False)
class SensorStream:
    """A stream of samples of one sensor, with its own errors.

    Values that are no numbers (texts, pictures) have no place in the arrays and are called loose.

    Attributes:
        port: the port at which the samples are delivered.
        modifiers: the errors of the stream, in their order.
        ideal: whether the stream starts from the values that the device would read without any errors.
        columns: which numbers of a row belong to which field.
        operations: the errors, if compiled code makes all of them; else empty.
        is_ready_made: whether Python makes the readings, because an error is written in Python.
        fresh: loose values of the present reading.
        loose: loose values of the last reading that was not lost; empty before the first.
        coming: loose values of samples that are not delivered yet, by sequence number.
        newest: loose values of the newest delivered sample.
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
        """How many numbers a state keeps of this stream: those of the last reading, and the memory of its operations."""
        return self.columns.width + sum([len(operation.numbers) for operation in self.operations])


class SensorState(State, frozen=True, omit_defaults=True):
    """The state of one sensor.

    Attributes:
        number: number of readings made; it also decides which random numbers come next.
        active, divisor: of the slot.
        settings, memory: of the sensor, as msgpack; empty if it has none.
        held: HELD of each stream (`uwserver.step.streams`), the sensor's own stream first.
        numbers: float64 of each stream: the last reading, then the memory of its operations.
        loose: of each stream the values of the last reading that are no numbers; empty if it has none.
        modifiers: memories of the modifiers of streams whose readings are made in Python.
        pictures: stands in place of `loose` for a sensor that takes time.
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
        """Leave the pictures out: they follow from the other values, and may still be under computation."""
        return structs.replace(self, pictures=()) if self.pictures else self

    def completed(self) -> SensorState:
        """Wait for the pictures, and put them in."""
        return structs.replace(self, pictures=computed(self.pictures))


def computed(pictures: Iterable[Loose]) -> tuple[tuple[Value, ...], ...]:
    """Wait for pictures under computation. Returns the values of all pictures."""
    return tuple([wait_for_values(loose) for loose in pictures])


class CommandHistory(Struct, frozen=True):
    """Which source commanded an actuator, when another source did so, and how many conflicts and time-outs there were."""

    source: Annotated[str, Meta(max_length=4096)] = ""
    other_tick: Tick = NEVER
    conflicts: Count = 0
    timeouts: Count = 0


class ActuatorState(State, frozen=True):
    """The state of one actuator's slot. The state of the device is in the arrays of the bodies, or in `memory`."""

    active: bool
    timeout_ticks: Count
    last_tick: Tick
    last_value: Items
    memory: bytes
    sources: CommandHistory

    def deciding(self) -> ActuatorState:
        """Leave the sources out: they do not change the run."""
        return structs.replace(self, sources=CommandHistory())


@dataclass(slots=True, eq=False)
class ActuatorSlot(Part):
    """An actuator in the world: its last command, the source of that command, and its watchdog.

    Attributes:
        timeout_ticks: ticks without a command after which the actuator goes to neutral; 0 for never.
        last_tick, last_value, source: of the last command.
        other_tick: last tick in which two sources were in conflict.
        refusal: why the actuator takes no commands at present; "" if it does.
    """

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
        """Path of the port."""
        return self.port.path

    @property
    def takes_each(self) -> bool:
        """Whether every command counts, as for a modem: no command replaces another, and two sources are not in conflict."""
        return bool(getattr(self.actuator, "takes_each", False))

    def objection(self, value: Items) -> Fault | None:
        """Return why the device refuses a value that its fields allow; None if it does not refuse. Changes nothing."""
        object_to: Callable[[Items], Fault | None] | None = getattr(self.actuator, "objection", None)
        return None if object_to is None else object_to(value)

    def set_timeout(self, ticks: int) -> None:
        """Set the time-out of the watchdog; 0 ticks for none."""
        self.timeout_ticks = ticks
        self.port = structs.replace(self.port, timeout_s=float(ticks / self.rate_hz) or None)

    def save(self) -> ActuatorState:
        """Return the state of the slot."""
        memory = getattr(self.actuator, "memory", None)
        return ActuatorState(
            self.active,
            self.timeout_ticks,
            self.last_tick,
            self.last_value,
            b"" if memory is None else record(memory),
            CommandHistory(self.source, self.other_tick, self.conflicts, self.timeouts),
        )

    def check(self, state: Any) -> None:
        """Raise ValueError if the state is not of this actuator: another kind of memory, or a last command that does not fit the fields."""
        memory = getattr(self.actuator, "memory", None)
        if memory is not None:
            read_record(state.memory, memory)
        elif state.memory:
            raise ValueError("it has a memory, and this actuator has none")
        if state.last_value:
            check_given(self.port.fields, state.last_value)

    def load(self, state: ActuatorState) -> None:
        """Take over a checked state."""
        self.active, self.last_tick, self.last_value = state.active, state.last_tick, state.last_value
        if state.timeout_ticks != self.timeout_ticks:
            self.set_timeout(state.timeout_ticks)
        memory = getattr(self.actuator, "memory", None)
        if memory is not None:
            self.actuator.memory = read_record(state.memory, memory)  # type: ignore[attr-defined]  # those that remember
        by = state.sources
        self.source, self.other_tick = by.source, by.other_tick
        self.conflicts, self.timeouts = by.conflicts, by.timeouts
