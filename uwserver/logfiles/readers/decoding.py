"""Decodes the messages of MCAP channels and ROS bags (JSON, protobuf, CDR and ROS 1) by the schemas in a log."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Any, NamedTuple

import msgspec

from uwserver.logfiles.log import LogError, LogField

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
_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){1,3}", re.ASCII)
"""Only such names are passed to rosbags, which makes Python code of them."""
_MOST_UNROLLED = 4096
"""Largest number of entries in fixed arrays of messages and texts: rosbags generates lines of code for each of them."""
_SIZES = {
    "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "int64": 8, "uint64": 8, "float32": 4, "float64": 8, "float128": 16, "string": 4, "wstring": 4,
}  # fmt: skip
"""Smallest size of a value in bytes, for the types where it is more than 1."""


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
        return _plain_protobuf(message)

    return Decoding(tuple(islice(_protobuf_fields(descriptor, "", "", ()), _MOST_FIELDS)), decode)


def _plain_protobuf(message: Any) -> dict[str, object]:
    """Return a protobuf message as a dictionary. An absent scalar has its default value; an absent nested message is left out."""
    found: dict[str, object] = {}
    for field in message.DESCRIPTOR.fields:
        nested = field.message_type is not None
        if nested and field.message_type.GetOptions().map_entry:
            found[field.name] = {
                str(key): _plain_protobuf(entry) if hasattr(entry, "DESCRIPTOR") else entry
                for key, entry in getattr(message, field.name).items()
            }
        elif field.is_repeated:
            found[field.name] = [_plain_protobuf(entry) if nested else entry for entry in getattr(message, field.name)]
        elif not nested:
            found[field.name] = getattr(message, field.name)
        elif message.HasField(field.name):
            found[field.name] = _plain_protobuf(getattr(message, field.name))
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


# -- ROS --------------------------------------------------------------------------------------------------------------------------------

_UNITS = {
    "sensor_msgs/msg/Imu": {"orientation": "1", "angular_velocity": "rad/s", "linear_acceleration": "m/s^2"},
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": "Pa", "variance": "Pa^2"},
    "sensor_msgs/msg/NavSatFix": {"latitude": "deg", "longitude": "deg", "altitude": "m"},
    "sensor_msgs/msg/Range": {"field_of_view": "rad", "min_range": "m", "max_range": "m", "range": "m"},
    "sensor_msgs/msg/Temperature": {"temperature": "degC"},
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/msg/BatteryState": {"voltage": "V", "current": "A", "charge": "A h", "temperature": "degC"},
    "geometry_msgs/msg/Pose": {"position": "m", "orientation": "1"},
    "geometry_msgs/msg/Transform": {"translation": "m", "rotation": "1"},
    "geometry_msgs/msg/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/msg/Accel": {"linear": "m/s^2", "angular": "rad/s^2"},
    "geometry_msgs/msg/Wrench": {"force": "N", "torque": "N m"},
    "builtin_interfaces/msg/Time": {"sec": "s", "nanosec": "ns"},
}
"""From REP 103 and the comments of the message definitions."""


def ros_decoding(name: str, text: str, is_idl: bool, is_ros1: bool) -> Decoding | None:
    """Return how messages of a ROS type are decoded; None when its definition is unknown.

    Args:
        name: name of the type, as in ROS 1 or ROS 2.
        text: its definition; if empty, the type is looked up among the messages of ROS 2 Humble.
        is_idl: the definition is IDL, not .msg.
        is_ros1: the messages are serialised as in ROS 1, not as CDR.

    Raises:
        LogError: the name is not a valid ROS type name, a few bytes could describe a message of any size, or a type in it is not defined.
        Exception: the definition cannot be parsed; an exception of rosbags.
    """
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    _check(name)
    store: Any = get_typestore(Stores.EMPTY)
    found: dict[str, Any] = {}
    if not text:
        found = dict(get_typestore(Stores.ROS2_HUMBLE).fielddefs)
    elif is_idl:
        for part in re.split(r"^=+\n", text, flags=re.MULTILINE):
            body = part.partition("\n")[2] if part.startswith("IDL: ") else part
            if body.strip():
                found.update(get_types_from_idl(body))
    else:
        found = dict(get_types_from_msg(text, name))
    for defined in found:
        _check(defined)
    store.register(found)
    whole = name if name.count("/") != 1 else name.replace("/", "/msg/")  # ROS 1 says std_msgs/Header
    if whole not in store.fielddefs:
        return None
    _Sizes(store.fielddefs).least(whole)
    deserialize = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr

    def decode(data: bytes) -> Mapping[str, object]:
        value: Any = _plain_ros(deserialize(data, whole))
        return value if isinstance(value, dict) else {"data": value}

    return Decoding(tuple(islice(_ros_fields(store.fielddefs, whole, "", "", 0), _MOST_FIELDS)), decode)


def _ros_fields(types: Mapping[str, Any], name: str, prefix: str, unit: str, depth: int) -> Iterator[LogField]:
    """Yield the fields of a type; fields of nested messages have names with dots.

    `_Sizes` has refused types that contain themselves or nothing, so every type that is visited yields a field.
    """
    if depth > _DEEPEST or name not in types:
        yield LogField(prefix.removesuffix("."), name, unit)
        return
    units = _UNITS.get(name, {})
    for field, described in types[name][1]:
        path, its_unit = f"{prefix}{field}", units.get(field, unit)
        kind, more = int(described[0]), described[1]
        if kind == 2:  # a message
            yield from _ros_fields(types, str(more), f"{path}.", its_unit, depth + 1)
        elif kind == 1:
            yield LogField(path, str(more[0]), its_unit)
        else:
            inner, length = more
            of = str(inner[1][0]) if int(inner[0]) == 1 else str(inner[1])
            yield LogField(path, f"{of}[{length if kind == 3 and length else ''}]", its_unit)


class _Sizes:
    """The smallest sizes of messages. They guarantee that a decoded message needs memory in proportion to its bytes."""

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types
        self._known: dict[str, int | None] = {}
        self._unrolled = 0

    def least(self, name: str) -> int:
        """Return the size of the smallest message of a type, in bytes.

        Raises:
            LogError: the type contains itself, an undefined type, a message of no bytes, or too long fixed arrays of messages or texts.
        """
        if name not in self._types:
            raise LogError(f"{name} is not defined")
        if name in self._known:
            known = self._known[name]
            if known is None:
                raise LogError(f"{name} contains itself, which ROS does not allow")
            return known
        self._known[name] = None  # while its fields are visited
        total = 0
        for field, (kind, more) in self._types[name][1]:
            if field == "structure_needs_at_least_one_member":
                continue  # stands for an empty type in ROS 2, but is not part of a ROS 1 message
            if kind <= 2:
                total += self._entry(name, field, kind, more)
                continue
            (of, what), length = more
            size = self._entry(name, field, of, what)
            if kind == 3 and (of == 2 or what[0] in ("string", "wstring")):
                self._unrolled += length
                if self._unrolled > _MOST_UNROLLED:
                    raise LogError(f"{name}.{field}: more than {_MOST_UNROLLED} entries in fixed arrays of messages")
            total += length * size if kind == 3 else 4
        self._known[name] = total
        return total

    def _entry(self, name: str, field: str, kind: int, what: Any) -> int:
        if kind == 1:
            return _SIZES.get(str(what[0]), 1)
        size = self.least(str(what))
        if not size:
            raise LogError(f"{name}.{field}: a {what} has no bytes: a message could contain any number of them")
        return size


def _check(name: str) -> None:
    if not _NAME.fullmatch(name) or len(name) > 200:
        raise LogError(f"{name[:60]!r} is not a name of a ROS message type")


def _plain_ros(value: Any) -> Any:
    """Return a message as a dictionary; arrays of numbers stay arrays."""
    fields = getattr(value, "__dataclass_fields__", None)
    if fields is not None:
        return {name: _plain_ros(getattr(value, name)) for name in fields if name != "__msgtype__"}
    if isinstance(value, list):
        return [_plain_ros(entry) for entry in value]
    return value
