"""Messages of ROS 1 and ROS 2, decoded by the definitions that a log brings along."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from uwserver.logfiles.log import LogError, LogField

_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){1,3}", re.ASCII)
"""Only such names get near rosbags, which makes Python code of them."""
_DEEPEST = 8
_MOST_FIELDS = 400
_MOST_UNROLLED = 4096
"""Entries of fixed arrays of messages and texts: rosbags writes lines of code for each of them."""
_SIZES = {
    "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "int64": 8, "uint64": 8, "float32": 4, "float64": 8, "float128": 16, "string": 4, "wstring": 4,
}  # fmt: skip
"""Least bytes of a value where they are more than one."""
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
"""REP 103, and the comments of the message definitions."""


class Definition(NamedTuple):
    """A type as a log defines it: its name, the text, and whether that is IDL instead of .msg; an empty text where the log has none."""

    name: str
    text: str
    idl: bool


class RosTypes:
    """The types of one log.

    Args:
        definitions: of its channels. What has no text is looked up among the messages that come with ROS 2 (Humble).

    Raises:
        LogError: the name of a type is none of ROS.
        Exception: of rosbags, when a definition cannot be parsed.
    """

    def __init__(self, definitions: Iterable[Definition]) -> None:
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

        self._store: Any = get_typestore(Stores.EMPTY)
        found: dict[str, Any] = {}
        missing: list[str] = []
        for name, text, idl in definitions:
            _check(name)
            if not text:
                missing.append(full_name(name))
            elif idl:
                for part in re.split(r"^=+\n", text, flags=re.MULTILINE):
                    body = part.partition("\n")[2] if part.startswith("IDL: ") else part
                    if body.strip():
                        found.update(get_types_from_idl(body))
            else:
                found.update(get_types_from_msg(text, name))
        if missing:
            known = get_typestore(Stores.ROS2_HUMBLE).fielddefs
            found = {**known, **found}
        for name in found:
            _check(name)
        self._store.register(found)

    def decoder(self, name: str, ros1: bool) -> Callable[[bytes], Mapping[str, object]] | None:
        """What makes the plain fields of a message of this type; None when nobody knows the type.

        Raises:
            LogError: a few bytes of it could ask for any amount of memory, or a type in it is not defined.
        """
        name = full_name(name)
        if name not in self._store.fielddefs:
            return None
        _Sizes(self._store.fielddefs).least(name)
        decode = self._store.deserialize_ros1 if ros1 else self._store.deserialize_cdr

        def decoded(data: bytes) -> Mapping[str, object]:
            value: Any = _plain(decode(data, name))
            return value if isinstance(value, dict) else {"data": value}

        return decoded

    def fields(self, name: str) -> tuple[LogField, ...]:
        """The fields of a type, those of nested messages with dots."""
        found: list[LogField] = []
        for field in self._fields(full_name(name), "", "", 0):
            found.append(field)
            if len(found) >= _MOST_FIELDS:
                break
        return tuple(found)

    def _fields(self, name: str, prefix: str, unit: str, depth: int) -> Iterator[LogField]:
        # `decoder` has refused types that hold themselves or nothing: each that is looked at gives a field.
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
    """Least sizes of the messages of these types, which keep what is decoded in proportion to the bytes of a message."""

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types
        self._known: dict[str, int | None] = {}
        self._unrolled = 0

    def least(self, name: str) -> int:
        """Bytes of the shortest message of a type.

        Raises:
            LogError: it holds itself, a message without a byte, an undefined one, or too long fixed arrays of messages or texts.
        """
        if name in self._known:
            known = self._known[name]
            if known is None:
                raise LogError(f"{name} holds itself, as no type of ROS may")
            return known
        if name not in self._types:
            raise LogError(f"{name} is not defined")
        self._known[name] = None  # as long as it is open
        total = 0
        for field, (kind, more) in self._types[name][1]:
            if field == "structure_needs_at_least_one_member":
                continue  # of an empty type; in ROS 1 it is not there
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
            raise LogError(f"{name}.{field}: a {what} has not one byte: any number of them fits into a message")
        return size


def full_name(name: str) -> str:
    """``std_msgs/msg/Header`` also of ROS 1's ``std_msgs/Header``."""
    return name if name.count("/") != 1 else name.replace("/", "/msg/")


def _check(name: str) -> None:
    if not _NAME.fullmatch(name) or len(name) > 200:
        raise LogError(f"{name[:60]!r} is no name of a ROS message type")


def _plain(value: Any) -> Any:
    """Messages as dictionaries; arrays of numbers stay arrays."""
    fields = getattr(value, "__dataclass_fields__", None)
    if fields is not None:
        return {name: _plain(getattr(value, name)) for name in fields if name != "__msgtype__"}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return value
