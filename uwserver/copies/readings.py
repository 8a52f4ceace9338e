"""The newest samples of a sensor in all copies as arrays by field, and the description of all inputs and outputs of a batch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwserver.copies.parameters import PARAMETERS
from uwserver.modifiers.columns import Columns
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.ports import Field, Port

STATES = (
    ("p_NB", 0, 3, "m", "N", "position of the body origin: north, east, down"),
    ("q_NB", 3, 7, "1", "NB", "attitude, w x y z"),
    ("v_NB_B", 7, 10, "m/s", "B", "velocity of the body origin: forward, starboard, down"),
    ("w_NB_B", 10, 13, "rad/s", "B", "angular rate"),
)
"""Columns of a state: name, first column, end, unit, frame, meaning."""


class Readings(Mapping[str, NDArray[Any]]):
    """The newest delivered samples of one port of n copies: ``readings["depth"]`` is an array (n, *shape of the field).

    Floats are nan if a sensor has no value, and before its first sample; truths are then false, and whole numbers -2**63. Fields of texts
    and buffers are left out. The arrays belong to the caller until these readings are given as ``out=`` to be filled again.

    Attributes:
        port: port of the sensor.
        packed: (n, w) the numbers of all fields, one after the other.
        stamps: (n, 4) seq, t_ns, t_sent_ns, valid.
    """

    def __init__(self, port: Port, n: int) -> None:
        self.port, self._columns = port, Columns(port.fields)
        self.packed: FloatArray = np.full((n, self._columns.width), np.nan)
        self.stamps: IntArray = np.zeros((n, 4), np.int64)
        self._places = {
            field.name: (field, place)
            for field, place in zip(port.fields, self._columns.first, strict=True)
            if place >= 0
        }

    @property
    def seq(self) -> IntArray:
        """(n) number of the sample in the run of its copy, from 0; -1 before the first."""
        return self.stamps[:, 0]

    @property
    def t_ns(self) -> IntArray:
        """(n) simulation time of the copy at which the sample was true, ns; -1 before the first."""
        return self.stamps[:, 1]

    @property
    def t_sent_ns(self) -> IntArray:
        """(n) simulation time of its delivery, ns; -1 before the first."""
        return self.stamps[:, 2]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(n) whether there is a sample, and the sensor could measure."""
        return np.asarray(self.stamps[:, 3] != 0)

    def __getitem__(self, name: str) -> NDArray[Any]:
        field, place = self._places[name]
        part: NDArray[Any] = self.packed[:, place : place + field.size]
        if field.type == "bool":
            part = part == 1.0
        elif field.type == "int":
            part = self.packed.view(np.int64)[:, place : place + field.size].copy()
            part[self.stamps[:, 0] < 0] = -(1 << 63)
        return part.reshape(self.shape_of(name))

    def shape_of(self, name: str) -> tuple[int, ...]:
        """Return the shape (n, *shape) of a field."""
        return len(self.packed), *self._places[name][0].shape

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


def described(
    n: int, rate_hz: float, vehicles: Sequence[str], ports: Mapping[str, Port], commands: Mapping[str, Port]
) -> dict[str, Any]:
    """Return a description of all arrays of a batch.

    Args:
        n: number of copies.
        rate_hz: ticks per second.
        vehicles: vehicles of each copy.
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
