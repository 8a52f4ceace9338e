"""What a manoeuvre gives: a table of figures, in SI and radians, and how they are read from a track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.units import deg
from uwserver.validation.manoeuvres.runs import Track

Value = float | None
"""None where there is nothing to tell: it did not get there."""
APPROACH_S, TURNING_S = 120.0, 200.0
"""Straight ahead before a manoeuvre, and what follows."""


@dataclass(frozen=True)
class Column:
    """What is read: its name and unit; `key` for programs."""

    key: str
    name: str
    unit: str


@dataclass(frozen=True)
class Row:
    """Figures of one run, in the order of the trial's columns."""

    condition: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Trial:
    """One manoeuvre.

    Attributes:
        key: for programs.
        text: how it is done.
        rows: none where it does not apply.
        reason: why it does not.
    """

    key: str
    title: str
    text: str
    columns: tuple[Column, ...] = ()
    rows: tuple[Row, ...] = ()
    reason: str = ""

    def value(self, condition: str, key: str) -> Value:
        """One figure; None too where there is no such run."""
        k = next((k for k, column in enumerate(self.columns) if column.key == key), -1)
        return next((row.values[k] for row in self.rows if row.condition == condition), None) if k >= 0 else None


BY_THRUST, ON_THE_SPOT = "ahead 50 %, yaw 50 %", "on the spot, yaw 100 %"
"""How turns by thrusters are called."""


def ahead(throttle: float) -> str:
    """How a straight run is called."""
    return f"{'astern' if throttle < 0.0 else 'ahead'} {abs(100.0 * throttle):g} %"


def turn_told(throttle: float, angle: float) -> str:
    """How a turn by rudder (rad) is called."""
    return f"{ahead(throttle)}, rudder {degrees(angle)}"


def degrees(angle: float) -> str:
    """An angle (rad) for people."""
    return f"{round(deg(angle), 2):g} degrees"


def mean(values: FloatArray) -> float:
    """Of a series."""
    return float(values.mean())


def settled(values: FloatArray) -> Value:
    """The mean of what no longer changes by more than a tenth of it; None of anything else."""
    average = mean(values)
    return average if float(np.ptp(values)) <= 0.1 * abs(average) + 0.005 else None


def first_time(t: FloatArray, reached: npt.NDArray[np.bool_]) -> Value:
    """When a condition (k) holds for the first time, s."""
    k = np.flatnonzero(reached)
    return float(t[k[0]]) if len(k) else None


def level(track: Track) -> tuple[FloatArray, FloatArray]:
    """North and east velocity, m/s."""
    dt = float(track.t[1] - track.t[0])
    return np.gradient(track.states[:, 0], dt), np.gradient(track.states[:, 1], dt)
