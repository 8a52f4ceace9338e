"""The channels of a recording from which playback shows a run without physics: the poses of all bodies, and the list of bodies.

``uwserver/states`` (message encoding ``uwserver-state``, little endian) has at most `STATES_HZ` messages per second of simulation time, and one
after each jump of time. A message contains

====  =========  ==========================================================================================================
 u32  revision   revision of the list of bodies that it shows, as in ``uwserver/casts``
 u32  jumps      number of resets and restores, which set the time, since the recording began
 u16  n          number of bodies: vehicles first, then objects, in the order of the list
 u16  m          number of actuators of all vehicles
 i64  t_ns       simulation time
 f64  current    3: uniform part of the current, N, m/s
 f64  poses      n x 7: p_NB (m), q_NB (w x y z)
  i8  achieved   m: output of each actuator, in 127ths of the full output (see `uwserver.ports.ActuatorView`)
====  =========  ==========================================================================================================

``uwserver/casts`` (JSON, `EntityListRecord`) lists the bodies, ports and services of the world, at the start and at every change. Ports and services
are written as differences from the record before; otherwise a thousand bodies that are added one by one would cost a million ports.

``uwserver/jumps`` (JSON, `uwserver.ports.Event`) repeats the events ``reset``. A reader finds there the places where the time was set, without
reading the rest. What has n ``jumps`` belongs to the n-th run between them, counted from 0.

In the file, states and lists of bodies may come before samples of the same time, because they reach the writer sooner.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal, TypeVar

import numpy as np
from msgspec import UNSET, Struct, UnsetType, structs

from uwserver.ports import Argument, EntityList, Port, Present, SceneState, Service, WaterView

STATES: Final = "uwserver/states"
ENTITY_LISTS: Final = "uwserver/casts"
JUMPS: Final = "uwserver/jumps"
ENCODING: Final = "uwserver-state"
STATES_HZ: Final = 30.0
"""Largest number of states per second of simulation time: the number of frames that a page draws."""

T = TypeVar("T")

_HEAD = struct.Struct("<IIHHq3d")
_POSE = 7

LAYOUT: Final = (
    "little endian: u32 revision, u32 jumps, u16 n, u16 m, i64 t_ns, f64[3] current (N, m/s), "
    "f64[n][7] p_NB (m) and q_NB (w x y z) of each body of the cast, i8[m] what the actuators achieve of -127..127"
)
"""Text of the channel's schema."""


class Body(Struct, frozen=True):
    """A body in the world: its name, the entry of the scenario of which it is a copy, and the name of the vehicle file ("object" for none)."""

    name: str
    like: str
    model: str


class ArgumentRecord(Struct, frozen=True, omit_defaults=True):
    """A `uwserver.ports.Argument`. That class has a recursive type, which msgspec cannot decode."""

    name: str
    type: Literal["float", "int", "bool", "str", "json"]
    doc: str
    unit: str = "1"
    required: bool = True
    default: Any = None
    shape: tuple[int, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()


class ServiceRecord(Struct, frozen=True, omit_defaults=True):
    """A `uwserver.ports.Service`."""

    path: str
    doc: str
    arguments: tuple[ArgumentRecord, ...] = ()
    reads_only: bool = False
    long_running: bool = False

    @classmethod
    def of(cls, service: Service) -> ServiceRecord:
        """Return the record of a service."""
        arguments = tuple(ArgumentRecord(**structs.asdict(argument)) for argument in service.arguments)
        return cls(service.path, service.doc, arguments, service.reads_only, service.long_running)

    @property
    def service(self) -> Service:
        """Return the service."""
        arguments = tuple(Argument(**structs.asdict(argument)) for argument in self.arguments)
        return Service(self.path, self.doc, arguments, self.reads_only, self.long_running)


class EntityListRecord(Struct, frozen=True, omit_defaults=True):
    """One message of ``uwserver/casts``.

    Attributes:
        revision: number by which states name the list.
        jumps: as in a state.
        tick, t_ns: the list is valid from the end of this tick.
        vehicles, objects: all bodies, in the order of the states.
        ports, services: new and changed ones.
        ports_gone, services_gone: paths of removed ones.
        water: only if it changed.
    """

    revision: int
    jumps: int
    tick: int
    t_ns: int
    vehicles: tuple[Body, ...] = ()
    objects: tuple[Body, ...] = ()
    ports: tuple[Port, ...] = ()
    ports_gone: tuple[str, ...] = ()
    services: tuple[ServiceRecord, ...] = ()
    services_gone: tuple[str, ...] = ()
    water: WaterView | UnsetType = UNSET

    def renamed(self, rename: Callable[[str], str]) -> EntityListRecord:
        """Return a copy with renamed paths and names."""
        return structs.replace(
            self,
            vehicles=tuple(structs.replace(body, name=rename(body.name)) for body in self.vehicles),
            objects=tuple(structs.replace(body, name=rename(body.name)) for body in self.objects),
            ports=tuple(structs.replace(port, path=rename(port.path)) for port in self.ports),
            ports_gone=tuple(map(rename, self.ports_gone)),
            services=tuple(structs.replace(service, path=rename(service.path)) for service in self.services),
            services_gone=tuple(map(rename, self.services_gone)),
        )

    @property
    def entities(self) -> EntityList:
        """Return the list of bodies to which a `SceneState` refers."""
        vehicles, objects = (tuple(Present(b.name, b.like) for b in group) for group in (self.vehicles, self.objects))
        return EntityList(self.revision, vehicles, objects)


class Presence(Struct, frozen=True):
    """The bodies, ports and services after a tick. It is taken between two ticks, and nothing in it changes later.

    Attributes:
        jumps: as in a state.
        models: name of the vehicle file of each body.
        water: None if it did not change.
    """

    entities: EntityList
    jumps: int
    tick: int
    t_ns: int
    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    models: Mapping[str, str]
    water: WaterView | None = None

    def since(self, before: Presence | None) -> EntityListRecord:
        """Return the record of the changes since another presence; of everything without one."""
        ports, ports_gone = _changes({} if before is None else before.ports, self.ports)
        services, services_gone = _changes({} if before is None else before.services, self.services)
        vehicles, objects = (
            tuple(Body(b.name, b.like, self.models[b.name]) for b in group)
            for group in (self.entities.vehicles, self.entities.objects)
        )
        return EntityListRecord(
            self.entities.revision, self.jumps, self.tick, self.t_ns, vehicles, objects,
            ports, ports_gone, tuple(map(ServiceRecord.of, services)), services_gone, UNSET if self.water is None else self.water,
        )  # fmt: skip


def _changes(before: Mapping[str, T], after: Mapping[str, T]) -> tuple[tuple[T, ...], tuple[str, ...]]:
    if before is after:  # the usual case, and there may be thousands of ports
        return (), ()
    new = tuple(entry for path, entry in after.items() if before.get(path) is not entry)
    return new, tuple(path for path in before if path not in after)


class Seen(Struct, frozen=True):
    """The poses of all bodies, and the number of jumps of time before."""

    jumps: int
    state: SceneState


def state_message(seen: Seen) -> bytes:
    """Return a state as a message of the channel."""
    state = seen.state
    counts = len(state.poses), len(state.achieved)
    head = _HEAD.pack(state.entities.revision, seen.jumps, *counts, state.t_ns, *state.current)
    return b"".join((head, state.poses.astype("<f8").tobytes(), state.achieved.tobytes()))


def time_of_state(data: bytes) -> tuple[int, int]:
    """Return jumps and time (ns) of a message of the channel; (0, 0) for a damaged message."""
    if len(data) < _HEAD.size:
        return 0, 0
    _, jumps, _, _, t_ns, *_ = _HEAD.unpack_from(data)
    return jumps, t_ns


def read_state(data: bytes, entity_lists: Mapping[int, EntityList]) -> Seen:
    """Read a message of the channel.

    Args:
        data: the message.
        entity_lists: by revision.

    Raises:
        ValueError: the length is not what the head says, or the list of bodies is unknown.
    """
    if len(data) < _HEAD.size:
        raise ValueError(f"a state of {len(data)} bytes has no head")
    revision, jumps, bodies, actuators, t_ns, *current = _HEAD.unpack_from(data)
    end = _HEAD.size + bodies * _POSE * 8
    if len(data) != end + actuators:
        raise ValueError(f"a state of {bodies} bodies and {actuators} actuators cannot have {len(data)} bytes")
    entities = entity_lists.get(revision)
    if entities is None or len(entities.vehicles) + len(entities.objects) != bodies:
        raise ValueError(
            f"a state of {bodies} bodies refers to the list of bodies {revision}, which is not in the file"
        )
    poses = np.frombuffer(data, "<f8", bodies * _POSE, _HEAD.size).reshape(bodies, _POSE)
    achieved = np.frombuffer(data, np.int8, actuators, end)
    return Seen(jumps, SceneState(entities, t_ns, poses, achieved, tuple(current)))
