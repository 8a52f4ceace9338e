"""What a world keeps of each component: sensors, actuators, and the bodies that carry them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Annotated, Any, Literal, NamedTuple

from msgspec import Meta, Struct, msgpack, structs

from uwserver.actuators import Actuator
from uwserver.modifiers import Measurement, Modifier
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Solid
from uwserver.ports import Field, Items, Port, Sample, Service, Value
from uwserver.ports.checks import check_given, check_values
from uwserver.sensors import Scope, Sensor
from uwserver.sensors.base import blank
from uwserver.sensors.wiring import Wiring
from uwserver.world.part import Carry, Part, RandomStream, State, is_awake, read_record, record
from uwserver.world.vehicle import Vehicle

Held = tuple[bool, tuple[Value, ...]] | None
"""A reading: whether it is valid, and its values; None before the first."""
NEVER = -(10**18)
"""A tick before all others."""
Tick = Annotated[int, Meta(ge=NEVER, le=2**62)]
Count = Annotated[int, Meta(ge=0, le=2**62)]
"""Limits of a state from outside, beyond which numbers could no longer be counted on and encoded."""


@dataclass(slots=True)
class SideStream:
    """One more stream of a sensor: its errors, its last reading, and the one on its way; `ideal` ones take that of the sensor's twin."""

    port: Port
    ideal: bool
    modifiers: tuple[Modifier, ...]
    held: Held = None
    reading: Measurement | None = None

    def take(self, raw: Measurement) -> None:
        """Make a reading of its own of what the device measured."""
        reading = self.reading = replace(raw, values=list(raw.values))
        for modifier in self.modifiers:
            modifier.apply(reading)


class SensorState(State, frozen=True):
    """What one sensor remembers.

    Attributes:
        seq, active, divisor, held, held_ns: of the slot.
        records: settings and memory of the sensor, then the memory of each modifier of each stream; of those that have any.
        draws: random streams of the sensor and of each modifier; of those that draw.
        sides: last reading of each further stream.
    """

    seq: Count
    active: bool
    divisor: Annotated[int, Meta(ge=1, le=2**32)]
    held: Held
    held_ns: Count
    records: tuple[bytes, ...]
    draws: tuple[bytes, ...]
    sides: tuple[Held, ...]


class _Kept(NamedTuple):
    """What is kept of a sensor beside its slot: its records (owner, name and decoder of each), and its random streams."""

    records: tuple[tuple[Any, str, msgpack.Decoder[Any]], ...]
    draws: tuple[RandomStream, ...]


@dataclass(slots=True, eq=False)
class SensorSlot(Part):
    """A sensor in the world: when it is due, what it counted, its errors, and its last reading (valid, values) for when it freezes or a
    compound sensor repeats it, with its time (ns); the vehicle's inside; its further streams, and the instrument without errors that the
    ideal ones read."""

    state_type = SensorState

    port: Port
    row: int
    sensor: Sensor
    modifiers: tuple[Modifier, ...]
    rate_hz: Fraction
    divisor: int
    latency_ns: int
    seq: int = 0
    active: bool = True
    fault: Literal["", "frozen", "silent"] = ""
    held: Held = None
    held_ns: int = 0
    wiring: Wiring | None = None
    sides: tuple[SideStream, ...] = ()
    twin: Sensor | None = None
    _known: _Kept | None = None

    @property
    def path(self) -> str:
        """Of the port."""
        return self.port.path

    @property
    def fields(self) -> tuple[Field, ...]:
        """Of the port."""
        return self.port.fields

    def is_called(self, now: float) -> bool:
        """Whether it has to measure now (s), whatever its rate."""
        wake = self.sensor.wake
        return wake is not None and wake <= now + 1e-9

    def set_divisor(self, divisor: int) -> None:
        """Measure every `divisor` ticks from now on; the sensor and its errors learn the time from one reading to the next."""
        self.divisor = divisor
        dt = float(divisor / self.rate_hz)
        self.sensor.dt = dt
        if self.twin is not None:
            self.twin.dt = dt
        for stream in self.streams():
            stream.port = structs.replace(stream.port, rate_hz=float(self.rate_hz / divisor))
            for modifier in stream.modifiers:
                modifier.stream.dt = dt

    def streams(self) -> Iterator[SensorSlot | SideStream]:
        """The sensor's own, then the others."""
        yield self
        yield from self.sides

    def samples(self, scope: Scope) -> list[Sample]:
        """What all streams tell of one reading; none when the device has none to give. What is frozen repeats itself."""
        reading = self.read(scope)
        if reading is None:
            return []
        seq, self.seq = self.seq, self.seq + 1
        told = [] if reading.dropped else [self._told(self, seq, reading)]
        if told:
            self.held_ns = reading.t_ns
        told += [
            self._told(side, seq, side.reading)
            for side in self.sides
            if side.reading is not None and not side.reading.dropped
        ]
        return told

    def _told(self, stream: SensorSlot | SideStream, seq: int, reading: Measurement) -> Sample:
        if not self.fault or stream.held is None:
            stream.held = reading.valid, tuple(reading.values)
        stamp_ns = max(0, reading.t_ns + reading.stamp_ns)
        return Sample(stream.port.path, seq, stamp_ns, reading.t_ns + reading.delay_ns, *stream.held)

    def read(self, scope: Scope) -> Measurement | None:
        """A reading with its errors; None when the device has none to give. The side streams then have theirs too."""
        exact = None if self.twin is None else self._exact(self.twin, scope)
        reading = self.sensor.sense(scope)
        if reading is None:
            return None
        reading.delay_ns += self.latency_ns
        reading.t_ns = scope.t_ns - reading.since_ns
        for side in self.sides:
            side.take(reading if exact is None or not side.ideal else replace(reading, valid=exact[0], values=exact[1]))
        for modifier in self.modifiers:
            modifier.apply(reading)
        return reading

    def _exact(self, twin: Sensor, scope: Scope) -> tuple[bool, list[Value]]:
        """What the twin makes of this instant; before the device itself reads, which may change what both look at."""
        twin.settings = self.sensor.settings
        if twin.paces:
            twin.memory = copy(self.sensor.memory)
        reading = twin.sense(scope if scope.wiring is None else replace(scope, wiring=scope.wiring.unfed()))
        return (False, blank(twin.fields)) if reading is None else (reading.valid, reading.values)

    def save(self) -> SensorState:
        """All that it remembers."""
        kept = self._kept()
        return SensorState(
            self.seq,
            self.active,
            self.divisor,
            self.held,
            self.held_ns,
            tuple([record(getattr(owner, name)) for owner, name, _ in kept.records]),
            tuple([stream.save() for stream in kept.draws]),
            tuple([side.held for side in self.sides]) if self.sides else (),
        )

    def check(self, state: Any) -> None:
        """The records are of its kinds, and readings fit their fields."""
        kept = self._kept()
        if tuple(map(len, (state.records, state.draws, state.sides))) != (*map(len, kept), len(self.sides)):
            raise ValueError("other modifiers or streams than this sensor has")
        for data in state.draws:
            RandomStream.check(data)
        for (owner, _, decoder), data in zip(kept.records, state.records, strict=True):
            owner.valid(decoder.decode(data))
        for stream, held in zip(self.streams(), (state.held, *state.sides), strict=True):
            if held is not None:
                check_values(stream.port.fields, held[1])

    def load(self, state: SensorState) -> None:
        """Go on from there; the twin follows by itself."""
        self.seq, self.active, self.held, self.held_ns = state.seq, state.active, state.held, state.held_ns
        if state.divisor != self.divisor:
            self.set_divisor(state.divisor)
        kept = self._kept()
        for (owner, name, decoder), data in zip(kept.records, state.records, strict=True):
            setattr(owner, name, decoder.decode(data))
        for stream, data in zip(kept.draws, state.draws, strict=True):
            stream.load(data)
        for side, held in zip(self.sides, state.sides, strict=True):
            side.held = held

    def _kept(self) -> _Kept:
        """Found once: which records and streams there are never changes."""
        if self._known is None:
            sensor, modifiers = self.sensor, [m for stream in self.streams() for m in stream.modifiers]
            owned = [(sensor, "settings"), (sensor, "memory"), *((modifier, "memory") for modifier in modifiers)]
            kinds = [(owner, name, type(getattr(owner, name))) for owner, name in owned]
            records = tuple((owner, name, msgpack.Decoder(t)) for owner, name, t in kinds if t.__struct_fields__)
            draws = [sensor.rng] if sensor.draws else []
            draws += [modifier.stream.rng for modifier in modifiers if modifier.draws]
            self._known = _Kept(records, tuple(map(RandomStream, draws)))
        return self._known


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


class ByPath(NamedTuple):
    """What belongs to a body, by path; and those of its parts that act or hear."""

    awake: tuple[Part, ...]
    sensors: dict[str, SensorSlot]
    actuators: dict[str, ActuatorSlot]
    parts: dict[str, Part]
    services: dict[str, Service]
    carry: dict[str, Carry]


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One body of a world with all that belongs to it; it comes and goes as a whole.

    Attributes:
        vehicle: the body, also of a free object.
        sensors, actuators: its components.
        services: those of its components, and what they do.
        solid: its collision shapes; None for none.
        others: whatever else lives and goes with it, as an autopilot.
        by_path: all of it; made once, as bodies come and go within a tick.
    """

    vehicle: Vehicle
    sensors: tuple[SensorSlot, ...] = ()
    actuators: tuple[ActuatorSlot, ...] = ()
    services: tuple[tuple[Service, Carry], ...] = ()
    solid: Solid | None = None
    others: tuple[Part, ...] = ()
    by_path: ByPath = field(init=False, repr=False)

    def __post_init__(self) -> None:
        by_path = ByPath(
            tuple(part for part in self.parts if is_awake(part)),
            {slot.port.path: slot for slot in self.sensors},
            {slot.port.path: slot for slot in self.actuators},
            {part.path: part for part in self.parts},
            {service.path: service for service, _ in self.services},
            {service.path: carry for service, carry in self.services},
        )
        object.__setattr__(self, "by_path", by_path)

    @property
    def parts(self) -> tuple[Part, ...]:
        """All that comes and goes with the body."""
        return (*self.sensors, *self.actuators, *self.others)


class Population(Part):
    """Who is in the world: the part that knows how bodies and their components are made."""

    @abstractmethod
    def is_here(self, state: Any) -> bool:
        """Whether the bodies of a state are those of the world now."""

    @abstractmethod
    def parts_of(self, state: Any) -> set[str]:
        """Paths of the parts that the bodies of a checked state have; makes none of these bodies."""

    @abstractmethod
    def params_of(self, state: Any) -> Sequence[BodyParams]:
        """What their rows are made of, also of those that are gone; likewise."""

    @abstractmethod
    def members_of(self, state: Any) -> list[Member]:
        """The bodies of a checked state, those that are there already as they are. All rows are made anew."""

    @abstractmethod
    def admit(self, state: Any, members: Iterable[Member]) -> None:
        """Let the bodies of a state be in the world, and no others."""
