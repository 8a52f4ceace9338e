"""The message types of a ROS distribution: making messages, their CDR and ROS 1 bytes, and the hash and text of a type."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from hashlib import md5
from typing import Any

import numpy as np

from uwserver.adapter import MESSAGE_LIMIT, CannotServe, install_command
from uwserver_adapters.ros.messages.definitions import ACTIONS, MESSAGES, NEWER_MESSAGES, NEWER_REQUESTS, SERVICES

DISTROS: dict[str, str] = {
    "noetic": "ROS1_NOETIC",
    "humble": "ROS2_HUMBLE",
    "jazzy": "ROS2_JAZZY",
    "kilted": "ROS2_KILTED",
    "rolling": "ROS2_LYRICAL",
}
"""Distribution -> the store of rosbags with its types; rolling means the newest that rosbags knows."""

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of fields: a number or text, a message, an array of fixed length, a sequence."""

DTYPES = {
    "bool": "bool", "byte": "uint8", "octet": "uint8", "char": "uint8", "int8": "int8", "uint8": "uint8", "int16": "int16", "uint16": "uint16",
    "int32": "int32", "uint32": "uint32", "int64": "int64", "uint64": "uint64", "float32": "float32", "float64": "float64",
}  # fmt: skip
"""Base types that are numbers -> their numpy types."""

LAST_NS = (1 << 31) * 1_000_000_000 - 1
"""Latest time that a stamp can hold, ns since 1970: in the year 2038."""

_GEOMETRY = ("Vector3", "Point", "Quaternion")

FILLER = "structure_needs_at_least_one_member"
"""The field that messages without fields have in CDR; in ROS 1 they have none."""

MOST_BYTES = 1 << 24
"""Longest message that is decoded, bytes, whoever sent it."""

ARRAY_LIMIT = 1 << 20
"""Longest message of a peer, bytes, if only arrays of numbers in it have no fixed length: these cost no more than their copy."""


class BadMessage(ValueError):
    """A message of a peer is not of its type; the text says where it is wrong."""


class Types:
    """The message, service and action types of one distribution.

    Args:
        distro: one of `DISTROS`.

    Attributes:
        distro: as given.
        is_ros1: whether it is a ROS 1 distribution.
        generated: types made from ports or services -> their text.
        store: the store of rosbags.

    Raises:
        CannotServe: rosbags is not installed, or there is no such distribution.
    """

    def __init__(self, distro: str = "jazzy") -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise CannotServe(f"{error.name} is not installed: {install_command('uwserver[ros]')}") from error
        if distro not in DISTROS:
            raise CannotServe(f'no distribution "{distro}", there are: {", ".join(DISTROS)}')
        self.distro = distro
        self.is_ros1 = distro == "noetic"
        begun, services = _begun(distro)
        self.store: Any = get_typestore(getattr(Stores, DISTROS[distro]))
        self.store.types.update(begun.types)
        self.store.fielddefs.update(begun.fielddefs)
        self._defaults: dict[str, dict[str, Any]] = {}
        self._most_bytes: dict[str, int] = {}
        self._services = set(services)
        self.generated: dict[str, str] = {}
        self._time, self._vector, self._point, self._quaternion = (
            self.store.types[name]
            for name in ("builtin_interfaces/msg/Time", *(f"geometry_msgs/msg/{short}" for short in _GEOMETRY))
        )

    # -- which types there are ---------------------------------------------------------------------------------------------------------

    def register(self, name: str, text: str) -> None:
        """Add a message type.

        Args:
            name: ``package/msg/Name``.
            text: text of its .msg file, with nested types by their full names.
        """
        _register(self.store, {name: text})
        self.generated[name] = text

    def register_service(self, name: str, request: str, response: str) -> None:
        """Add a service type ``package/srv/Name``."""
        _register(self.store, _service(name, request, response))
        self._services.add(name)

    def register_action(self, name: str, goal: str, result: str, feedback: str) -> None:
        """Add an action type ``package/action/Name``: its messages and services."""
        messages, services = _action(name, goal, result, feedback)
        _register(self.store, messages)
        for service, parts in services.items():
            self.register_service(service, *parts)

    def __contains__(self, name: str) -> bool:
        """Return whether a message type is known, by its full name."""
        return name in self.store.fielddefs

    def has_service(self, name: str) -> bool:
        """Return whether a service type is known, by its full name."""
        return name in self._services

    def fields(self, name: str) -> list[tuple[str, Any]]:
        """Return name and description of each field of a message type. A description is a kind and its details, as rosbags has them."""
        return list(self.store.fielddefs[name][1])

    # -- making ------------------------------------------------------------------------------------------------------------------------

    def make(self, name: str, /, **given: object) -> object:
        """Return a message. Fields that are not given are zero or empty.

        Given fields that the type does not have in this distribution are left out (``variance`` of Range in humble).
        """
        fields = self._defaults.get(name)
        if fields is None:
            fields = self._defaults[name] = {field: self._zero(described) for field, described in self.fields(name)}
        if given.keys() <= fields.keys():
            return self.store.types[name](**{**fields, **given})
        return self.store.types[name](**{key: given.get(key, value) for key, value in fields.items()})

    def filled(self, name: str, field: str, value: Any) -> Any:
        """Return a value as a field of a message holds it: a list of numbers becomes an array."""
        dtype = numeric_items(dict(self.fields(name))[field])
        return value if dtype is None else np.array(value, dtype)

    def _zero(self, described: Any) -> Any:
        kind, what = described
        if kind == NAME:
            return self.make(what)
        if kind == BASE:
            return {"string": "", "bool": False}.get(what[0], 0.0 if what[0].startswith("float") else 0)
        item, length = what
        length = length if kind == ARRAY else 0
        dtype = numeric_items(described)
        return [self._zero(item) for _ in range(length)] if dtype is None else np.zeros(length, dtype)

    def stamp(self, t_ns: int) -> object:
        """Return a time, as headers and Clock hold it, from ns since 1970; a time beyond their 31 bits of seconds becomes the nearest in them."""
        t_ns = min(max(t_ns, 0), LAST_NS)
        return self._time(sec=t_ns // 1_000_000_000, nanosec=t_ns % 1_000_000_000)

    def header(self, t_ns: int, frame: str) -> object:
        """Return a Header; `t_ns` is ns since 1970."""
        return self.make("std_msgs/msg/Header", stamp=self.stamp(t_ns), frame_id=frame)

    def vector(self, v: Any) -> object:
        """Return a Vector3."""
        return self._vector(*v)

    def point(self, v: Any) -> object:
        """Return a Point."""
        return self._point(*v)

    def quaternion(self, q: Any) -> object:
        """Return a Quaternion from w x y z."""
        w, x, y, z = q
        return self._quaternion(x, y, z, w)

    # -- bytes -------------------------------------------------------------------------------------------------------------------------

    def cdr(self, message: Any) -> bytes:
        """Return the CDR of a message (XCDR1, little endian) with its encapsulation."""
        return bytes(self.store.serialize_cdr(message, message.__msgtype__, little_endian=True))

    def most_bytes(self, name: str) -> int:
        """Return the length of the longest message of a type that is taken from a peer, bytes.

        The limit is low where decoding is slow, for lists of texts or messages: everybody else waits meanwhile.
        """
        known = self._most_bytes.get(name)
        if known is None:
            known = self._most_bytes[name] = ARRAY_LIMIT if self._is_cheap((NAME, name)) else MESSAGE_LIMIT
        return known

    def _is_cheap(self, described: Any) -> bool:
        """Return whether only arrays of numbers have no fixed length in it."""
        kind, what = described
        if kind == NAME:
            return all(self._is_cheap(field) for _, field in self.fields(what))
        if kind == BASE:
            return what[0] in DTYPES
        return numeric_items(described) is not None or (kind == ARRAY and self._is_cheap(what[0]))

    def from_cdr(self, data: bytes, name: str, most: int = MOST_BYTES) -> Any:
        """Return a message from CDR with its encapsulation.

        Args:
            data: the bytes.
            name: name of the type.
            most: longest message that is taken; for one of a peer `most_bytes` of its type.

        Raises:
            BadMessage: the bytes are not of this type, or too many.
        """
        return self._decoded(self.store.deserialize_cdr, data, name, most)

    def ros1(self, message: Any) -> bytes:
        """Return the ROS 1 bytes of a message, without their length."""
        if self._is_empty(message.__msgtype__):
            return b""
        return bytes(self.store.serialize_ros1(message, message.__msgtype__))

    def from_ros1(self, data: bytes, name: str, most: int = MOST_BYTES) -> Any:
        """Return a message from ROS 1 bytes, which come without their length; otherwise as `from_cdr`.

        Raises:
            BadMessage: the bytes are not of this type, or too many.
        """
        if self._is_empty(name) and not data:
            return self.make(name)
        return self._decoded(self.store.deserialize_ros1, data, name, most)

    def _is_empty(self, name: str) -> bool:
        """Return whether a type has no fields; in ROS 1 its messages have no bytes."""
        return [field for field, _ in self.fields(name)] == [FILLER]

    def _decoded(self, decode: Any, data: bytes, name: str, most: int) -> Any:
        if len(data) > most:
            raise BadMessage(f"{name}: more than {most} bytes, send less at once")
        try:
            return decode(data, name)
        # The bytes may be hostile. rosbags raises its own error for most faults, but not for every wrong length.
        except Exception as error:  # noqa: BLE001
            raise BadMessage(f"{name}: {len(data)} bytes that are not of this type: {error}") from None

    # -- what a type is called ---------------------------------------------------------------------------------------------------------

    def hash(self, name: str) -> str:
        """Return the RIHS01 hash of a message or service type. humble has no hashes: its rmw writes a fixed word instead."""
        if self.distro == "humble":
            return "TypeHashNotSupported"
        if name in self._services and name not in self.store.fielddefs:
            self._register_description(name)
        return str(self.store.hash_rihs01(name))

    def _register_description(self, name: str) -> None:
        """Register a service as a message of its three parts, of which its hash is made."""
        request, response, event = f"{name}_Request", f"{name}_Response", f"{name}_Event"
        one = 1
        info = "service_msgs/msg/ServiceEventInfo"
        # rosidl hashes a char of a .msg file as uint8, rosbags as char.
        self.store.fielddefs[info] = ([], [
            (key, (ARRAY, ((BASE, ("uint8", 0)), 16)) if key == "client_gid" else described) for key, described in self.fields(info)
        ])  # fmt: skip
        self.store.register({
            event: ([], [
                ("info", (NAME, info)),
                ("request", (SEQUENCE, ((NAME, request), one))),
                ("response", (SEQUENCE, ((NAME, response), one))),
            ]),
            name: ([], [
                ("request_message", (NAME, request)), ("response_message", (NAME, response)), ("event_message", (NAME, event)),
            ]),
        })  # fmt: skip

    def md5(self, name: str) -> str:
        """Return the MD5 sum of a message or service type, as ROS 1 computes it."""
        if name in self._services:
            text = self._md5_text(f"{name}_Request") + self._md5_text(f"{name}_Response")
            return md5(text.encode()).hexdigest()
        return str(self.store.generate_msgdef(name, ros_version=1)[1])

    def _md5_text(self, name: str) -> str:
        constants, fields = self.store.fielddefs[name]
        lines = [f"{kind} {key}={value}" for key, kind, value in constants]
        for key, described in fields:
            if key == FILLER:
                continue
            kind, what = described
            suffix = ""
            if kind in (ARRAY, SEQUENCE):
                suffix = f"[{what[1]}]" if kind == ARRAY else "[]"
                kind, what = what[0]
            lines.append(f"{self.md5(str(what))} {key}" if kind == NAME else f"{what[0]}{suffix} {key}")
        return "\n".join(lines)

    def text(self, name: str) -> str:
        """Return the .msg text of a type, followed by those of its nested types."""
        return str(self.store.generate_msgdef(name, ros_version=1 if self.is_ros1 else 2)[0])


@cache
def _begun(distro: str) -> tuple[Any, frozenset[str]]:
    """Return what every `Types` of a distribution starts from: a store of rosbags with our own types in it, and the names of services.

    The store is kept as it takes a while to make.
    """
    from rosbags.typesys import Stores, get_typestore

    store: Any = get_typestore(getattr(Stores, DISTROS[distro]))
    is_ros1, is_newest = distro == "noetic", distro == "rolling"
    messages = {**MESSAGES, **(NEWER_MESSAGES if is_newest else {})}
    texts = {name: text for name, text in messages.items() if name not in store.fielddefs}
    services = {
        name: ((NEWER_REQUESTS.get(name) if is_newest else None) or request, response)
        for name, (request, response) in SERVICES.items()
        if not (is_ros1 and name.startswith("rcl_interfaces/"))
    }
    for name, parts in {} if is_ros1 else ACTIONS.items():
        own_messages, own_services = _action(name, *parts)
        texts |= own_messages
        services |= own_services
    for name, (request, response) in services.items():
        texts |= _service(name, request, response)
    _register(store, texts)
    return store, frozenset(services)


def _action(name: str, goal: str, result: str, feedback: str) -> tuple[dict[str, str], dict[str, tuple[str, str]]]:
    """Return the messages and services that an action consists of."""
    key = "unique_identifier_msgs/UUID goal_id"
    messages = {
        f"{name}_Goal": goal, f"{name}_Result": result, f"{name}_Feedback": feedback,
        f"{name}_FeedbackMessage": f"{key}\n{name}_Feedback feedback",
    }  # fmt: skip
    services = {
        f"{name}_SendGoal": (f"{key}\n{name}_Goal goal", "bool accepted\nbuiltin_interfaces/Time stamp"),
        f"{name}_GetResult": (key, f"int8 status\n{name}_Result result"),
    }
    return messages, services


def _service(name: str, request: str, response: str) -> dict[str, str]:
    return {f"{name}_Request": request, f"{name}_Response": response}


def _register(store: Any, texts: Mapping[str, str]) -> None:
    from rosbags.typesys import get_types_from_msg

    made: Any = {}
    fields: Any
    for name, text in texts.items():
        ((constants, fields),) = get_types_from_msg(text.strip() or "\n", name).values()
        if not fields:
            fields = [(FILLER, (BASE, ("uint8", 0)))]
        made[name] = (constants, fields)
    store.register(made)


def numeric_items(described: Any) -> str | None:
    """Return the numpy type of a field that is a list of numbers; None for other fields."""
    kind, what = described
    is_numeric = kind in (ARRAY, SEQUENCE) and what[0][0] == BASE
    return DTYPES.get(what[0][1][0]) if is_numeric else None


def dds_name(name: str) -> str:
    """Return the DDS name of a message type, or of a request or response type."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def full_name(name: str, kind: str = "msg") -> str:
    """Return ``package/msg/Name`` for a type in any of the spellings that clients use."""
    parts = name.strip("/").split("/")
    return f"{parts[0]}/{kind}/{parts[-1]}" if len(parts) in (2, 3) else name
