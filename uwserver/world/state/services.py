"""The services of the world itself. Those of the clock belong to the simulation (`uwserver.simulation.thread`).

Reset and restore delay their tick by 0.1 ms for each vehicle of 24 ports that stays, and by 0.1 to 0.2 ms for each that is added or
removed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import msgspec

from uwserver.actuators.base import LONGEST_TIMEOUT_S
from uwserver.ports import Argument, Json, Refused, Service
from uwserver.ports.checks import shown
from uwserver.world.parts.part import Carry
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.state import snapshot
from uwserver.world.state.snapshot import Snapshot
from uwserver.world.stepping.commands import ActuatorSlot
from uwserver.world.world import World

SENSOR_SERVICES = ("activate", "deactivate", "get", "set")
"""Names of the services below each sensor. Its further streams cannot have these names."""
MAX_SNAPSHOTS = 32
MAX_SNAPSHOT_NAME = 64
"""Characters."""
_RATE = Argument("rate_hz", "float", "samples a second; divides the physics rate", "Hz", required=False, minimum=1e-3)
_TIMEOUT = Argument(
    "timeout_s", "float", "watchdog: neutral after this long without a command; 0 for never", "s", minimum=0.0,
    maximum=LONGEST_TIMEOUT_S,
)  # fmt: skip


def offer_world_services(world: World) -> None:
    """Add reset, snapshot, restore, state_hash and set_current to a finished world. Reset returns to the present state."""
    start = snapshot.take(world)
    saved: dict[str, Snapshot] = {}
    now = _PresentState(world)

    def reset(_: Mapping[str, Json]) -> Json:
        snapshot.restore(world, start)
        world.say("reset", "the world is back at its start")
        return None

    def take(args: Mapping[str, Json]) -> Json:
        name = str(args["name"])
        if len(name) > MAX_SNAPSHOT_NAME:
            text = f"the name of a snapshot has at most {MAX_SNAPSHOT_NAME} characters, not {len(name)}"
            raise Refused("out_of_range", text, "name")
        if name not in saved and len(saved) >= MAX_SNAPSHOTS:
            raise Refused("busy", f"there are {MAX_SNAPSHOTS} snapshots already: take one under a used name", "name")
        saved[name] = now.snapshot()
        return {"name": name, "hash": now.hash()}

    def restore(args: Mapping[str, Json]) -> Json:
        name = str(args["name"])
        if name not in saved:
            raise Refused(
                "bad_argument", f'no snapshot "{shown(name)}", there are: {", ".join(saved) or "none"}', "name"
            )
        snapshot.restore(world, saved[name])
        world.say("reset", f'the world is at its snapshot "{name}"')
        return {"tick": world.tick, "t_ns": world.t_ns}

    def state_hash(_: Mapping[str, Json]) -> Json:
        return {"tick": world.tick, "hash": now.hash()}

    def set_current(args: Mapping[str, Json]) -> Json:
        world.set_current(tuple(args["velocity_N"]))  # type: ignore[arg-type]  # three floats, checked against the argument
        return None

    name = Argument("name", "str", "name of the snapshot", required=False, default="default")
    velocity = Argument("velocity_N", "float", "water velocity in N", "m/s", shape=(3,), minimum=-20.0, maximum=20.0)
    world.offer(
        Service(
            "world/reset",
            "Put everything back to the start of the scenario: time, state, random streams, counters. "
            "In real time its tick is late by some 0.1 ms for each vehicle.",
        ),
        reset,
    )
    world.offer(Service("world/snapshot", "Keep the whole state under a name, in memory.", (name,)), take)
    world.offer(Service("world/restore", "Go back to a snapshot, bit for bit.", (name,)), restore)
    world.offer(Service("world/state_hash", "SHA-256 of the whole state; equal for equal runs."), state_hash)
    world.offer(
        Service(
            "world/set_current",
            "Set the uniform, steady part of the current; profiles and drifting currents go on.",
            (velocity,),
        ),
        set_current,
    )


class _PresentState:
    """The present state of a world and its hash. Each is made only once, until something may have changed (`Requests.changes`)."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._of = -1
        self._snapshot: Snapshot | None = None
        self._hash = ""

    def snapshot(self) -> Snapshot:
        """Return the state, as `snapshot.take`."""
        if self._snapshot is None or self._of != self._world.requests.changes:
            self._snapshot, self._hash, self._of = snapshot.take(self._world), "", self._world.requests.changes
        return self._snapshot

    def hash(self) -> str:
        """Return the hash of the state."""
        taken = self.snapshot()
        if not self._hash:
            self._hash = taken.hash()
        return self._hash


def component_services(
    world: World, sensors: Iterable[SensorSlot], actuators: Iterable[ActuatorSlot]
) -> Iterator[tuple[Service, Carry]]:
    """Yield the services of the components of one body, each with its function."""
    for sensor in sensors:
        yield from _SensorServices(world, sensor).services()
    for actuator in actuators:
        yield from _ActuatorServices(world, actuator).services()


# A hundred vehicles have thousands of services. Methods of one small object take a third of the memory of functions made for each service.
@dataclass(slots=True, eq=False)
class _SensorServices:
    """The services of a sensor."""

    world: World
    slot: SensorSlot

    def services(self) -> Iterator[tuple[Service, Carry]]:
        path = self.slot.port.path
        yield Service(f"{path}/activate", "Start measuring."), self.activate
        yield Service(f"{path}/deactivate", "Stop measuring."), self.deactivate
        yield Service(f"{path}/get", "Properties of the sensor."), self.get
        arguments = _RATE, *self.slot.sensor.arguments
        yield Service(f"{path}/set", "Change properties of the sensor.", arguments), self.change

    def activate(self, _: Mapping[str, Json]) -> Json:
        return self._switch(True)

    def deactivate(self, _: Mapping[str, Json]) -> Json:
        return self._switch(False)

    def _switch(self, active: bool) -> Json:
        self.slot.active = active
        self.world.follow_slots(f'"{self.slot.port.path}" was switched')
        return None

    def get(self, _: Mapping[str, Json]) -> Json:
        slot = self.slot
        return {
            "rate_hz": float(self.world.rate_hz / slot.divisor),
            "active": slot.active,
            "latency_s": slot.latency_ns / 1e9,
            **slot.sensor.properties(),
        }

    def change(self, args: Mapping[str, Json]) -> Json:
        given = {name: value for name, value in args.items() if value is not None}
        divisor = self._divisor_of(given.pop("rate_hz")) if "rate_hz" in given else self.slot.divisor
        self.slot.change(given)
        if self.slot.divisor != divisor:
            self.slot.set_divisor(divisor)
            self.world.follow_slots(f'"{self.slot.path}" was changed')
        return None

    def _divisor_of(self, rate_hz: Json) -> int:
        wanted, rate = Fraction(str(rate_hz)), self.world.rate_hz
        divisor = round(rate / wanted) if wanted <= rate else 0
        if divisor == 0 or abs(rate / wanted - divisor) > Fraction(1, 10**9):
            legal = sorted({float(rate / k) for k in (max(1, divisor - 1), max(1, divisor), divisor + 1)})
            text = f"{float(wanted):g} Hz does not divide the physics rate; near it are {', '.join(f'{r:g}' for r in legal)} Hz"
            raise Refused("bad_argument", text, "rate_hz")
        return divisor


@dataclass(slots=True, eq=False)
class _ActuatorServices:
    """The services of an actuator."""

    world: World
    slot: ActuatorSlot

    def services(self) -> Iterator[tuple[Service, Carry]]:
        path = self.slot.port.path
        yield Service(f"{path}/activate", "Accept commands."), self.activate
        yield Service(f"{path}/deactivate", "Go to neutral and refuse commands."), self.deactivate
        yield Service(f"{path}/get", "Properties of the actuator and its last command."), self.get
        yield Service(f"{path}/set", "Change properties of the actuator.", (_TIMEOUT,)), self.set_timeout

    def activate(self, _: Mapping[str, Json]) -> Json:
        self.slot.active = True
        return None

    def deactivate(self, _: Mapping[str, Json]) -> Json:
        self.slot.active = False
        self.slot.actuator.neutral()
        self.slot.last_value = ()
        return None

    def get(self, _: Mapping[str, Json]) -> Json:
        slot = self.slot
        value: dict[str, Json] = {
            field.name: list(part) if isinstance(part, tuple) else msgspec.to_builtins(part)
            for field, part in zip(slot.port.fields, slot.last_value, strict=False)
        }
        return {
            "active": slot.active,
            "timeout_s": float(slot.timeout_ticks / self.world.rate_hz),
            "value": value,
            "source": slot.source,
            "conflicts": slot.conflicts,
            "timeouts": slot.timeouts,
        }

    def set_timeout(self, args: Mapping[str, Json]) -> Json:
        ticks = round(Fraction(str(args["timeout_s"])) * self.world.rate_hz)
        if self.slot.timeout_ticks != ticks:
            self.slot.set_timeout(ticks)
            self.world.follow_slots(f'"{self.slot.path}" was changed')
        return None
