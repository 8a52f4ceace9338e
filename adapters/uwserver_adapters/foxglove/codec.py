"""The messages of foxglove.sdk.v1: JSON texts, and binary ones with a byte for their kind in front, little endian. No sockets here.

Numbers of kinds, fields and order were read from the specification (github.com/foxglove/ws-protocol, docs/spec.md) and, for playback, from what
foxglove-sdk 0.30 sends and takes.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from uwserver.adapter import Undecodable, decode
from uwserver.ports import Field, Json, Port, Service
from uwserver.units import NANOSECONDS

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""The present one, and that of Lichtblick and of Foxglove until 2024, whose messages are the same."""

_DATA, _TIME, _RESPONSE, _PLAYBACK = 1, 2, 3, 5
_CLIENT_DATA, _CALL, _CONTROL = 1, 2, 3
_HEAD = struct.Struct("<BIQ")
_CLIENT_HEAD = struct.Struct("<BI")
_CALL_HEAD = struct.Struct("<BIII")
_CONTROL_HEAD = struct.Struct("<BBfBQI")
PLAYING, PAUSED = 0, 1
"""Of a playback state."""
_JSON_TYPES = {"float": "number", "int": "integer", "bool": "boolean", "str": "string"}

encode = msgspec.json.Encoder().encode


class BadMessage(ValueError):
    """A message of a client that cannot be understood; the text says why."""


class ClientData(NamedTuple):
    """A message that a client publishes on a channel of its own."""

    channel: int
    payload: bytes


class ServiceCall(NamedTuple):
    """A call of a service."""

    service: int
    call: int
    encoding: str
    payload: bytes


class PlaybackControl(NamedTuple):
    """What a client wants of time: play or not, how fast, and where to (ns) unless it stays."""

    plays: bool
    speed: float
    seek_ns: int | None
    request: str


class Channel(NamedTuple):
    """What can be subscribed."""

    topic: str
    encoding: str
    schema_name: str
    schema: str
    schema_encoding: str


def told_channel(number: int, channel: Channel) -> dict[str, Json]:
    """A channel as `advertise` has it."""
    return {
        "id": number,
        "topic": channel.topic,
        "encoding": channel.encoding,
        "schemaName": channel.schema_name,
        "schema": channel.schema,
        "schemaEncoding": channel.schema_encoding,
    }


def told_service(number: int, service: Service) -> dict[str, Json]:
    """A service as `advertiseServices` has it."""
    arguments: dict[str, Json] = {a.name: _schema(a.type, a.doc, a.unit, a.shape) for a in service.arguments}
    required: list[Json] = [a.name for a in service.arguments if a.required]
    request: dict[str, Json] = {
        "type": "object",
        "properties": arguments,
        "required": required,
        "additionalProperties": False,
    }
    return {
        "id": number,
        "name": service.path,
        "type": service.path,
        "request": _json_schema(f"{service.path}.request", request),
        "response": _json_schema(f"{service.path}.response", {"description": service.doc}),
    }


def _json_schema(name: str, schema: dict[str, Json]) -> dict[str, Json]:
    return {"encoding": "json", "schemaName": name, "schemaEncoding": "jsonschema", "schema": encode(schema).decode()}


def _schema(type_: str, doc: str, unit: str, shape: Sequence[int]) -> dict[str, Json]:
    about = doc if unit == "1" else f"{doc}; unit {unit}"
    found: dict[str, Json] = {"description": about}
    if type_ in _JSON_TYPES:
        found["type"] = _JSON_TYPES[type_]
    for extent in reversed(shape):
        found = {"type": "array", "items": found, "minItems": extent, "maxItems": extent, "description": about}
    return found


def port_channel(port: Port) -> Channel:
    """The samples of a sensor as JSON, in the form that its recording has."""
    fields: dict[str, Json] = {field.name: _field(field) for field in port.fields}
    whole: dict[str, Json] = {"type": "integer"}
    properties: dict[str, Json] = {
        "seq": whole,
        "t_ns": whole,
        "t_sent_ns": whole,
        "valid": {"type": "boolean"},
        "value": {"type": "object", "properties": fields},
    }
    schema: dict[str, Json] = {"title": port.path, "description": port.doc, "type": "object", "properties": properties}
    return Channel(port.path, "json", port.path, encode(schema).decode(), "jsonschema")


def _field(field: Field) -> dict[str, Json]:
    found = _schema(field.type, field.doc, field.unit, field.shape)
    return {**found, "description": f"{found['description']}; frame {field.frame}"} if field.frame else found


def server_info(
    name: str, capabilities: Sequence[str], session: str, span_ns: tuple[int, int] | None, metadata: Mapping[str, str]
) -> bytes:
    """The first message of a server."""
    told: dict[str, object] = {
        "op": "serverInfo",
        "name": name,
        "capabilities": list(capabilities),
        "supportedEncodings": ["json"],
        "metadata": dict(metadata),
        "sessionId": session,
    }
    if span_ns is not None:
        for key, t_ns in zip(("dataStartTime", "dataEndTime"), span_ns, strict=True):
            seconds, nanos = divmod(max(0, t_ns), NANOSECONDS)
            told[key] = {"sec": seconds, "nsec": nanos}
    return encode(told)


def status(level: int, text: str) -> bytes:
    """Something a person should read: level 0 information, 1 warning, 2 error."""
    return encode({"op": "status", "level": level, "message": text})


def call_failed(service: int, call: int, text: str) -> bytes:
    """A call that was refused, or went wrong."""
    return encode({"op": "serviceCallFailure", "serviceId": service, "callId": call, "message": text})


def data(subscription: int, t_ns: int, payload: bytes) -> bytes:
    """A message of a channel."""
    return _HEAD.pack(_DATA, subscription, max(0, t_ns)) + payload


def time(t_ns: int) -> bytes:
    """What time it is."""
    return struct.pack("<BQ", _TIME, max(0, t_ns))


def response(service: int, call: int, payload: bytes) -> bytes:
    """The answer of a service."""
    return _CALL_HEAD.pack(_RESPONSE, service, call, 4) + b"json" + payload


def playback_state(state: int, t_s: float, speed: float, has_sought: bool, request: str) -> bytes:
    """How the playback of a recording stands."""
    name = request.encode()
    t_ns = max(0, round(t_s * NANOSECONDS))  # the protocol knows no time before 0
    head = struct.pack("<BBQfBI", _PLAYBACK, state, t_ns, speed, has_sought, len(name))
    return head + name


def seconds(t_ns: int) -> float:
    """As services want it."""
    return t_ns / NANOSECONDS


def nanoseconds(t_s: float) -> int:
    """As messages want it."""
    return round(t_s * NANOSECONDS)


def read_binary(message: bytes) -> ClientData | ServiceCall | PlaybackControl:
    """A binary message of a client. BadMessage where it is none."""
    kind = message[0] if message else None
    try:
        if kind == _CLIENT_DATA:
            return ClientData(_CLIENT_HEAD.unpack_from(message)[1], message[_CLIENT_HEAD.size :])
        if kind == _CALL:
            _, service, call, length = _CALL_HEAD.unpack_from(message)
            end = _CALL_HEAD.size + length
            if end > len(message):
                raise BadMessage("the name of its encoding is longer than the call")
            return ServiceCall(service, call, message[_CALL_HEAD.size : end].decode(), message[end:])
        if kind == _CONTROL:
            _, command, speed, has_seek, seek_ns, length = _CONTROL_HEAD.unpack_from(message)
            name = message[_CONTROL_HEAD.size :]
            if command not in (0, 1) or length != len(name):
                raise BadMessage("no such command of playback")
            return PlaybackControl(command == 0, speed, seek_ns if has_seek else None, name.decode())
    except (struct.error, UnicodeDecodeError) as error:
        raise BadMessage(f"a binary message of kind {kind} is cut off: {error}") from error
    raise BadMessage(f"no binary message of a client is of kind {kind}")


def read_text(message: str) -> dict[str, Any]:
    """A text message of a client: an object with a text `op`. BadMessage where it is none."""
    found = _object(message.encode())
    if not isinstance(found.get("op"), str):
        raise BadMessage('a message needs an "op"')
    return found


def read_object(payload: bytes) -> dict[str, Any]:
    """The JSON object of a call or a published message; an empty payload is an empty one. BadMessage where it is none."""
    return _object(payload) if payload.strip() else {}


def _object(text: bytes) -> dict[str, Any]:
    """Weighed first: see `uwserver.adapter.decode`."""
    try:
        found = decode(text, "json")
    except Undecodable as error:
        raise BadMessage(f"no JSON object: {error}") from error
    if not isinstance(found, dict):
        raise BadMessage("no JSON object")
    return found
