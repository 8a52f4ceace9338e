"""What a world keeps of each component, and what crosses its border in a tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from msgspec import Struct

from uwserver.actuators import Actuator
from uwserver.modifiers import Modifier
from uwserver.physics.shapes import Solid
from uwserver.ports import Call, Command, Event, Json, OnReply, Port, Reply, Sample, Service, Value
from uwserver.sensors import Sensor
from uwserver.vehicle import Vehicle


@dataclass(slots=True)
class SensorSlot:
    """A sensor in the world: when it is due, what it counted, its errors, and its last reading (valid, values) for when it freezes."""

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


@dataclass(slots=True)
class ActuatorSlot:
    """An actuator in the world: who commanded it last, and when it goes to neutral."""

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


Carry = Callable[[Mapping[str, Json]], Json]
"""What a service does; runs at the start of a tick."""


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One body of a world with all that belongs to it; it comes and goes as a whole.

    Attributes:
        vehicle: the body, also of a free object.
        sensors, actuators: its components.
        services: those of its components, and what they do.
        solid: its collision shapes; None for none.
    """

    vehicle: Vehicle
    sensors: tuple[SensorSlot, ...] = ()
    actuators: tuple[ActuatorSlot, ...] = ()
    services: tuple[tuple[Service, Carry], ...] = ()
    solid: Solid | None = None


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
    replies: list[tuple[OnReply, Reply]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
