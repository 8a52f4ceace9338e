"""A message type of its own for each port without a standard message, made from the port's description with our names, units and frames."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from uwserver.ports import Buffer, Field, Port, Sample
from uwserver_adapters.ros.messages.ros_port import RosPort, SensorTopic, number, numbers
from uwserver_adapters.ros.messages.types import Types

_TYPES = {"float": "float64", "int": "int64", "bool": "bool", "str": "string", "bytes": "uint8"}


def generated(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a message with every field as it is: N and FRD axes, SI units, NaN for missing values.

    ``valid`` says whether the sensor could measure.
    """
    types, port = ros_port.types, ros_port.port
    name = generated_type(types, port, definition(port))
    names = [field_name(field) for field in port.fields]

    def make(sample: Sample) -> object | None:
        values = {key: _value(field, value) for key, field, value in zip(names, port.fields, sample.value, strict=True)}
        return types.make(name, header=ros_port.header(sample), valid=sample.valid, seq=sample.seq, **values)

    yield ros_port.sensor_topic("", name, make)


def generated_type(types: Types, port: Port, text: str, suffix: str = "") -> str:
    """Return the name of the message type with this text; register the type where it is new.

    Ports of the same kind and fields share a type. A port of the same kind with other fields gets a type named after its path.

    Args:
        types: message types of the distribution.
        port: the port.
        text: text of the .msg file.
        suffix: appended to the name.
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
    """Return the text of the .msg file of a port; that of a command has no header, `valid` and `seq`."""
    lines = [] if is_command else ["std_msgs/Header header", "bool valid", "uint64 seq"]
    for field in port.fields:
        kind = _TYPES.get(field.type) or (field.buffer.dtype if field.buffer else "uint8")
        many = "[]" if field.shape or field.is_packed else ""
        lines.append(f"{kind}{many} {field_name(field)}")
    return "\n".join(lines)


def field_name(field: Field) -> str:
    """Return a field's name as ROS allows it: in lower case."""
    made = re.sub(r"[^a-z0-9]+", "_", field.name.lower()).strip("_")
    return f"f_{made}" if not made[:1].isalpha() or made in ("header", "valid", "seq") else made


def camel(path: str) -> str:
    """Return a path as the name of a type: words with capitals, without other characters."""
    return "".join(word[:1].upper() + word[1:] for word in re.split(r"[^A-Za-z0-9]+", path) if word) or "Port"


def _value(field: Field, value: Any) -> Any:
    if field.is_packed:
        empty = np.zeros(0, field.buffer.dtype if field.buffer else "uint8")
        return value.array().ravel() if isinstance(value, Buffer) else empty
    if not field.shape:
        if field.type == "float":
            return number(value)
        return {"str": "", "bool": False, "int": 0}[field.type] if value is None else value
    parts = value if isinstance(value, tuple) else (None,) * field.size
    if field.type == "str":
        return [part or "" for part in parts]
    if field.type == "float":
        return numbers(parts)
    return np.array([part or 0 for part in parts], np.int64 if field.type == "int" else np.bool_)
