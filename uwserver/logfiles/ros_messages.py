"""Decodes messages of ROS 1 and ROS 2 by the type definitions in a log."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Any

from uwserver.logfiles.log import LogError, LogField

_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){1,3}", re.ASCII)
"""Only such names are passed to rosbags, which makes Python code of them."""
_DEEPEST = 8
_MOST_FIELDS = 400
_MOST_UNROLLED = 4096
"""Largest number of entries in fixed arrays of messages and texts: rosbags generates lines of code for each of them."""
_SIZES = {
    "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "int64": 8, "uint64": 8, "float32": 4, "float64": 8, "float128": 16, "string": 4, "wstring": 4,
}  # fmt: skip
"""Smallest size of a value in bytes, for the types where it is more than 1."""
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


class RosTypes:
    """A message type and the types that it contains.

    Args:
        name: name of the type, as in ROS 1 or ROS 2.
        text: its definition; if empty, the type is looked up among the messages of ROS 2 Humble.
        is_idl: the definition is IDL, not .msg.

    Raises:
        LogError: the name is not a valid ROS type name.
        Exception: the definition cannot be parsed; an exception of rosbags.
    """

    def __init__(self, name: str, text: str, is_idl: bool) -> None:
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

        _check(name)
        self._name = full_name(name)
        self._store: Any = get_typestore(Stores.EMPTY)
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
        self._store.register(found)

    def decoder(self, is_ros1: bool) -> Callable[[bytes], Mapping[str, object]] | None:
        """Return a function that decodes a message of the type into plain fields; None when the type is unknown.

        Raises:
            LogError: a few bytes could describe a message of any size, or a type in it is not defined.
        """
        if self._name not in self._store.fielddefs:
            return None
        _Sizes(self._store.fielddefs).least(self._name)
        decode = self._store.deserialize_ros1 if is_ros1 else self._store.deserialize_cdr

        def decoded(data: bytes) -> Mapping[str, object]:
            value: Any = _plain(decode(data, self._name))
            return value if isinstance(value, dict) else {"data": value}

        return decoded

    def fields(self) -> tuple[LogField, ...]:
        """Return the fields of the type; fields of nested messages have names with dots. Call it after `decoder`, which checks the type."""
        return tuple(islice(self._fields(self._name, "", "", 0), _MOST_FIELDS))

    def _fields(self, name: str, prefix: str, unit: str, depth: int) -> Iterator[LogField]:
        # `decoder` has refused types that contain themselves or nothing, so every type that is visited yields a field.
        if depth > _DEEPEST or name not in self._store.fielddefs:
            yield LogField(prefix.removesuffix("."), name, unit)
            return
        units = _UNITS.get(name, {})
        for field, described in self._store.fielddefs[name][1]:
            path, its_unit = f"{prefix}{field}", units.get(field, unit)
            kind, more = int(described[0]), described[1]
            if kind == 2:  # a message
                yield from self._fields(str(more), f"{path}.", its_unit, depth + 1)
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


def full_name(name: str) -> str:
    """Return the ROS 2 name of a type: ``std_msgs/msg/Header`` also for ``std_msgs/Header`` of ROS 1."""
    return name if name.count("/") != 1 else name.replace("/", "/msg/")


def _check(name: str) -> None:
    if not _NAME.fullmatch(name) or len(name) > 200:
        raise LogError(f"{name[:60]!r} is not a name of a ROS message type")


def _plain(value: Any) -> Any:
    """Return a message as a dictionary; arrays of numbers stay arrays."""
    fields = getattr(value, "__dataclass_fields__", None)
    if fields is not None:
        return {name: _plain(getattr(value, name)) for name in fields if name != "__msgtype__"}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return value
