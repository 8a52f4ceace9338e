"""Services that the world itself answers; those of the clock belong to the simulation (`uwserver.simulation.thread`).

Reset and restore delay their tick by 0.1 ms for each vehicle of 24 ports that is there after it, and by 0.1 to 0.2 ms for each that comes or goes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction

import msgspec

from uwserver.actuators.base import LONGEST_TIMEOUT_S
from uwserver.ports import Argument, Json, Refused, Service
from uwserver.ports.checks import shown
from uwserver.world import snapshot
from uwserver.world.components import ActuatorSlot
from uwserver.world.part import Carry
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.snapshot import Snapshot
from uwserver.world.world import World

SENSOR_SERVICES = ("activate", "deactivate", "get", "set")
"""Names below each sensor that its further streams cannot have."""
MAX_SNAPSHOTS = 32
MAX_SNAPSHOT_NAME = 64
"""Characters."""


def offer_world_services(world: World) -> None:
    """Add reset, snapshot, restore, state_hash, set_current to a finished world; reset comes back to what it is now."""
    start = snapshot.take(world)
    saved: dict[str, Snapshot] = {}
    now = _Now(world)

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


class _Now:
    """The state of a world and its hash, each made once however many ask in a tick, until something may have changed (`Requests.changes`)."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._of = -1
        self._snapshot: Snapshot | None = None
        self._hash = ""

    def snapshot(self) -> Snapshot:
        """As `snapshot.take`."""
        if self._snapshot is None or self._of != self._world.requests.changes:
            self._snapshot, self._hash, self._of = snapshot.take(self._world), "", self._world.requests.changes
        return self._snapshot

    def hash(self) -> str:
        """Of the snapshot."""
        taken = self.snapshot()
        if not self._hash:
            self._hash = taken.hash()
        return self._hash


def component_services(
    world: World, sensors: Iterable[SensorSlot], actuators: Iterable[ActuatorSlot]
) -> Iterator[tuple[Service, Carry]]:
    """Services of the components of one body, and what they do."""
    for sensor in sensors:
        yield from _sensor_services(world, sensor.port.path, sensor)
    for actuator in actuators:
        yield from _actuator_services(world, actuator.port.path, actuator)


def _sensor_services(world: World, path: str, slot: SensorSlot) -> Iterator[tuple[Service, Carry]]:
    rate = Argument(
        "rate_hz", "float", "samples a second; divides the physics rate", "Hz", required=False, minimum=1e-3
    )

    def activate(active: bool) -> Json:
        slot.active = active
        world.follow_slots(f'"{path}" was switched')
        return None

    def get(_: Mapping[str, Json]) -> Json:
        return {
            "rate_hz": float(world.rate_hz / slot.divisor),
            "active": slot.active,
            "latency_s": slot.latency_ns / 1e9,
            **slot.sensor.properties(),
        }

    def change(args: Mapping[str, Json]) -> Json:
        given = {name: value for name, value in args.items() if value is not None}
        divisor = divisor_of(given.pop("rate_hz")) if "rate_hz" in given else slot.divisor
        slot.sensor.change(given)
        world.set_divisor(slot, divisor)
        return None

    def divisor_of(rate_hz: Json) -> int:
        wanted = Fraction(str(rate_hz))
        divisor = round(world.rate_hz / wanted) if wanted <= world.rate_hz else 0
        if divisor == 0 or abs(world.rate_hz / wanted - divisor) > Fraction(1, 10**9):
            legal = sorted({float(world.rate_hz / k) for k in (max(1, divisor - 1), max(1, divisor), divisor + 1)})
            text = f"{float(wanted):g} Hz does not divide the physics rate; near it are {', '.join(f'{r:g}' for r in legal)} Hz"
            raise Refused("bad_argument", text, "rate_hz")
        return divisor

    yield Service(f"{path}/activate", "Start measuring."), lambda _: activate(True)
    yield Service(f"{path}/deactivate", "Stop measuring."), lambda _: activate(False)
    yield Service(f"{path}/get", "Properties of the sensor."), get
    yield Service(f"{path}/set", "Change properties of the sensor.", (rate, *slot.sensor.arguments)), change


def _actuator_services(world: World, path: str, slot: ActuatorSlot) -> Iterator[tuple[Service, Carry]]:
    timeout = Argument(
        "timeout_s",
        "float",
        "watchdog: neutral after this long without a command; 0 for never",
        "s",
        minimum=0.0,
        maximum=LONGEST_TIMEOUT_S,
    )

    def activate(_: Mapping[str, Json]) -> Json:
        slot.active = True
        return None

    def deactivate(_: Mapping[str, Json]) -> Json:
        slot.active = False
        slot.actuator.neutral()
        slot.last_value = ()
        return None

    def get(_: Mapping[str, Json]) -> Json:
        value: dict[str, Json] = {
            field.name: list(part) if isinstance(part, tuple) else msgspec.to_builtins(part)
            for field, part in zip(slot.port.fields, slot.last_value, strict=False)
        }
        return {
            "active": slot.active,
            "timeout_s": float(slot.timeout_ticks / world.rate_hz),
            "value": value,
            "source": slot.source,
            "conflicts": slot.conflicts,
            "timeouts": slot.timeouts,
        }

    def set_timeout(args: Mapping[str, Json]) -> Json:
        world.set_timeout(slot, round(Fraction(str(args["timeout_s"])) * world.rate_hz))
        return None

    yield Service(f"{path}/activate", "Accept commands."), activate
    yield Service(f"{path}/deactivate", "Go to neutral and refuse commands."), deactivate
    yield Service(f"{path}/get", "Properties of the actuator and its last command."), get
    yield Service(f"{path}/set", "Change properties of the actuator.", (timeout,)), set_timeout
