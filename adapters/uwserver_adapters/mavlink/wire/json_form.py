"""Frames to and from JSON in the schema of mavlink2rest and mavlink-server. Sans-IO.

The schema is {"header": {"system_id": 1, "component_id": 1, "sequence": 7}, "message": {"type": "HEARTBEAT", ...}}. An enumeration entry is
{"type": "MAV_STATE_ACTIVE"} and a set of flags {"bits": 81}. Text is a list of characters, padded with NUL. A number that is not finite is null.
A field with the name "type" is called "mavtype".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import msgspec
from msgspec import Meta, Struct, field

from uwserver.adapter import Undecodable, decode
from uwserver_adapters.mavlink.wire.dialect import Dialect, FieldSpec, Layout, Value
from uwserver_adapters.mavlink.wire.frames import Frame, pack

LONGEST = 16_384
"""Longest accepted text, bytes. The longest message has about 4000."""

Byte = Annotated[int, Meta(ge=0, le=0xFF)]


class BadJson(Exception):
    """The text is no message. The exception says why."""


class Header(Struct, frozen=True):
    """The sender and the sequence number of the frame."""

    system_id: Byte
    component_id: Byte
    sequence: Byte = 0


class _Envelope(Struct, frozen=True):
    header: Header
    message: dict[str, object] = field(default_factory=dict)


_F32_END = 1 << 128
"""Every number of 32 bits is smaller than this."""


def name_of(part: FieldSpec) -> str:
    """Return a field's name in JSON."""
    return "mavtype" if part.name == "type" else part.name


def fields_of(frame: Frame, layout: Layout) -> dict[str, object]:
    """Return the fields of a frame under their names in JSON."""
    fields = layout.decode(frame.payload, frame.system, frame.component).fields
    return {name_of(part): _to_json(part, fields[part.name]) for part in layout.parts}


def text_of(frame: Frame, name: str, fields: dict[str, object]) -> bytes:
    """Return the whole message as JSON."""
    header = Header(frame.system, frame.component, frame.seq)
    return msgspec.json.encode({"header": header, "message": {"type": name, **fields}})


def frame_of(data: bytes, dialect: Dialect) -> bytes:
    """Return the frame that a text describes.

    Fields that are left out are zero, as in MAVLink 2. Fields that the message does not have are ignored, as in mavlink2rest: the sender may
    know a newer definition. Cockpit, for one, addresses its TIMESYNC.

    Raises:
        BadJson: the text is no JSON, there is no such message, or a field cannot have its value.
    """
    if len(data) > LONGEST:
        raise BadJson(f"the text has {len(data)} bytes, at most {LONGEST} are accepted")
    try:
        envelope = msgspec.convert(decode(data, "json"), _Envelope)
    except (Undecodable, msgspec.ValidationError) as error:
        raise BadJson(str(error)) from None
    given = envelope.message
    name = given.get("type")
    layout = dialect.by_name.get(name) if isinstance(name, str) else None
    if layout is None:
        raise BadJson(f"message.type: no message {name!r:.60}")
    fields = {part.name: _from_json(part, given[name_of(part)]) for part in layout.parts if name_of(part) in given}
    header = envelope.header
    return pack(dialect, layout.id, layout.encode(fields), header.sequence, header.system_id, header.component_id)


def _to_json(part: FieldSpec, value: Value) -> object:
    if part.is_text and isinstance(value, bytes):
        return list(value.ljust(part.count, b"\0").decode("latin-1"))
    if isinstance(value, tuple):
        return [_scalar_to_json(part, entry) for entry in value]
    return _scalar_to_json(part, value)


def _scalar_to_json(part: FieldSpec, value: object) -> object:
    if part.is_bits:
        return {"bits": value}
    if part.enum is not None and value in part.enum:
        return {"type": part.enum[value]}  # type: ignore[index]  # a key of it
    return value


def _from_json(part: FieldSpec, value: object) -> Value:
    if part.is_text:
        entries = list(value) if isinstance(value, str | list) else [value]
        if len(entries) > part.count or not all(isinstance(entry, str) and len(entry) == 1 for entry in entries):
            raise BadJson(f"{part.name}: needs at most {part.count} characters, not {value!r:.60}")
        return "".join(map(str, entries)).encode("latin-1", "replace")
    if part.count:
        if not isinstance(value, list) or len(value) > part.count:
            raise BadJson(f"{part.name}: needs at most {part.count} numbers, not {value!r:.60}")
        return tuple(_scalar_from_json(part, entry) for entry in value)
    return _scalar_from_json(part, value)


def _scalar_from_json(part: FieldSpec, value: object) -> int | float:
    if part.enum is not None and isinstance(value, dict):
        value = value.get("bits") if part.is_bits else _number_of(part.enum, value.get("type"))
    if part.low is None:
        if value is None:
            return math.nan
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _F32_END:
            return float(value)
    elif isinstance(value, int) and not isinstance(value, bool) and part.low <= value <= part.high:
        return value
    raise BadJson(f"{part.name}: {value!r:.60} is not a value of this field")


def _number_of(enum: Mapping[int, str], name: object) -> int | None:
    return next((number for number, known in enum.items() if known == name), None)
