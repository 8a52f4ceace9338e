"""Classes of CycloneDDS for ROS message types, made from the fields of a distribution's types."""

from __future__ import annotations

import sys
from typing import Any

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl

from uwserver_adapters.ros.messages.types import ARRAY, BASE, NAME, Types

_BASES = {
    "bool": bool, "byte": idl.uint8, "octet": idl.uint8, "char": idl.uint8, "int8": idl.int8, "uint8": idl.uint8, "int16": idl.int16,
    "uint16": idl.uint16, "int32": idl.int32, "uint32": idl.uint32, "int64": idl.int64, "uint64": idl.uint64,
    "float32": idl.float32, "float64": idl.float64, "string": str,
}  # fmt: skip
HEADER = {"client_guid": idl.uint64, "sequence_number": idl.int64}
"""Fields that rmw_cyclonedds puts in front of those of a request or response."""


class Raw:
    """A message as bytes: encapsulation and body."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: object = None


class Classes:
    """Makes the class of each type once, when it is first asked for.

    Args:
        types: message types of the distribution.
    """

    def __init__(self, types: Types) -> None:
        self._types = types
        self._made: dict[tuple[str, bool, bool], Any] = {}

    def of(self, name: str, in_service: bool = False) -> Any:
        """Return the class of a message type; with a header in front for requests and responses of a service."""
        return self._class(name, in_service, False)

    def raw(self, name: str, in_service: bool = False) -> Any:
        """Return a class of the same type whose samples are read as `Raw`."""
        return self._class(name, in_service, True)

    def _class(self, name: str, in_service: bool, is_raw: bool) -> Any:
        key = (name, in_service, is_raw)
        if key in self._made:
            return self._made[key]
        fields = dict(HEADER) if in_service else {}
        fields |= {field: self._kind(described) for field, described in self._types.fields(name)}
        package, kind, short = name.split("/")
        made: Any = make_idl_struct(f"{short}_", f"{package}.{kind}.dds_.{short}_", fields)
        if is_raw:
            made.deserialize = staticmethod(lambda data, *_, **__: Raw(bytes(data)))
        else:
            # cyclonedds looks up nested types by name in the module that a class says it is in.
            setattr(sys.modules[made.__module__], made.__name__, made)
        self._made[key] = made
        return made

    def _kind(self, described: Any) -> Any:
        kind, what = described
        if kind == NAME:
            return self.of(what)
        if kind == BASE:
            return _BASES[what[0]]
        item, length = what
        array: Any = idl.array
        sequence: Any = idl.sequence
        return array[self._kind(item), length] if kind == ARRAY else sequence[self._kind(item)]
