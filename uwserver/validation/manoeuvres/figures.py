"""The results of a manoeuvre: a table of figures in SI units and radians, and functions that read figures from a track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.units import deg
from uwserver.validation.manoeuvres.runs import Track

Value = float | None
"""A figure; None if the vehicle did not get that far."""
APPROACH_S, TURNING_S = 120.0, 200.0
"""Time straight ahead before a manoeuvre, and time of the manoeuvre."""


@dataclass(frozen=True)
class Column:
    """A figure that is read from each run: its name and unit, and a `key` for programs."""

    key: str
    name: str
    unit: str


@dataclass(frozen=True)
class Row:
    """The figures of one run, in the order of the trial's columns."""

    condition: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Trial:
    """A manoeuvre and its figures.

    Attributes:
        key: name for programs.
        title: name for people.
        text: how the manoeuvre is done.
        columns: the figures.
        rows: the runs; none if the manoeuvre does not apply.
        reason: why it does not apply.
    """

    key: str
    title: str
    text: str = ""
    columns: tuple[Column, ...] = ()
    rows: tuple[Row, ...] = ()
    reason: str = ""

    def value(self, condition: str, key: str) -> Value:
        """Return a figure; None also if there is no such run or column."""
        places = {column.key: k for k, column in enumerate(self.columns)}
        return next(
            (row.values[places[key]] for row in self.rows if row.condition == condition and key in places), None
        )


BY_THRUST, ON_THE_SPOT = "ahead 50 %, yaw 50 %", "on the spot, yaw 100 %"
"""Names of turns by thrusters."""


def ahead(throttle: float) -> str:
    """Return the name of a straight run."""
    return f"{'astern' if throttle < 0.0 else 'ahead'} {abs(100.0 * throttle):g} %"


def turn_told(throttle: float, angle: float) -> str:
    """Return the name of a turn by rudder (rad)."""
    return f"{ahead(throttle)}, rudder {degrees(angle)}"


def degrees(angle: float) -> str:
    """Return an angle (rad) in degrees, as text."""
    return f"{round(deg(angle), 2):g} degrees"


def mean(values: FloatArray) -> float:
    """Return the mean of a series."""
    return float(values.mean())


def steady_mean(values: FloatArray) -> Value:
    """Return the mean of a series that changes by no more than a tenth of it, or else None."""
    average = mean(values)
    return average if float(np.ptp(values)) <= 0.1 * abs(average) + 0.005 else None


def first_time(t: FloatArray, reached: npt.NDArray[np.bool_]) -> Value:
    """Return the first of the times (k) at which a condition (k) holds, s."""
    k = np.flatnonzero(reached)
    return float(t[k[0]]) if len(k) else None


def level(track: Track) -> tuple[FloatArray, FloatArray]:
    """Return the velocities (k) to north and east, m/s."""
    dt = float(track.t[1] - track.t[0])
    return np.gradient(track.states[:, 0], dt), np.gradient(track.states[:, 1], dt)
