"""The kinds of sensors for which both MAVLink and ROS have a message, and remarks about ports that are of none of them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any, Literal

from uwserver.logfiles.mapping import Mapping as LogMapping

MessageKind = Literal["imu", "pressure", "fix", "range"]
_FIELDS: Mapping[MessageKind, frozenset[str]] = {
    "imu": frozenset({"f_S", "w_S"}),
    "pressure": frozenset({"pressure"}),
    "fix": frozenset({"latitude", "longitude"}),
    "range": frozenset({"range"}),
}
_SCANNING = "head_angle"
"""The range of a scanning head is not that of a distance sensor."""


def message_kind(fields: Collection[str]) -> MessageKind | None:
    """Return the kind of message for a port with these fields; None when there is none."""
    for kind, wanted in _FIELDS.items():
        if wanted <= set(fields) and not (kind == "range" and _SCANNING in fields):
            return kind
    return None


def sample_kind(value: Mapping[str, Any]) -> MessageKind | None:
    """Return the kind of message for a sample; None when there is none, or the sample has not all its numbers."""
    return message_kind([name for name, part in value.items() if name == _SCANNING or _is_complete(name, part)])


def _is_complete(name: str, value: object) -> bool:
    """Return whether a field has its finite numbers: three for a vector of an inertial unit, one for any other field."""
    is_vector = name in _FIELDS["imu"]
    numbers = value if isinstance(value, tuple) else (value,)
    is_numeric = all(isinstance(number, int | float) and math.isfinite(number) for number in numbers)
    return is_numeric and isinstance(value, tuple) == is_vector and len(numbers) == (3 if is_vector else 1)


def left_out(mapping: LogMapping, written: Collection[str]) -> list[str]:
    """Return remarks about the ports of a mapping that gave no message.

    Args:
        mapping: the mapping of the log.
        written: the ports that gave at least one message.
    """
    absent = {name: message_kind(source.fields) for name, source in mapping.ports.items() if name not in written}
    without_message = [name for name, kind in absent.items() if kind is None]
    without_sample = [name for name, kind in absent.items() if kind is not None]
    remarks = [f"left out, because no message fits: {', '.join(without_message)}"] if without_message else []
    if without_sample:
        remarks.append(f"left out, because no sample was valid: {', '.join(without_sample)}")
    return remarks
