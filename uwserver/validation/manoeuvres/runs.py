"""Runs of one vehicle side by side, each a row of one world with a plan of its own that moves the sticks, and the figures that are read from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uwserver.frames import multiply, quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, STATE_SIZE, P, Q
from uwserver.units import deg
from uwserver.validation.manoeuvres.helm import DEPTH, Helm, Sticks

DT = 0.02
"""Length of a tick, s."""
FLOATING = 1.2
"""Ratio of buoyancy to weight from which a vehicle is a surface vessel; ROVs and AUVs are neutral within a few percent."""
_SETTLING_S = 120.0

Plan = Callable[[float, FloatArray], Sticks]
"""Returns the sticks at a time (s) and a state (13)."""
APPROACH_S, TURNING_S = 120.0, 200.0
"""Time straight ahead before a manoeuvre, and time of the manoeuvre."""
BY_THRUST, ON_THE_SPOT = "ahead 50 %, yaw 50 %", "on the spot, yaw 100 %"
"""Names of turns by thrusters."""


@dataclass(frozen=True, eq=False)
class Track:
    """The track of a run.

    Attributes:
        t: (k) times, s.
        states: (k, 13) states: p_NB, q_NB, nu.
    """

    t: FloatArray
    states: FloatArray

    @property
    def p(self) -> FloatArray:
        """(k, 3) displacement from the start, m, in N turned about z so that x is the initial heading."""
        c, s = np.cos(self.heading[0]), np.sin(self.heading[0])
        d = self.states[:, P : P + 3] - self.states[0, P : P + 3]
        return np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]], axis=1)

    @property
    def u(self) -> FloatArray:
        """(k) surge, m/s."""
        surge: FloatArray = self.states[:, NU]
        return surge

    @property
    def speed(self) -> FloatArray:
        """(k) speed of the origin, m/s."""
        speed: FloatArray = np.linalg.norm(self.states[:, NU : NU + 3], axis=1)
        return speed

    @property
    def down(self) -> FloatArray:
        """(k) rate of change of the depth, m/s."""
        w, x, y, z = self._q
        zx, zy, zz = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        u, v, w_B = self.states[:, NU : NU + 3].T
        rate: FloatArray = zx * u + zy * v + zz * w_B
        return rate

    @property
    def heading(self) -> FloatArray:
        """(k) heading without jumps, rad."""
        w, x, y, z = self._q
        return np.unwrap(np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)))

    @property
    def pitch(self) -> FloatArray:
        """(k) pitch, rad."""
        w, x, y, z = self._q
        pitch: FloatArray = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
        return pitch

    @property
    def roll(self) -> FloatArray:
        """(k) roll, rad."""
        w, x, y, z = self._q
        roll: FloatArray = np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
        return roll

    @property
    def tilt(self) -> FloatArray:
        """(k) angle between the z axis of B and the vertical, rad; beyond a quarter turn the vehicle lies on its back."""
        _, x, y, _ = self._q
        tilt: FloatArray = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))
        return tilt

    @property
    def _q(self) -> FloatArray:
        """(4, k) unit quaternions."""
        q = self.states[:, Q : Q + 4].T
        quaternions: FloatArray = q / np.linalg.norm(q, axis=0)
        return quaternions

    def since(self, seconds: float) -> Track:
        """Return the part from a time on, with times counted from there."""
        k = int(np.searchsorted(self.t, seconds - 0.5 * DT))
        return Track(self.t[k:] - self.t[k], self.states[k:])

    def until(self, seconds: float) -> Track:
        """Return the part up to a time."""
        k = int(np.searchsorted(self.t, seconds + 0.5 * DT))
        return Track(self.t[:k], self.states[:k])

    @property
    def steady(self) -> Track:
        """The last tenth of the track, over which steady values are averaged."""
        return self.since(0.9 * float(self.t[-1]))


def floats(body: BodyParams) -> bool:
    """Tell whether a vehicle is a surface vessel."""
    return bool(body.shapes) and body.buoyancy >= FLOATING * body.weight


class Waters:
    """Still water in which a vehicle makes its manoeuvres: deep, except for surface vessels.

    Attributes:
        helm: helm of the vehicle.
        floats: whether the vehicle is a surface vessel.
        rest: (13) state in which runs start.
    """

    def __init__(self, helm: Helm) -> None:
        body = helm.body
        self.helm = helm
        self.floats = floats(body)
        self.rest = np.zeros(STATE_SIZE)
        self.rest[Q], self.rest[2] = 1.0, 0.0 if self.floats else DEPTH
        if self.floats:
            (settled,) = self.sail([still], _SETTLING_S)
            self.rest = np.concatenate([settled.states[-1, :NU], np.zeros(6)])

    def sail(
        self, plans: Sequence[Plan], seconds: float, turned: Sequence[tuple[float, float, float]] | None = None
    ) -> list[Track]:
        """Run all plans side by side, and return a track for each.

        Args:
            plans: plans of the runs, which are asked in each tick.
            seconds: duration of the runs.
            turned: for each run roll, pitch and yaw (rad) relative to the state of rest; default: none.

        Raises:
            FloatingPointError: a state diverged.
        """
        hydro = Hydrodynamics([self.helm.body] * len(plans), DT)
        hydro.state[:] = self.rest
        for row, angles in enumerate(turned or ()):
            q = self.rest[Q : Q + 4]
            hydro.state[row, Q : Q + 4] = multiply((q[0], q[1], q[2], q[3]), quat_from_rpy(*angles))
        steps = round(seconds / DT)
        states = np.empty((steps + 1, len(plans), STATE_SIZE))
        told: list[Sticks | None] = [None] * len(plans)
        states[0] = hydro.state
        for k in range(steps):
            for row, plan in enumerate(plans):
                sticks = plan(k * DT, hydro.state[row])
                if sticks != told[row]:
                    self.helm.tell(hydro, row, sticks)
                    told[row] = sticks
            if hydro.advance(k * DT) >= 0:
                raise FloatingPointError(f"diverged after {k * DT:g} s")
            states[k + 1] = hydro.state
        t = np.linspace(0.0, steps * DT, steps + 1)
        return [Track(t, states[:, row]) for row in range(len(plans))]


def hold(sticks: Sticks) -> Plan:
    """Return the plan that holds the sticks."""
    return lambda _t, _state: sticks


still = hold(Sticks())
"""The plan that leaves all sticks at zero."""


def then(first: Sticks, seconds: float, second: Sticks | Plan) -> Plan:
    """Return the plan that holds the first sticks for some seconds, and then the second ones, or follows a plan, whose time begins then."""
    after = second if callable(second) else hold(second)
    return lambda t, state: first if t < seconds - 0.5 * DT else after(t - seconds, state)


# -- figures ----------------------------------------------------------------------------------------------------------------------------

Value = float | None
"""A figure; None if the vehicle did not get that far."""


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
