"""Decodes the messages of MCAP channels (JSON, protobuf, CDR and ROS 1) by the schema in the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Any, NamedTuple

import msgspec

from uwserver.logfiles.log import LogField
from uwserver.logfiles.ros_messages import RosTypes

_DEEPEST = 8
_MOST_FIELDS = 400
_STATES = "uwserver-state"
"""Encoding of the channel of body poses in our recordings. It is read by the player only; the same poses are in the ports."""
_ABOUT = re.compile(r"; unit ([^;]+)|; frame ([^;]+)")
_FOXGLOVE_UNITS = {
    "position": "m",
    "translation": "m",
    "latitude": "deg",
    "longitude": "deg",
    "altitude": "m",
    "seconds": "s",
    "nanos": "ns",
}


class Decoding(NamedTuple):
    """The fields of a channel, the function that decodes a message, and a remark when messages cannot be decoded."""

    fields: tuple[LogField, ...]
    decode: Callable[[bytes], Mapping[str, object]]
    remark: str = ""


def decoding(encoding: str, schema_name: str, schema_encoding: str, schema: bytes) -> Decoding:
    """Return how the messages of a channel are decoded.

    Args:
        encoding: encoding of the messages.
        schema_name, schema_encoding, schema: as in the file; empty when there is no schema.

    Raises:
        Exception: the schema is damaged; each parser raises its own exception. ImportError when a package is missing.
    """
    if encoding == "json":
        tree = msgspec.json.decode(schema) if schema_encoding == "jsonschema" and schema.strip() else {}
        return Decoding(tuple(islice(_json_fields(tree, "", 0), _MOST_FIELDS)), _json)
    if encoding == "protobuf" and schema_encoding == "protobuf":
        return _protobuf(schema_name, schema)
    if encoding in ("cdr", "ros1") and schema_encoding in ("ros2msg", "ros2idl", "ros1msg", ""):
        text = schema.decode(errors="replace")
        found = ros_decoding(schema_name, text, schema_encoding == "ros2idl", encoding == "ros1")
        if found is not None:
            return found
    if encoding == _STATES:
        return undecoded("")
    pair = f"the encoding {encoding or '(none)'} with a schema of {schema_encoding or '(none)'}"
    return undecoded(f"{pair} cannot be decoded: messages are given as bytes")


def ros_decoding(name: str, text: str, is_idl: bool, is_ros1: bool) -> Decoding | None:
    """Return how messages of a ROS type are decoded; None when its definition is unknown. Arguments and errors as `RosTypes`."""
    types = RosTypes(name, text, is_idl)
    decode = types.decoder(is_ros1)
    return None if decode is None else Decoding(types.fields(), decode)


def undecoded(remark: str) -> Decoding:
    """Return a decoding that gives the bytes of each message."""
    return Decoding((LogField("data", "bytes"),), lambda data: {"data": bytes(data)}, remark)


def _json(data: bytes) -> Mapping[str, object]:
    value = msgspec.json.decode(data)
    return value if isinstance(value, dict) else {"data": value}


def _json_fields(node: object, prefix: str, depth: int) -> Iterator[LogField]:
    properties = node.get("properties") if isinstance(node, dict) else None
    if depth > _DEEPEST or not isinstance(properties, dict):
        return
    for name, entry in properties.items():
        if not isinstance(entry, dict):
            continue
        path = f"{prefix}{name}"
        if "properties" in entry and "contentEncoding" not in str(entry):
            yield from _json_fields(entry, f"{path}.", depth + 1)
            continue
        about = _ABOUT.findall(str(entry.get("description", "")))
        unit = next((u for u, _ in about if u), "")
        frame = next((f for _, f in about if f), "")
        size = f"[{entry['maxItems']}]" if isinstance(entry.get("maxItems"), int) else ""
        items = _json_type(entry.get("items"))
        yield LogField(path, f"{items}{size}" if items else _json_type(entry), unit, frame)


def _json_type(node: object) -> str:
    """Return the type of a JSON schema without null, alternatives as ``a|b``; "" when it has none."""
    types = node.get("type", "") if isinstance(node, dict) else ""
    return "|".join(str(word) for word in (types if isinstance(types, list) else [types]) if word != "null")


def _protobuf(name: str, schema: bytes) -> Decoding:
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    files: Any = {file.name: file for file in FileDescriptorSet.FromString(schema).file}
    pool = DescriptorPool()

    def add(file: Any) -> None:
        for dependency in file.dependency:
            if dependency in files:
                add(files.pop(dependency))
        pool.Add(file)

    while files:
        add(files.pop(next(iter(files))))
    descriptor = pool.FindMessageTypeByName(name)
    type_: Any = GetMessageClass(descriptor)

    def decode(data: bytes) -> Mapping[str, object]:
        message = type_()
        message.ParseFromString(data)
        return _plain(message)

    return Decoding(tuple(islice(_protobuf_fields(descriptor, "", "", ()), _MOST_FIELDS)), decode)


def _plain(message: Any) -> dict[str, object]:
    """Return a protobuf message as a dictionary. An absent scalar has its default value; an absent nested message is left out."""
    found: dict[str, object] = {}
    for field in message.DESCRIPTOR.fields:
        nested = field.message_type is not None
        if nested and field.message_type.GetOptions().map_entry:
            found[field.name] = {
                str(key): _plain(entry) if hasattr(entry, "DESCRIPTOR") else entry
                for key, entry in getattr(message, field.name).items()
            }
        elif field.is_repeated:
            found[field.name] = [_plain(entry) if nested else entry for entry in getattr(message, field.name)]
        elif not nested:
            found[field.name] = getattr(message, field.name)
        elif message.HasField(field.name):
            found[field.name] = _plain(getattr(message, field.name))
    return found


def _protobuf_fields(descriptor: Any, prefix: str, unit: str, inside: tuple[str, ...]) -> Iterator[LogField]:
    """Yield the fields of a type that is nested in the types `inside`.

    A nested type that contains itself, is empty or is too deep counts as one field. So every type that is visited yields at least one field,
    and taking the first n fields takes a time in proportion to n, however the types are nested.
    """
    names = ("double", "float", "int64", "uint64", "int32", "fixed64", "fixed32", "bool", "string", "group", "message", "bytes",
             "uint32", "enum", "sfixed32", "sfixed64", "sint32", "sint64")  # fmt: skip
    inside = (*inside, descriptor.full_name)
    for field in descriptor.fields:
        its_unit = (
            _FOXGLOVE_UNITS.get(field.name, unit) if descriptor.full_name.startswith(("foxglove.", "google.")) else ""
        )
        nested = field.message_type
        can_open = nested is not None and not field.is_repeated and len(inside) <= _DEEPEST and nested.fields
        if can_open and nested.full_name not in inside:
            yield from _protobuf_fields(nested, f"{prefix}{field.name}.", its_unit, inside)
        else:
            type_ = nested.full_name if nested is not None else names[field.type - 1]
            yield LogField(f"{prefix}{field.name}", type_ + ("[]" if field.is_repeated else ""), its_unit)
