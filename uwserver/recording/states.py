"""Where all bodies are, and who they are: the channels of a recording from which a run is shown again without physics.

``uwserver/states`` (message encoding ``uwserver-state``, little endian), at most `STATES_HZ` a second of simulation time and after each jump of
time; one message is

====  =========  ==========================================================================================================
 u32  revision   of the cast that it shows, as in ``uwserver/casts``
 u32  jumps      how often a reset or restore had set the time since the recording began
 u16  n          bodies: vehicles first, then objects, in the order of the cast
 u16  m          actuators of all vehicles
 i64  t_ns       simulation time
 f64  current    3: uniform part of the current, N, m/s
 f64  poses      n x 7: p_NB (m), q_NB (w x y z)
  i8  achieved   m: what each actuator achieves, of -127..127 (`uwserver.ports.ActuatorView` says of what)
====  =========  ==========================================================================================================

``uwserver/casts`` (JSON, `CastRecord`): who is in the world, and which ports and services there are, at the start and whenever that changes. Ports
and services are told as differences to the record before, so that a thousand bodies that come one by one need no million ports.

``uwserver/jumps`` (JSON, `uwserver.ports.Event`): the events ``reset`` once more, so that a reader finds the places where time was set, and knows
the n-th run between them, without reading the rest: what has ``jumps`` n belongs to it.

A message of states and casts may stand before samples of the same time in the file: they take a shorter way to it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, Final, Literal, TypeVar

import numpy as np
from msgspec import UNSET, Struct, UnsetType, structs

from uwserver.ports import Argument, Cast, Port, Present, SceneState, Service, WaterView

STATES: Final = "uwserver/states"
CASTS: Final = "uwserver/casts"
JUMPS: Final = "uwserver/jumps"
ENCODING: Final = "uwserver-state"
STATES_HZ: Final = 30.0
"""Most states a second of simulation time: as many as a page draws."""

T = TypeVar("T")

_HEAD = struct.Struct("<IIHHq3d")
_POSE = 7

LAYOUT: Final = (
    "little endian: u32 revision, u32 jumps, u16 n, u16 m, i64 t_ns, f64[3] current (N, m/s), "
    "f64[n][7] p_NB (m) and q_NB (w x y z) of each body of the cast, i8[m] what the actuators achieve of -127..127"
)
"""What the schema of the channel says."""


class Body(Struct, frozen=True):
    """Who is in the world: name, what of the scenario it is a copy of, and the name of the vehicle's file ("object" for none)."""

    name: str
    like: str
    model: str


class ArgumentRecord(Struct, frozen=True, omit_defaults=True):
    """A `uwserver.ports.Argument`, which has a recursive type that decoders do not know."""

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
        """The record of a service."""
        arguments = tuple(ArgumentRecord(**structs.asdict(argument)) for argument in service.arguments)
        return cls(service.path, service.doc, arguments, service.reads_only, service.long_running)

    @property
    def service(self) -> Service:
        """The service itself."""
        arguments = tuple(Argument(**structs.asdict(argument)) for argument in self.arguments)
        return Service(self.path, self.doc, arguments, self.reads_only, self.long_running)


class CastRecord(Struct, frozen=True, omit_defaults=True):
    """One message of ``uwserver/casts``.

    Attributes:
        revision: by which states name it.
        jumps: as of a state.
        tick, t_ns: behind which it holds.
        vehicles, objects: all of them, in the order of the states.
        ports, services: those that are new or others than before.
        ports_gone, services_gone: paths of those that are there no more.
        water: where it is not what it was.
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

    @property
    def cast(self) -> Cast:
        """As a `SceneState` names it."""
        vehicles, objects = (tuple(Present(b.name, b.like) for b in group) for group in (self.vehicles, self.objects))
        return Cast(self.revision, vehicles, objects)


class Presence(Struct, frozen=True):
    """Who and what was there after a tick, taken between two ticks; nothing in it changes later.

    Attributes:
        jumps: as of a state.
        models: name of the vehicle's file of each body.
        water: None where it is what it was.
    """

    cast: Cast
    jumps: int
    tick: int
    t_ns: int
    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    models: Mapping[str, str]
    water: WaterView | None = None

    def since(self, before: Presence | None) -> CastRecord:
        """The record of what has changed; all of it where there was none before."""
        ports, ports_gone = _changes({} if before is None else before.ports, self.ports)
        services, services_gone = _changes({} if before is None else before.services, self.services)
        bodies = [
            tuple(Body(b.name, b.like, self.models[b.name]) for b in group)
            for group in (self.cast.vehicles, self.cast.objects)
        ]
        return CastRecord(
            self.cast.revision, self.jumps, self.tick, self.t_ns, bodies[0], bodies[1],
            ports, ports_gone, tuple(map(ServiceRecord.of, services)), services_gone, UNSET if self.water is None else self.water,
        )  # fmt: skip


def _changes(before: Mapping[str, T], after: Mapping[str, T]) -> tuple[tuple[T, ...], tuple[str, ...]]:
    if before is after:
        return (), ()
    new = tuple(entry for path, entry in after.items() if before.get(path) is not entry)
    return new, tuple(path for path in before if path not in after)


class Seen(Struct, frozen=True):
    """Where all bodies are, and how often time had been set before."""

    jumps: int
    state: SceneState


def state_message(seen: Seen) -> bytes:
    """A state as a message of the channel."""
    state = seen.state
    head = _HEAD.pack(
        state.cast.revision, seen.jumps, len(state.poses), len(state.achieved), state.t_ns, *state.current
    )
    return b"".join((head, state.poses.astype("<f8").tobytes(), state.achieved.tobytes()))


def time_of_state(data: bytes) -> tuple[int, int]:
    """Jumps and time (ns) of a message of the channel; (0, 0) of one that is none."""
    if len(data) < _HEAD.size:
        return 0, 0
    _, jumps, _, _, t_ns, *_ = _HEAD.unpack_from(data)
    return jumps, t_ns


def read_state(data: bytes, casts: Mapping[int, Cast]) -> Seen:
    """A message of the channel read back.

    Args:
        data: of the message.
        casts: by revision.

    Raises:
        ValueError: it is not as long as it says, or of a cast that nobody has told.
    """
    if len(data) < _HEAD.size:
        raise ValueError(f"a state of {len(data)} bytes has no head")
    revision, jumps, bodies, actuators, t_ns, *current = _HEAD.unpack_from(data)
    end = _HEAD.size + bodies * _POSE * 8
    if len(data) != end + actuators:
        raise ValueError(f"a state of {bodies} bodies and {actuators} actuators has not {len(data)} bytes")
    cast = casts.get(revision)
    if cast is None or len(cast.vehicles) + len(cast.objects) != bodies:
        raise ValueError(f"a state of {bodies} bodies names the cast {revision}, which is not in the file")
    poses = np.frombuffer(data, "<f8", bodies * _POSE, _HEAD.size).reshape(bodies, _POSE)
    achieved = np.frombuffer(data, np.int8, actuators, end)
    return Seen(jumps, SceneState(cast, t_ns, poses, achieved, tuple(current)))
