"""Parameters as ground stations know them: names and values after ArduSub, those that mean something here honoured (docs/reference/mavlink.md).

`parameters.json` holds type and default of each: what we honour, and what QGroundControl and Cockpit ask for by name.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from importlib.resources import files

import msgspec

from uwserver_adapters.mavlink.wire.channel import Out
from uwserver_adapters.mavlink.wire.dialect import Fields

_WIRE_TYPES = {"uint8": 1, "int8": 2, "uint16": 3, "int16": 4, "uint32": 5, "int32": 6, "real32": 9}
_RANGES = {
    "uint8": (0, 0xFF),
    "int8": (-0x80, 0x7F),
    "uint16": (0, 0xFFFF),
    "int16": (-0x8000, 0x7FFF),
    "uint32": (0, 0xFFFF_FFFF),
    "int32": (-0x8000_0000, 0x7FFF_FFFF),
}
PACKED = {"int8": (1, "b"), "int16": (2, "h"), "int32": (3, "i"), "real32": (4, "f")}
"""Number and format of a type in a packed parameter file."""
READ_ONLY = frozenset({"MAV_SYSID", "FORMAT_VERSION", "STAT_BOOTCNT", "STAT_RUNTIME", "STAT_FLTTIME", "MIS_TOTAL"})


class Parameters:
    """All parameters. Values are kept until the adapter ends.

    Args:
        given: values that differ from the defaults, by name.

    Raises:
        ValueError: a given name or value that is none; says which.
    """

    def __init__(self, given: Mapping[str, float]) -> None:
        text = files(__package__).joinpath("parameters.json").read_bytes()
        table = msgspec.json.decode(text, type=dict[str, tuple[str, float]])
        self._types = {name: kind for name, (kind, _) in table.items()}
        self._defaults = {name: float(value) for name, (_, value) in table.items()}
        self._values = dict(self._defaults)
        self._names = tuple(table)
        self._packed: dict[bool, bytes] = {}
        self._places = {name: index for index, name in enumerate(self._names)}
        for name, value in given.items():
            if not self.set(name, value, is_trusted=True):
                raise ValueError(
                    f'parameters: "{name}" = {value!r}: there is no such parameter, or it cannot have that value'
                )

    def __len__(self) -> int:
        return len(self._names)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in the order of their index."""
        return self._names

    @property
    def gcs_system(self) -> int:
        """Number of the ground station that may steer."""
        return round(self._values["MAV_GCS_SYSID"])

    def value(self, name: str) -> float:
        """Value of a parameter."""
        return self._values[name]

    def default(self, name: str) -> float:
        """Its value before anybody set it."""
        return self._defaults[name]

    def kind(self, name: str) -> str:
        """Its type: int8, int16, int32 or real32."""
        return self._types[name]

    def set(self, name: str, value: float, is_trusted: bool = False) -> bool:
        """Set one, rounded as its type has it.

        Returns:
            False for an unknown name, NaN or infinity, what the type cannot hold, and for what only the scenario may set.
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
        whole = math.trunc(value)  # a cast of C, as ArduPilot does it: 3.7 becomes 3
        if not low <= whole <= high:
            return False
        self._values[name] = float(whole)
        return True

    def at(self, index: int) -> str | None:
        """Name at an index."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def message(self, name: str, is_answer_to_set: bool = False) -> Fields:
        """Fields of PARAM_VALUE: the value as a float whatever the type is, as ArduPilot has it."""
        return {
            "param_id": name,
            "param_value": self._values[name],
            "param_type": _WIRE_TYPES[self._types[name]],
            "param_count": len(self._names),
            "param_index": 0xFFFF if is_answer_to_set else self._places[name],
        }

    def download(self) -> Iterator[Out]:
        """All of them, one message each; values as they are when a message goes out."""
        for name in self._names:
            yield "PARAM_VALUE", self.message(name)

    def packed(self, with_defaults: bool) -> bytes:
        """The file `@PARAM/param.pck`: name parts that the parameter before had too are left out. Kept until a parameter is set, as it takes
        0.8 ms, and a peer may open it 2000 times a second.

        Args:
            with_defaults: also the defaults, where they differ.
        """
        if with_defaults not in self._packed:
            self._packed[with_defaults] = self._pack(with_defaults)
        return self._packed[with_defaults]

    def _pack(self, with_defaults: bool) -> bytes:
        names = sorted(self._names)
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
            out += bytes((number | (0x10 if has_default else 0), common | (len(tail) - 1) << 4)) + tail
            for item in (value, default) if has_default else (value,):
                out += struct.pack(f"<{form}", item if form == "f" else int(item))
            before = name
        return bytes(out)
