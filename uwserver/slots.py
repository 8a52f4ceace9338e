"""What a world keeps of each component, and what crosses its border in a tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from msgspec import Struct

from uwserver.actuators import Actuator
from uwserver.autopilot.goal import Later
from uwserver.autopilot.pilot import Autopilot
from uwserver.modifiers import Measurement, Modifier
from uwserver.physics.shapes import Solid
from uwserver.ports import Call, Command, Event, Field, Json, OnReply, Port, Progress, Reply, Sample, Service, Value
from uwserver.sensors import Instrument, Scope, Sensor
from uwserver.sensors.wiring import Wiring
from uwserver.vehicle import Vehicle


@dataclass(slots=True)
class SensorSlot:
    """A sensor in the world: when it is due, what it counted, its errors, and its last reading (valid, values) for when it freezes or a
    compound sensor repeats it, with its time (ns); and the vehicle's inside."""

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

    @property
    def fields(self) -> tuple[Field, ...]:
        """Of the port."""
        return self.port.fields

    def set_interval(self, dt: float) -> None:
        """Tell the sensor and its errors the time (s) from one reading to the next."""
        if isinstance(self.sensor, Instrument):
            self.sensor.dt = dt
        for modifier in self.modifiers:
            modifier.stream.dt = dt

    def read(self, scope: Scope) -> Measurement | None:
        """A reading with its errors; None when the device has none to give."""
        if isinstance(self.sensor, Instrument):
            reading = self.sensor.sense(scope)
            if reading is None:
                return None
            reading.delay_ns += self.latency_ns
        else:
            valid, values = self.sensor.measure(scope)
            reading = Measurement(values, valid, self.latency_ns)
        for modifier in self.modifiers:
            modifier.apply(reading)
        return reading


@dataclass(slots=True)
class ActuatorSlot:
    """An actuator in the world: who commanded it last, when it goes to neutral, and why it takes no commands now ("" when it does)."""

    port: Port
    actuator: Actuator
    timeout_ticks: int
    active: bool = True
    last_tick: int = -1
    last_value: tuple[tuple[float, ...] | None, ...] = ()
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


class Posted(Struct):
    """A checked command or call that waits for the start of the next tick; `on_reply` gets the answer."""

    item: Command | Call
    on_reply: OnReply | None


@dataclass(slots=True)
class TickOutput:
    """What one tick gives to the outside."""

    tick: int
    t_ns: int
    samples: list[Sample]
    replies: list[tuple[OnReply, Reply | Progress]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
