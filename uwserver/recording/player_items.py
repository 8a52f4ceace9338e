"""The parts of a recording during playback: places in the file, runs between jumps of time, scenes, marks, and items in the order of time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

from uwserver.ports import EntityList, Event, Port, Service, WaterView
from uwserver.recording.player_file import McapMessage
from uwserver.recording.states import Body

Type = Literal["sample", "event", "jump", "state"]


class Place(NamedTuple):
    """The place of a message: number of its chunk, and its index in the chunk."""

    chunk: int
    message: int


class Run(NamedTuple):
    """The recording between two jumps of time: the place where it begins, and its first and last time, ns."""

    first: Place
    from_ns: int
    to_ns: int


class Scene(NamedTuple):
    """The bodies, ports, services and water from a time on; `jumps` is the number of the run."""

    jumps: int
    t_ns: int
    entities: EntityList
    bodies: tuple[Body, ...]
    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    water: WaterView


class Mark(NamedTuple):
    """An event on the time line, with the number of its run."""

    run: int
    event: Event


class Item(NamedTuple):
    """A message with the time at which it is played, ns, and its type."""

    t_ns: int
    type: Type
    message: McapMessage
