"""The inputs and outputs of a batch, as plain values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from uwserver.copies.parameters import PARAMETERS
from uwserver.modifiers.columns import Columns
from uwserver.ports import Field

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from uwserver.ports import Port

STATES = (
    ("p_NB", 0, 3, "m", "N", "position of the body origin: north, east, down"),
    ("q_NB", 3, 7, "1", "NB", "attitude, w x y z"),
    ("v_NB_B", 7, 10, "m/s", "B", "velocity of the body origin: forward, starboard, down"),
    ("w_NB_B", 10, 13, "rad/s", "B", "angular rate"),
)
"""Columns of a state: name, first column, end, unit, frame, meaning."""


def described(
    n: int, rate_hz: float, vehicles: Sequence[str], ports: Mapping[str, Port], commands: Mapping[str, Port]
) -> dict[str, Any]:
    """Return a description of all arrays of a batch.

    Args:
        n: number of copies.
        rate_hz: ticks per second.
        vehicles: of each copy.
        ports: the sensors that measure.
        commands: the actuators.
    """
    return {
        "copies": n,
        "rate_hz": rate_hz,
        "vehicles": list(vehicles),
        "states": {
            "shape": [n, STATES[-1][2]],
            "columns": [
                {"name": name, "first": first, "end": end, "unit": unit, "frame": frame, "doc": doc}
                for name, first, end, unit, frame, doc in STATES
            ],
        },
        "sensors": {
            path: {
                "kind": port.kind,
                "rate_hz": port.rate_hz,
                "doc": port.doc,
                "fields": {
                    field.name: _field(field, n)
                    for field, place in zip(port.fields, Columns(port.fields).first, strict=True)
                    if place >= 0
                },
            }
            for path, port in ports.items()
        },
        "commands": {
            path: {
                "kind": port.kind,
                "timeout_s": port.timeout_s,
                "doc": port.doc,
                "fields": {
                    f.name: {**_field(f, n), "minimum": f.minimum, "maximum": f.maximum}
                    for f in port.fields
                    if f.type == "float"
                },
            }
            for path, port in commands.items()
        },
        "parameters": {
            name: {
                "shape": [n, *each.shape],
                "unit": each.unit,
                "minimum": each.minimum,
                "maximum": each.maximum,
                "doc": each.doc,
            }
            for name, each in PARAMETERS.items()
        },
    }


def _field(field: Field, n: int) -> dict[str, Any]:
    return {
        "shape": [n, *field.shape],
        "type": field.type,
        "unit": field.unit,
        "frame": field.frame,
        "doc": field.doc,
    }
