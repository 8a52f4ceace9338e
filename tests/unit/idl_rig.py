"""An encoder of CDR that shares nothing with ours: CycloneDDS' own, of objects."""

from __future__ import annotations

import numpy as np
from uwserver_adapters.ros2 import idl


class Classes(idl.Classes):
    """With what a test compares."""

    def value(self, message):
        """The same message as an object of cyclonedds."""
        name = message.__msgtype__
        fields = {field: self._value(getattr(message, field)) for field, _ in self._types.fields(name)}
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
