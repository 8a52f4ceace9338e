"""How messages on a channel of an MCAP file are decoded: JSON, protobuf, CDR and ROS 1, by the schema in the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Any, NamedTuple

import msgspec

from uwserver.logfiles.log import LogField
from uwserver.logfiles.ros_messages import Definition, RosTypes

_DEEPEST = 8
_MOST_FIELDS = 400
_OF_PLAYERS = "uwserver-state"
"""Where all bodies are, in a recording of ours: bytes for who plays it, of which nothing is lost here, as the same poses have ports."""
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
    """What is known of a channel: its fields, what decodes a message, and a sentence when nothing does."""

    fields: tuple[LogField, ...]
    decode: Callable[[bytes], Mapping[str, object]]
    remark: str = ""


def decoding(encoding: str, schema_name: str, schema_encoding: str, schema: bytes) -> Decoding:
    """How to read a channel.

    Args:
        encoding: of its messages.
        schema_name, schema_encoding, schema: as in the file, empty where there is none.

    Raises:
        Exception: the schema is damaged, whatever its parser raises; ImportError when a package is missing.
    """
    if encoding == "json":
        tree = msgspec.json.decode(schema) if schema_encoding == "jsonschema" and schema.strip() else {}
        return Decoding(tuple(islice(_json_fields(tree, "", 0), _MOST_FIELDS)), _json)
    if encoding == "protobuf" and schema_encoding == "protobuf":
        return _protobuf(schema_name, schema)
    if encoding in ("cdr", "ros1") and schema_encoding in ("ros2msg", "ros2idl", "ros1msg", ""):
        text = schema.decode(errors="replace")
        types = RosTypes([Definition(schema_name, text, schema_encoding == "ros2idl")])
        decode = types.decoder(schema_name, encoding == "ros1")
        if decode is not None:
            return Decoding(types.fields(schema_name), decode)
    if encoding == _OF_PLAYERS:
        return Decoding((LogField("data", "bytes"),), lambda data: {"data": data})
    return undecoded(
        f"messages are {encoding or 'of no encoding'} with a schema {schema_encoding or 'of none'}: only their bytes are given"
    )


def undecoded(remark: str) -> Decoding:
    """Of messages that nobody can decode here: their bytes."""
    return Decoding((LogField("data", "bytes"),), lambda data: {"data": data}, remark)


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
        kinds = entry.get("type", "")
        words = [str(k) for k in (kinds if isinstance(kinds, list) else [kinds]) if k != "null"]
        if "properties" in entry and "contentEncoding" not in str(entry):
            yield from _json_fields(entry, f"{path}.", depth + 1)
            continue
        about = _ABOUT.findall(str(entry.get("description", "")))
        unit = next((u for u, _ in about if u), "")
        frame = next((f for _, f in about if f), "")
        size = f"[{entry['maxItems']}]" if isinstance(entry.get("maxItems"), int) else ""
        items = entry.get("items")
        of = items.get("type", "") if isinstance(items, dict) else ""
        type_ = "|".join(w for w in of if w != "null") if isinstance(of, list) else str(of)
        yield LogField(path, f"{type_}{size}" if type_ else "|".join(words), unit, frame)


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
    """A protobuf message as a dictionary; what is absent has its default, a nested message that is absent is left out."""
    found: dict[str, object] = {}
    for field in message.DESCRIPTOR.fields:
        nested = field.message_type is not None
        if nested and field.message_type.GetOptions().map_entry:
            entries = getattr(message, field.name)
            found[field.name] = {
                str(key): _plain(entry) if hasattr(entry, "DESCRIPTOR") else entry
                for key, entry in ((key, entries[key]) for key in entries)
            }
        elif field.is_repeated:
            found[field.name] = [_plain(entry) if nested else entry for entry in getattr(message, field.name)]
        elif not nested:
            found[field.name] = getattr(message, field.name)
        elif message.HasField(field.name):
            found[field.name] = _plain(getattr(message, field.name))
    return found


def _protobuf_fields(descriptor: Any, prefix: str, unit: str, inside: tuple[str, ...]) -> Iterator[LogField]:
    """Fields of a type, `inside` of others. One that holds itself, or is empty or too deep, is one field: so every type that is looked at gives
    at least one, and who takes the first of them takes no longer than they are many."""
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
