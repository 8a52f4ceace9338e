"""Messages of a recording as samples and events again; what is damaged is left out and counted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec

from uwserver.ports import Buffer, Event, Field, Port, Sample
from uwserver.recording.player_file import Channel, Message

_TOLD: Final = ("conflict", "watchdog", "fault", "autopilot", "ports_changed")
"""Events that are told again; those of the clock and the server's life were of another server."""


class Messages:
    """Reads the messages of some channels.

    Attributes:
        damaged: messages that could not be read.
    """

    def __init__(self, channels: Mapping[int, Channel]) -> None:
        """channels: of the file, by number; more may come."""
        self._channels = channels
        self._decoders: dict[tuple[int, int], msgspec.json.Decoder[Any]] = {}
        self._event = msgspec.json.Decoder(Event)
        self.damaged = 0

    def topic(self, message: Message) -> str:
        """Path of the port of a message."""
        channel = self._channels.get(message.channel)
        return "" if channel is None else channel.topic

    def event(self, message: Message) -> Event | None:
        """The event of a message; None of one that is damaged."""
        try:
            return self._event.decode(message.data)
        except (msgspec.MsgspecError, ValueError):
            self.damaged += 1
            return None

    def told_event(self, message: Message) -> Event | None:
        """The same, if it is told again."""
        event = self.event(message)
        return event if event is not None and event.event in _TOLD else None

    def sample(self, message: Message, ports: Mapping[str, Port]) -> Sample | None:
        """The sample of a message; None of one that is damaged, or of no sensor that is there."""
        path = self.topic(message)
        port = ports.get(path)
        if port is None or port.direction != "sensor":
            return None
        decoder = self._decoders.get((message.channel, id(port.fields)))
        if decoder is None:
            decoder = self._decoders[message.channel, id(port.fields)] = _decoder(port.fields)
        try:
            said = decoder.decode(message.data)
        except (msgspec.MsgspecError, ValueError):
            self.damaged += 1
            return None
        return Sample(path, said.seq, said.t_ns, said.t_sent_ns, said.valid, msgspec.structs.astuple(said.value))


_SCALARS: Mapping[str, Any] = {"float": float, "int": int, "bool": bool, "str": str, "bytes": Buffer, "buffer": Buffer}


def _decoder(fields: tuple[Field, ...]) -> msgspec.json.Decoder[Any]:
    """Of the messages of a sensor with these fields."""
    names = [f"f{k}" for k in range(len(fields))]
    types: list[Any] = []
    for field in fields:
        scalar = _SCALARS[field.type] | None
        types.append(tuple[scalar, ...] | None if field.shape else scalar)  # type: ignore[valid-type]
    renamed = {name: field.name for name, field in zip(names, fields, strict=True)}
    value = msgspec.defstruct("Value", list(zip(names, types, strict=True)), rename=renamed, gc=False)
    times = [("seq", int), ("t_ns", int), ("t_sent_ns", int), ("valid", bool)]
    return msgspec.json.Decoder(msgspec.defstruct("Message", [*times, ("value", value)], gc=False))
