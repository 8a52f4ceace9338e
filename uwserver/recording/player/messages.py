"""What playback reads from a recording: samples, events and scenes, and their places in the file and in time.

Damaged messages are skipped and counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal, NamedTuple

import msgspec

from uwserver.ports import Buffer, EntityList, Event, Field, Port, Sample, Service, WaterView
from uwserver.recording.player.chunks import Channel, McapMessage
from uwserver.recording.states import Body

Type = Literal["sample", "event", "jump", "state"]

_PLAYED_EVENTS: Final = ("conflict", "watchdog", "fault", "autopilot", "held", "ports_changed")
"""Events that are played. Those about the clock and the server belong to the server that recorded them."""
_SCALARS: Mapping[str, Any] = {"float": float, "int": int, "bool": bool, "str": str, "bytes": Buffer, "buffer": Buffer}


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


class ChannelReader:
    """Reads the messages of some channels.

    Attributes:
        damaged: number of messages that could not be read.
    """

    def __init__(self, channels: Mapping[int, Channel]) -> None:
        """Read messages of these channels, by number; later channels may be added to the mapping."""
        self._channels = channels
        self._decoders: dict[tuple[int, int], msgspec.json.Decoder[Any]] = {}
        self._event = msgspec.json.Decoder(Event)
        self.damaged = 0

    def topic(self, message: McapMessage) -> str:
        """Return the topic of a message, which is the path of its port; "" if its channel is unknown."""
        channel = self._channels.get(message.channel)
        return "" if channel is None else channel.topic

    def event(self, message: McapMessage) -> Event | None:
        """Return the event in a message; None if it is damaged."""
        try:
            return self._event.decode(message.data)
        except (msgspec.MsgspecError, ValueError):
            self.damaged += 1
            return None

    def played_event(self, message: McapMessage) -> Event | None:
        """Return the event in a message, if it is played; else None."""
        event = self.event(message)
        return event if event is not None and event.event in _PLAYED_EVENTS else None

    def sample(self, message: McapMessage, ports: Mapping[str, Port]) -> Sample | None:
        """Return the sample in a message; None if it is damaged, or not of a sensor among these ports."""
        path = self.topic(message)
        port = ports.get(path)
        if port is None or port.direction != "sensor":
            return None
        decoder = self._decoders.get((message.channel, id(port.fields)))
        if decoder is None:
            decoder = self._decoders[message.channel, id(port.fields)] = _decoder(port.fields)
        try:
            found = decoder.decode(message.data)
        except (msgspec.MsgspecError, ValueError):
            self.damaged += 1
            return None
        return Sample(path, found.seq, found.t_ns, found.t_sent_ns, found.valid, msgspec.structs.astuple(found.value))


def _decoder(fields: tuple[Field, ...]) -> msgspec.json.Decoder[Any]:
    """Return a decoder for the messages of a sensor with these fields."""
    names = [f"f{k}" for k in range(len(fields))]
    types: list[Any] = []
    for field in fields:
        scalar = _SCALARS[field.type] | None
        types.append(tuple[scalar, ...] | None if field.shape else scalar)  # type: ignore[valid-type]
    renamed = {name: field.name for name, field in zip(names, fields, strict=True)}
    value = msgspec.defstruct("Value", list(zip(names, types, strict=True)), rename=renamed, gc=False)
    times = [("seq", int), ("t_ns", int), ("t_sent_ns", int), ("valid", bool)]
    return msgspec.json.Decoder(msgspec.defstruct("Message", [*times, ("value", value)], gc=False))
