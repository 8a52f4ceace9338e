"""Parameters with the names and defaults of ArduSub. Those that mean something in the simulation take effect (docs/reference/mavlink.md).

`parameters.json` holds type and default of each: the ones that take effect, and the ones that QGroundControl and Cockpit request by name.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from importlib.resources import files

import msgspec

from uwserver_adapters.mavlink.wire.channel import Outgoing
from uwserver_adapters.mavlink.wire.dialect import Fields

_RANGES = {"int8": (-0x80, 0x7F), "int16": (-0x8000, 0x7FFF), "int32": (-0x8000_0000, 0x7FFF_FFFF)}
_WIRE_TYPES = {"int8": 2, "int16": 4, "int32": 6, "real32": 9}
"""Numbers of MAV_PARAM_TYPE."""
PACKED = {"int8": (1, "b"), "int16": (2, "h"), "int32": (3, "i"), "real32": (4, "f")}
"""Number and format of a type in a packed parameter file."""
READ_ONLY = frozenset({"MAV_SYSID", "FORMAT_VERSION", "STAT_BOOTCNT", "STAT_RUNTIME", "STAT_FLTTIME", "MIS_TOTAL"})
"""Parameters that only the scenario may set."""


class Parameters:
    """All parameters. Values last until the adapter ends.

    Args:
        given: values that differ from the defaults, by name.

    Attributes:
        names: all names, in the order of their index.

    Raises:
        ValueError: a given name does not exist, or a value is not allowed. The text says which.
    """

    def __init__(self, given: Mapping[str, float]) -> None:
        text = files(__package__).joinpath("parameters.json").read_bytes()
        table = msgspec.json.decode(text, type=dict[str, tuple[str, float]])
        self._types = {name: kind for name, (kind, _) in table.items()}
        self._defaults = {name: float(value) for name, (_, value) in table.items()}
        self._values = dict(self._defaults)
        self.names = tuple(table)
        self._packed: dict[bool, bytes] = {}
        self._places = {name: index for index, name in enumerate(self.names)}
        for name, value in given.items():
            if not self.set(name, value, is_trusted=True):
                raise ValueError(
                    f'parameters: "{name}" = {value!r}: there is no such parameter, or it cannot have that value'
                )

    @property
    def gcs_system(self) -> int:
        """System number of the ground station that may steer."""
        return round(self._values["MAV_GCS_SYSID"])

    def value(self, name: str) -> float:
        """Return the value of a parameter."""
        return self._values[name]

    def set(self, name: str, value: float, is_trusted: bool = False) -> bool:
        """Set a parameter, truncated if its type is an integer. Only a trusted caller sets `READ_ONLY` ones.

        Returns:
            False for an unknown name, a value that is not finite or does not fit the type, and a read-only parameter.
        """
        if name not in self._values or not math.isfinite(value) or (name in READ_ONLY and not is_trusted):
            return False
        self._packed.clear()
        kind = self._types[name]
        if kind == "real32":
            if abs(value) > 3.4e38:
                return False
            self._values[name] = struct.unpack("<f", struct.pack("<f", value))[0]
            return True
        low, high = _RANGES[kind]
        whole = math.trunc(value)  # ArduPilot casts in C: 3.7 becomes 3
        if not low <= whole <= high:
            return False
        self._values[name] = float(whole)
        return True

    def at(self, index: int) -> str | None:
        """Return the name at an index, None where there is none."""
        return self.names[index] if 0 <= index < len(self.names) else None

    def message(self, name: str, is_answer_to_set: bool = False) -> Fields:
        """Return the fields of PARAM_VALUE. The value is a float for every type, as in ArduPilot."""
        return {
            "param_id": name,
            "param_value": self._values[name],
            "param_type": _WIRE_TYPES[self._types[name]],
            "param_count": len(self.names),
            "param_index": 0xFFFF if is_answer_to_set else self._places[name],
        }

    def download(self) -> Iterator[Outgoing]:
        """Yield one message for each parameter, with the value at the time when it is sent."""
        for name in self.names:
            yield "PARAM_VALUE", self.message(name)

    def packed(self, with_defaults: bool) -> bytes:
        """Return the file `@PARAM/param.pck`, in which a name leaves out what it shares with the name before.

        The file is kept until a parameter is set: it takes 0.8 ms to build, and a peer may open it 2000 times a second.

        Args:
            with_defaults: add the defaults where they differ from the values.
        """
        if with_defaults not in self._packed:
            self._packed[with_defaults] = self._pack(with_defaults)
        return self._packed[with_defaults]

    def _pack(self, with_defaults: bool) -> bytes:
        names = sorted(self.names)
        out = bytearray(struct.pack("<HHH", 0x671C if with_defaults else 0x671B, len(names), len(names)))
        before = ""
        for name in names:
            common = 0
            while common < min(len(before), len(name) - 1, 15) and before[common] == name[common]:
                common += 1
            number, form = PACKED[self._types[name]]
            value, default = self._values[name], self._defaults[name]
            has_default = with_defaults and value != default
            tail = name[common:].encode("ascii")
            # Type and a flag for a default; then how many characters are shared with the name before, and how many follow, less one.
            out += bytes((number | (0x10 if has_default else 0), common | (len(tail) - 1) << 4)) + tail
            for item in (value, default) if has_default else (value,):
                out += struct.pack(f"<{form}", item if form == "f" else int(item))
            before = name
        return bytes(out)
