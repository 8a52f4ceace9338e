"""Ports that have no message of their own in a format, and why."""

from __future__ import annotations

from collections.abc import Collection

from uwserver.logfiles.mapping import Mapping

_MESSAGES = (
    frozenset({"pressure"}),
    frozenset({"latitude", "longitude"}),
    frozenset({"f_S", "w_S"}),
    frozenset({"range"}),
)
"""Fields of a port by which MAVLink and ROS have a message for it: pressure, position fix, inertial unit, distance."""
_SCANNING = "head_angle"
"""A scanning head's range is none of a distance sensor."""


def left_out(mapping: Mapping, written: Collection[str]) -> list[str]:
    """Sentences about the ports of a mapping that gave no message.

    Args:
        mapping: of the log.
        written: ports that gave at least one.
    """
    absent = {name: source.fields.keys() for name, source in mapping.ports.items() if name not in written}
    silent = [name for name, fields in absent.items() if _has_message(fields)]
    foreign = [name for name in absent if name not in silent]
    told = [f"no message fits, so left out: {', '.join(foreign)}"] if foreign else []
    if silent:
        told.append(f"no sample was valid, so nothing is written of: {', '.join(silent)}")
    return told


def _has_message(fields: Collection[str]) -> bool:
    return any(wanted <= set(fields) and not (wanted == {"range"} and _SCANNING in fields) for wanted in _MESSAGES)
