"""What a world keeps of each component, and what crosses its border in a tick."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from uwserver.actuators import Actuator
from uwserver.autopilot.pilot import Autopilot
from uwserver.modifiers import Measurement, Modifier
from uwserver.physics.geometry.shapes import Solid
from uwserver.ports import Field, Items, Json, Port, Sample, Service, Value
from uwserver.ports.later import Later
from uwserver.sensors import Instrument, Scope, Sensor
from uwserver.sensors.instrument import blank
from uwserver.sensors.wiring import Wiring
from uwserver.world.vehicle import Vehicle


@dataclass(slots=True)
class SideStream:
    """One more stream of a sensor: its errors, its last reading, and the one on its way; `ideal` ones take that of the sensor's twin."""

    port: Port
    ideal: bool
    modifiers: tuple[Modifier, ...]
    held: tuple[bool, tuple[Value, ...]] | None = None
    reading: Measurement | None = None

    def take(self, raw: Measurement) -> None:
        """Make a reading of its own of what the device measured."""
        reading = self.reading = replace(raw, values=list(raw.values))
        for modifier in self.modifiers:
            modifier.apply(reading)


@dataclass(slots=True)
class SensorSlot:
    """A sensor in the world: when it is due, what it counted, its errors, and its last reading (valid, values) for when it freezes or a
    compound sensor repeats it, with its time (ns); the vehicle's inside; its further streams, and the instrument without errors that the
    ideal ones read."""

    port: Port
    row: int
    sensor: Sensor
    modifiers: tuple[Modifier, ...]
    divisor: int
    latency_ns: int
    seq: int = 0
    active: bool = True
    fault: Literal["", "frozen", "silent"] = ""
    held: tuple[bool, tuple[Value, ...]] | None = None
    held_ns: int = 0
    wiring: Wiring | None = None
    sides: tuple[SideStream, ...] = ()
    twin: Instrument | None = None

    @property
    def fields(self) -> tuple[Field, ...]:
        """Of the port."""
        return self.port.fields

    @property
    def listens(self) -> bool:
        """Whether the sensor may have to measure between two readings; `is_called` tells when."""
        return isinstance(self.sensor, Instrument) and self.sensor.listens

    def is_called(self, now: float) -> bool:
        """Whether it has to measure now (s), whatever its rate."""
        wake = self.sensor.wake if isinstance(self.sensor, Instrument) else None
        return wake is not None and wake <= now + 1e-9

    def set_interval(self, dt: float) -> None:
        """Tell the sensor and its errors the time (s) from one reading to the next."""
        for instrument in (self.sensor, self.twin):
            if isinstance(instrument, Instrument):
                instrument.dt = dt
        for stream in self.streams():
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
        if isinstance(self.sensor, Instrument):
            reading = self.sensor.sense(scope)
            if reading is None:
                return None
            reading.delay_ns += self.latency_ns
        else:
            valid, values = self.sensor.measure(scope)
            reading = Measurement(values, valid, self.latency_ns)
        reading.t_ns = scope.t_ns - reading.since_ns
        for side in self.sides:
            side.take(reading if exact is None or not side.ideal else replace(reading, valid=exact[0], values=exact[1]))
        for modifier in self.modifiers:
            modifier.apply(reading)
        return reading

    def _exact(self, twin: Instrument, scope: Scope) -> tuple[bool, list[Value]]:
        """What the twin makes of this instant; before the device itself reads, which may change what both look at."""
        assert isinstance(self.sensor, Instrument)
        twin.settings = self.sensor.settings
        if twin.paces:
            twin.memory = list(self.sensor.memory)
        reading = twin.sense(scope if scope.wiring is None else replace(scope, wiring=scope.wiring.unfed()))
        return (False, blank(twin.fields)) if reading is None else (reading.valid, reading.values)


@dataclass(slots=True)
class ActuatorSlot:
    """An actuator in the world: who commanded it last, when it goes to neutral, and why it takes no commands now ("" when it does)."""

    port: Port
    actuator: Actuator
    timeout_ticks: int
    active: bool = True
    last_tick: int = -1
    last_value: Items = ()
    source: str = ""
    other_tick: int = -(10**18)
    conflicts: int = 0
    timeouts: int = 0
    refusal: str = ""


Carry = Callable[[Mapping[str, Json]], Json | Later]
"""What a service does; runs at the start of a tick. A long-running one gives its answers later."""


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One body of a world with all that belongs to it; it comes and goes as a whole.

    Attributes:
        vehicle: the body, also of a free object.
        sensors, actuators: its components.
        services: those of its components, and what they do.
        solid: its collision shapes; None for none.
        autopilot: None for none.
    """

    vehicle: Vehicle
    sensors: tuple[SensorSlot, ...] = ()
    actuators: tuple[ActuatorSlot, ...] = ()
    services: tuple[tuple[Service, Carry], ...] = ()
    solid: Solid | None = None
    autopilot: Autopilot | None = None
