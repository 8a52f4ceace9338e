"""MAVLink messages by name: encodes their fields to payload bytes and decodes them again.

pymavlink defines the messages. It is imported when an adapter starts, not with this module.
"""

from __future__ import annotations

import importlib
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

from msgspec import Struct

from uwserver.adapter import install_command
from uwserver.frames import Vec3
from uwserver_adapters.mavlink.wire.codec import vec3

Value = int | float | bytes | str | tuple[int, ...] | tuple[float, ...]
"""One field: a number or its name in the dialect, text, or the components of an array."""
Fields = Mapping[str, Value]
"""Values by field name. A field that is left out is zero, as in MAVLink 2."""

_NEWER = ("AVAILABLE_MODES", "CURRENT_MODE", "AVAILABLE_MODES_MONITOR")
"""Messages that have been standard since 2024, but that the vehicles' dialect does not have yet."""
_F32_MAX = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]
_RANGES = {
    "char": (0, 255),
    "uint8_t": (0, 0xFF),
    "uint8_t_mavlink_version": (0, 0xFF),
    "int8_t": (-0x80, 0x7F),
    "uint16_t": (0, 0xFFFF),
    "int16_t": (-0x8000, 0x7FFF),
    "uint32_t": (0, 0xFFFF_FFFF),
    "int32_t": (-0x8000_0000, 0x7FFF_FFFF),
    "uint64_t": (0, (1 << 64) - 1),
    "int64_t": (-(1 << 63), (1 << 63) - 1),
}


class CannotSpeak(Exception):
    """pymavlink is missing. The text says what to install."""


class Entry(Struct, frozen=True):
    """A number of an enumeration and its name in the dialect. The name is "" where the dialect has none."""

    number: int
    name: str


class MavlinkMessage(Struct, frozen=True):
    """A message that was received.

    Attributes:
        name: name of the message in its definition, such as HEARTBEAT.
        fields: all its fields.
        system, component: its sender.
        names: for each field with an enumeration, the names of the numbers.
    """

    name: str
    fields: Fields
    system: int
    component: int
    names: Mapping[str, Mapping[int, str]]

    @property
    def sender(self) -> tuple[int, int]:
        """System and component that sent the message."""
        return self.system, self.component

    def number(self, field: str) -> float:
        """Return a number, which may be NaN."""
        value = self.fields[field]
        return float(value) if isinstance(value, int | float) else math.nan

    def vec3(self, *fields: str) -> Vec3 | None:
        """Return three fields as a vector, or None if one of them is not a finite number."""
        return vec3([self.number(field) for field in fields])

    def integer(self, field: str) -> int:
        """Return an integer."""
        value = self.fields[field]
        return value if isinstance(value, int) else 0

    def entry(self, field: str) -> Entry:
        """Return an entry of an enumeration."""
        number = self.integer(field)
        return Entry(number, self.names[field].get(number, ""))

    def text(self, field: str) -> str:
        """Return a text up to its first NUL."""
        value = self.fields[field]
        return value.decode("latin-1") if isinstance(value, bytes) else ""

    def array(self, field: str) -> tuple[float, ...]:
        """Return the components of an array."""
        value = self.fields[field]
        return value if isinstance(value, tuple) else ()


class FieldSpec(Struct, frozen=True):
    """The definition of one field.

    Attributes:
        name: its name in the definition.
        count: length of the array; 0 for a single value.
        is_text: it is an array of characters.
        low, high: limits of an integer; `low` is None for a float.
        enum: names of the values; None where they have none.
        numbers: the numbers of all names of the dialect.
        is_bits: the value is a set of flags.
    """

    name: str
    count: int
    is_text: bool
    low: int | None
    high: int
    enum: Mapping[int, str] | None
    numbers: Mapping[str, int]
    is_bits: bool


class Layout:
    """How one message is encoded.

    Attributes:
        name: name of the message.
        id: number of the message.
        crc_extra: the byte that includes the definition itself in the checksum.
        parts: its fields in the order in which they are sent.
        target_fields: names of the fields with the addressed system and component; "" where the message has none.
    """

    def __init__(self, definition: Any, enums: Mapping[str, Mapping[int, str]], numbers: Mapping[str, int]) -> None:
        self.name: str = definition.msgname
        self.id: int = definition.id
        self.crc_extra: int = definition.crc_extra
        self._struct: struct.Struct = definition.unpacker
        parts = []
        for wire, name in enumerate(definition.ordered_fieldnames):
            kind = definition.fieldtypes[definition.fieldnames.index(name)]
            low, high = _RANGES.get(kind, (None, 0))
            enum = enums.get(definition.fieldenums_by_name.get(name, ""))
            is_bits = enum is not None and definition.fielddisplays_by_name.get(name) == "bitmask"
            count = int(definition.array_lengths[wire])
            is_text = kind == "char" and count > 0
            parts.append(FieldSpec(name, count, is_text, low, high, enum, numbers, is_bits))
        self.parts = tuple(parts)
        self._enums = {part.name: part.enum for part in parts if part.enum is not None}
        names = self._names = frozenset(part.name for part in parts)
        system = "target_system" if "target_system" in names else "target" if self.name == "MANUAL_CONTROL" else ""
        self.target_fields = (system, "target_component" if "target_component" in names else "")

    def encode(self, fields: Fields) -> bytes:
        """Return the payload without its trailing zeros.

        Integers are rounded and limited to the range of their type, and floats to the range of 32 bits. NaN stays NaN in a float and becomes
        zero in an integer.

        Raises:
            KeyError: the message has no such field, or the dialect no such name.
        """
        if not fields.keys() <= self._names:
            raise KeyError(f"{self.name} has no {', '.join(sorted(fields.keys() - self._names))}")
        row: list[object] = []
        for part in self.parts:
            value = fields.get(part.name, 0)
            if part.is_text:
                row.append(value.encode("utf-8", "replace") if isinstance(value, str) else value or b"")
            elif part.count:
                given = tuple(value) if isinstance(value, tuple | bytes) else ()
                row += [_limited(item, part) for item in given[: part.count]]
                row += [0] * (part.count - len(given))
            else:
                row.append(_limited(value, part))
        return self._struct.pack(*row).rstrip(b"\0") or b"\0"

    def decode(self, payload: bytes, system: int, component: int) -> MavlinkMessage:
        """Decode a payload of any length. Missing bytes are zero; surplus bytes belong to a newer definition and are ignored."""
        size = self._struct.size
        row = self._struct.unpack(payload[:size].ljust(size, b"\0"))
        fields: dict[str, Value] = {}
        at = 0
        for part in self.parts:
            size = 1 if part.is_text else part.count or 1  # a text is one item of the row
            items, at = row[at : at + size], at + size
            if part.is_text:
                fields[part.name] = items[0].split(b"\0", 1)[0]
            else:
                fields[part.name] = items if part.count else items[0]
        return MavlinkMessage(self.name, fields, system, component, self._enums)


def addressed_to(peer: tuple[int, int]) -> dict[str, int]:
    """Return the fields that address a message to a system and component."""
    return {"target_system": peer[0], "target_component": peer[1]}


def _limited(value: object, part: FieldSpec) -> int | float:
    if not isinstance(value, int | float):
        return part.numbers[value] if isinstance(value, str) else 0
    if part.low is None:
        return value if not abs(value) > _F32_MAX else math.copysign(_F32_MAX, value)
    if value != value:  # NaN; math.isnan fails for a very large integer
        return 0
    return round(min(max(value, part.low), part.high))


class Dialect:
    """All messages and enumerations that a vehicle speaks.

    Attributes:
        by_name, by_id: the layouts of the messages.
        numbers: the numbers of all enumeration entries, by name.
        crc: computes the CRC-16/MCRF4XX of bytes.
    """

    def __init__(self) -> None:
        try:
            vehicle = importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
            newer = importlib.import_module("pymavlink.dialects.v20.development")
        except ImportError as error:
            raise CannotSpeak(f"MAVLink needs pymavlink: {install_command('uwserver')} ({error})") from error
        definitions = dict(vehicle.mavlink_map)
        for definition in newer.mavlink_map.values():
            if definition.msgname in _NEWER:
                definitions.setdefault(definition.id, definition)
        enums = {
            name: {number: str(entry.name) for number, entry in entries.items() if not entry.name.endswith("_ENUM_END")}
            for name, entries in {**newer.enums, **vehicle.enums}.items()
        }
        enums["SUB_MODE"] = {21: "SUB_MODE_SURFTRAK", **enums["SUB_MODE"]}  # not in pymavlink 2.4.41 yet
        self._names = enums
        self.numbers = {name: number for entries in enums.values() for number, name in entries.items()}
        self.by_id = {id: Layout(definition, enums, self.numbers) for id, definition in definitions.items() if id >= 0}
        self.by_name = {layout.name: layout for layout in self.by_id.values()}
        fast: Callable[[bytes], int] | None = getattr(vehicle, "mcrf4xx", None)
        self.crc: Callable[[bytes], int] = fast or (lambda data: int(vehicle.x25crc(data).crc))

    def entry(self, name: str) -> Entry:
        """Return the entry of an enumeration with this name. Raises KeyError when there is none."""
        return Entry(self.numbers[name], name)

    def name(self, enum: str, number: int) -> str:
        """Return the name of a number in an enumeration, "" where it has none."""
        return self._names[enum].get(number, "")

    def message_name(self, number: int) -> str:
        """Return the name of the message with this number, "" where there is no such message."""
        layout = self.by_id.get(number)
        return layout.name if layout is not None else ""
