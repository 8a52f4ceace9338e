"""What a recording is made of, for who plays it: places in its file, runs between jumps of time, scenes, marks, and what comes next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

from uwserver.ports import Cast, Event, Port, Service, WaterView
from uwserver.recording.player_file import Message
from uwserver.recording.states import Body

Type = Literal["sample", "event", "jump", "state"]


class Place(NamedTuple):
    """A message of the file: number of its chunk, and its place there."""

    chunk: int
    message: int


class Run(NamedTuple):
    """What was recorded between two jumps of time: where it begins, and its first and last time, ns."""

    first: Place
    from_ns: int
    to_ns: int


class Scene(NamedTuple):
    """Who and what is there from a time on."""

    jumps: int
    t_ns: int
    cast: Cast
    bodies: tuple[Body, ...]
    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    water: WaterView


class Mark(NamedTuple):
    """An event on the line of time."""

    run: int
    event: Event


class Item(NamedTuple):
    """What comes next."""

    t_ns: int
    type: Type
    message: Message
