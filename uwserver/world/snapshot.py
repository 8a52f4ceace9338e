"""The whole changeable state of a world as one immutable value: for reset, restore, and the hash that proves two runs equal."""

from __future__ import annotations

import hashlib
import heapq
from collections.abc import Iterable
from typing import Any

import numpy as np
from msgspec import Struct

from uwserver.autopilot.state import Saved as SavedPilot
from uwserver.environment.currents import GaussMarkov
from uwserver.modifiers import Modifier
from uwserver.physics.bodies import Saved
from uwserver.ports import Items, Refused, Sample, Value
from uwserver.sensors import Instrument, Settings
from uwserver.world.components import Member
from uwserver.world.faults import Entry
from uwserver.world.world import World

Memories = tuple[tuple[Any, tuple[float, ...]], ...]
"""Random stream and memory of each modifier of a stream."""


class SensorState(Struct, frozen=True):
    """What one sensor remembers: counters, its last reading, the random stream and memory of each modifier, those and the settings of an
    instrument, and of each further stream its last reading and its modifiers."""

    seq: int
    active: bool
    divisor: int
    held: tuple[bool, tuple[Value, ...]] | None
    held_ns: int
    modifiers: Memories
    instrument: tuple[Any, tuple[float, ...], Settings] | None
    sides: tuple[tuple[tuple[bool, tuple[Value, ...]] | None, Memories], ...]


class ActuatorState(Struct, frozen=True):
    """What one actuator slot remembers; the physical state is in the arrays."""

    active: bool
    timeout_ticks: int
    last_tick: int
    last_value: Items
    source: str
    other_tick: int
    conflicts: int
    timeouts: int


class Snapshot(Struct, frozen=True):
    """A world between two ticks. Commands and calls that are posted but not carried out are not part of it.

    `drifts` holds the random stream and the velocities of each drifting current.
    """

    tick: int
    members: tuple[Member, ...]
    rows: Saved
    current: tuple[float, float, float]
    drifts: tuple[tuple[Any, tuple[float, ...]], ...]
    sensors: dict[str, SensorState]
    actuators: dict[str, ActuatorState]
    pending: tuple[tuple[int, int, Sample], ...]
    pending_order: int
    watch: int | None
    faults: tuple[Entry, ...]
    pilots: dict[str, SavedPilot]

    def hash(self) -> str:
        """SHA-256 over everything that decides how the run goes on; equal in every clock mode and process, whoever commanded."""
        digest = hashlib.sha256()
        for bits in self.rows.bits():
            digest.update(bits)
        actuators = {path: (a.active, a.timeout_ticks, a.last_tick, a.last_value) for path, a in self.actuators.items()}
        water = (self.current, self.drifts)
        rest = (self.tick, water, self.sensors, actuators, self.pending, self.pending_order, self.watch, self.faults)
        digest.update(repr(rest).encode())
        if self.pilots:
            digest.update(repr(self.pilots).encode())
        return digest.hexdigest()


def _drifts(world: World) -> tuple[GaussMarkov, ...]:
    return () if world.water.sea is None else world.water.sea.drifts


def _memories(modifiers: Iterable[Modifier]) -> Memories:
    return tuple((m.stream.rng.bit_generator.state, tuple(m.memory)) for m in modifiers)


def _remember(modifiers: Iterable[Modifier], memories: Memories) -> None:
    for modifier, (stream, memory) in zip(modifiers, memories, strict=True):
        modifier.stream.rng.bit_generator.state = stream
        modifier.memory = list(memory)


def take(world: World) -> Snapshot:
    """The state of a world now."""
    return Snapshot(
        tick=world.tick,
        members=tuple(world.members.values()),
        rows=world.hydro.save(),
        current=world.water.current,
        drifts=tuple((drift.rng.bit_generator.state, tuple(drift.ends.flat)) for drift in _drifts(world)),
        sensors={
            path: SensorState(
                slot.seq,
                slot.active,
                slot.divisor,
                slot.held,
                slot.held_ns,
                _memories(slot.modifiers),
                (slot.sensor.rng.bit_generator.state, tuple(slot.sensor.memory), slot.sensor.settings)
                if isinstance(slot.sensor, Instrument)
                else None,
                tuple((side.held, _memories(side.modifiers)) for side in slot.sides),
            )
            for path, slot in world.sensors.items()
        },
        actuators={
            path: ActuatorState(
                slot.active,
                slot.timeout_ticks,
                slot.last_tick,
                slot.last_value,
                slot.source,
                slot.other_tick,
                slot.conflicts,
                slot.timeouts,
            )
            for path, slot in world.actuators.items()
        },
        pending=tuple(sorted(world.pending)),
        pending_order=world.pending_order,
        watch=world.commands.watch,
        faults=tuple(world.faults.entries.values()),
        pilots={name: pilot.save() for name, pilot in world.pilots.all.items()},
    )


def restore(world: World, snapshot: Snapshot) -> None:
    """Put a world back, bit for bit: bodies that came since are gone, and those that went are back.

    Raises:
        Refused: the snapshot is of another world, with other bodies or components.
    """
    own = all(member.vehicle.hydro is world.hydro for member in snapshot.members)
    alike = snapshot.sensors.keys() == world.sensors.keys() and snapshot.actuators.keys() == world.actuators.keys()
    if not own and not alike:
        raise Refused("bad_argument", "the snapshot is of a world with other vehicles or components", "name")
    world.jump(snapshot.tick)
    world.hydro.load(snapshot.rows)
    if own and tuple(world.members.values()) != snapshot.members:
        world.set_members(snapshot.members)
    for drift, (stream, ends) in zip(_drifts(world), snapshot.drifts, strict=True):
        drift.rng.bit_generator.state = stream
        drift.ends[...] = np.reshape(ends, drift.ends.shape)
    world.set_current(snapshot.current)
    for path, sensor in snapshot.sensors.items():
        slot = world.sensors[path]
        slot.seq, slot.active, slot.held, slot.held_ns = sensor.seq, sensor.active, sensor.held, sensor.held_ns
        world.set_divisor(slot, sensor.divisor)
        _remember(slot.modifiers, sensor.modifiers)
        for side, (held, memories) in zip(slot.sides, sensor.sides, strict=True):
            side.held = held
            _remember(side.modifiers, memories)
        if isinstance(slot.sensor, Instrument) and sensor.instrument is not None:
            slot.sensor.rng.bit_generator.state, kept, slot.sensor.settings = sensor.instrument
            slot.sensor.memory = list(kept)
    for path, saved_slot in snapshot.actuators.items():
        actuator = world.actuators[path]
        world.set_timeout(actuator, saved_slot.timeout_ticks)
        for name in ActuatorState.__struct_fields__:
            setattr(actuator, name, getattr(saved_slot, name))
    world.pending = list(snapshot.pending)
    heapq.heapify(world.pending)
    world.pending_order = snapshot.pending_order
    world.commands.watch = snapshot.watch
    world.faults.restore(snapshot.faults)
    for name, pilot in snapshot.pilots.items():
        world.pilots.all[name].load(pilot)
    world.schedule()
