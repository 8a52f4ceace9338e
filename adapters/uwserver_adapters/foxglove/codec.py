"""The messages of foxglove.sdk.v1, without sockets: JSON texts, and little-endian binary messages whose first byte is their kind.

Kinds, fields and their order are those of the specification (github.com/foxglove/ws-protocol, docs/spec.md) and, for playback, of what
foxglove-sdk 0.30 sends and accepts.
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
"""The present protocol, and the one of Lichtblick and of Foxglove until 2024, which has the same messages."""

_DATA, _TIME, _RESPONSE, _PLAYBACK = 1, 2, 3, 5
_CLIENT_DATA, _CALL, _CONTROL = 1, 2, 3
_HEAD = struct.Struct("<BIQ")
_CLIENT_HEAD = struct.Struct("<BI")
_CALL_HEAD = struct.Struct("<BIII")
_CONTROL_HEAD = struct.Struct("<BBfBQI")
PLAYING, PAUSED = 0, 1
"""Numbers of playback states."""
_JSON_TYPES = {"float": "number", "int": "integer", "bool": "boolean", "str": "string"}

encode = msgspec.json.Encoder().encode


class BadMessage(ValueError):
    """A message of a client cannot be read; the text says why."""


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
    """A client's control of playback: whether to play, the speed, and the time to seek, ns, or None."""

    plays: bool
    speed: float
    seek_ns: int | None
    request: str


class Channel(NamedTuple):
    """A channel to which clients can subscribe."""

    topic: str
    encoding: str
    schema_name: str
    schema: str
    schema_encoding: str


def told_channel(number: int, channel: Channel) -> dict[str, Json]:
    """Return a channel as an entry of `advertise`."""
    return {
        "id": number,
        "topic": channel.topic,
        "encoding": channel.encoding,
        "schemaName": channel.schema_name,
        "schema": channel.schema,
        "schemaEncoding": channel.schema_encoding,
    }


def told_service(number: int, service: Service) -> dict[str, Json]:
    """Return a service as an entry of `advertiseServices`."""
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
    """Return the channel of a sensor's samples as JSON, in the form of its recording."""
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
    """Return the first message of a server.

    Args:
        name: name of the server, for people.
        capabilities: capabilities of the server.
        session: id of the session.
        span_ns: begin and end of a recording, ns; None for a running world.
        metadata: further facts.
    """
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
    """Return a text for the person at the client: level 0 information, 1 warning, 2 error."""
    return encode({"op": "status", "level": level, "message": text})


def call_failed(service: int, call: int, text: str) -> bytes:
    """Return the answer to a call that was refused or failed."""
    return encode({"op": "serviceCallFailure", "serviceId": service, "callId": call, "message": text})


def data(subscription: int, t_ns: int, payload: bytes) -> bytes:
    """Return a message of a channel; `t_ns` is its time, ns."""
    return _HEAD.pack(_DATA, subscription, max(0, t_ns)) + payload


def time(t_ns: int) -> bytes:
    """Return the message of the time, ns."""
    return struct.pack("<BQ", _TIME, max(0, t_ns))


def response(service: int, call: int, payload: bytes) -> bytes:
    """Return the answer of a service; the payload is JSON."""
    return _CALL_HEAD.pack(_RESPONSE, service, call, 4) + b"json" + payload


def playback_state(state: int, t_s: float, speed: float, has_sought: bool, request: str) -> bytes:
    """Return the state of playback.

    Args:
        state: `PLAYING` or `PAUSED`.
        t_s: time in the recording, s.
        speed: simulated seconds in a second.
        has_sought: whether time has jumped.
        request: id of the request that is answered; "" for none.
    """
    name = request.encode()
    t_ns = max(0, round(t_s * NANOSECONDS))  # the protocol knows no time before 0
    head = struct.pack("<BBQfBI", _PLAYBACK, state, t_ns, speed, has_sought, len(name))
    return head + name


def seconds(t_ns: int) -> float:
    """Return a time in s, as services take it."""
    return t_ns / NANOSECONDS


def nanoseconds(t_s: float) -> int:
    """Return a time in ns, as messages hold it."""
    return round(t_s * NANOSECONDS)


def read_binary(message: bytes) -> ClientData | ServiceCall | PlaybackControl:
    """Return the binary message of a client.

    Raises:
        BadMessage: it is of no known kind, or cut off.
    """
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
    """Return the text message of a client: an object with a text `op`.

    Raises:
        BadMessage: it is no such object.
    """
    found = _object(message.encode())
    if not isinstance(found.get("op"), str):
        raise BadMessage('a message needs an "op"')
    return found


def read_object(payload: bytes) -> dict[str, Any]:
    """Return the JSON object of a call or a published message; an empty payload is an empty object.

    Raises:
        BadMessage: it is no JSON object.
    """
    return _object(payload) if payload.strip() else {}


def _object(text: bytes) -> dict[str, Any]:
    """Decode an object; `decode` refuses first what would cost too much."""
    try:
        found = decode(text, "json")
    except Undecodable as error:
        raise BadMessage(f"no JSON object: {error}") from error
    if not isinstance(found, dict):
        raise BadMessage("no JSON object")
    return found
