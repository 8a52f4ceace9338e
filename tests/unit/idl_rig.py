"""Classes of CycloneDDS for types of ROS: an encoder of CDR that shares nothing with ours."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl
from uwserver_adapters.ros.messages.types import ARRAY, BASE, NAME

BASES = {
    "bool": bool, "byte": idl.uint8, "octet": idl.uint8, "char": idl.uint8, "int8": idl.int8, "uint8": idl.uint8, "int16": idl.int16,
    "uint16": idl.uint16, "int32": idl.int32, "uint32": idl.uint32, "int64": idl.int64, "uint64": idl.uint64,
    "float32": idl.float32, "float64": idl.float64, "string": str,
}  # fmt: skip


class Classes:
    """Made of the field table of a store of types, once each."""

    def __init__(self, types):
        self.types = types
        self.made: dict[str, Any] = {}

    def of(self, name):
        if name not in self.made:
            fields = {field: self._kind(described) for field, described in self.types.fields(name)}
            package, kind, short = name.split("/")
            made = make_idl_struct(f"{short}_", f"{package}.{kind}.dds_.{short}_", fields)
            sys.modules[made.__module__].__dict__[made.__name__] = made
            self.made[name] = made
        return self.made[name]

    def _kind(self, described):
        kind, what = described
        if kind == NAME:
            return self.of(what)
        if kind == BASE:
            return BASES[what[0]]
        item, length = what
        return idl.array[self._kind(item), length] if kind == ARRAY else idl.sequence[self._kind(item)]

    def value(self, message):
        """The same message as an object of cyclonedds."""
        name = message.__msgtype__
        fields = {field: self._value(getattr(message, field)) for field, _ in self.types.fields(name)}
        return self.of(name)(**fields)

    def _value(self, value):
        if hasattr(value, "__msgtype__"):
            return self.value(value)
        if isinstance(value, np.ndarray):
            return value.tolist()
        if isinstance(value, list):
            return [self._value(item) for item in value]
        return value

    def cdr(self, message):
        """XCDR1, little endian, with encapsulation."""
        return self.value(message).serialize(use_version_2=False)
