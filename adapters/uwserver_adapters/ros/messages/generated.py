"""A message for ports that no standard knows: a type of its own, written from the port's description, with our names, units and frames."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from uwserver.ports import Buffer, Field, Port, Sample
from uwserver_adapters.ros.messages.source import Outlet, Source, number, numbers
from uwserver_adapters.ros.messages.types import Types

_TYPES = {"float": "float64", "int": "int64", "bool": "bool", "str": "string", "bytes": "uint8"}


def generated(source: Source) -> Iterator[Outlet]:
    """Every field as it is: N and FRD axes, SI, ``nan`` for what is missing. ``valid`` says whether the sensor could measure."""
    types, port = source.types, source.port
    name = generated_type(types, port, definition(port))
    names = [field_name(field) for field in port.fields]

    def make(sample: Sample) -> object | None:
        values = {key: _value(field, value) for key, field, value in zip(names, port.fields, sample.value, strict=True)}
        return types.make(name, header=source.header(sample), valid=sample.valid, seq=sample.seq, **values)

    yield source.outlet("", name, make)


def generated_type(types: Types, port: Port, text: str, suffix: str = "") -> str:
    """The name of the type of this text, which is registered where it is new.

    Ports of the same kind and fields share a type; a second set of fields of a kind gets a type named after its path.
    """
    for word in (port.kind, port.path):
        name = f"uwserver_msgs/msg/{camel(word)}{suffix}"
        if name not in types:
            types.register(name, text)
            return name
        if types.generated.get(name) == text:
            return name
    return name


def definition(port: Port, is_command: bool = False) -> str:
    """Text of the .msg file; of a command without header, `valid` and `seq`."""
    lines = [] if is_command else ["std_msgs/Header header", "bool valid", "uint64 seq"]
    for field in port.fields:
        kind = _TYPES.get(field.type) or (field.buffer.dtype if field.buffer else "uint8")
        many = "[]" if field.shape or field.is_packed else ""
        lines.append(f"{kind}{many} {field_name(field)}")
    return "\n".join(lines)


def field_name(field: Field) -> str:
    """The field's name as ROS allows it: lower case."""
    made = re.sub(r"[^a-z0-9]+", "_", field.name.lower()).strip("_")
    return f"f_{made}" if not made[:1].isalpha() or made in ("header", "valid", "seq") else made


def camel(path: str) -> str:
    """A path as the name of a type: words with capitals, no signs."""
    return "".join(word[:1].upper() + word[1:] for word in re.split(r"[^A-Za-z0-9]+", path) if word) or "Port"


def _value(field: Field, value: Any) -> Any:
    if field.is_packed:
        empty = np.zeros(0, field.buffer.dtype if field.buffer else "uint8")
        return value.array().ravel() if isinstance(value, Buffer) else empty
    if not field.shape:
        blank = {"str": "", "bool": False, "int": 0}
        if field.type == "float":
            return number(value)
        return blank[field.type] if value is None else value
    parts = value if isinstance(value, tuple) else (None,) * field.size
    if field.type == "str":
        return [part or "" for part in parts]
    if field.type == "float":
        return numbers(parts)
    return np.array([part or 0 for part in parts], np.int64 if field.type == "int" else np.bool_)
