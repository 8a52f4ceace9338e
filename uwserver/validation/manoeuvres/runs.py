"""Runs of one vehicle side by side. Each run is a row of one world, with a plan of its own that moves the sticks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uwserver.frames import multiply, quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, STATE_SIZE, P, Q
from uwserver.validation.manoeuvres.bollard import DEPTH
from uwserver.validation.manoeuvres.helm import Helm, Sticks

DT = 0.02
"""Length of a tick, s."""
FLOATING = 1.2
"""Ratio of buoyancy to weight from which a vehicle is a surface vessel; ROVs and AUVs are neutral within a few percent."""
_SETTLING_S = 120.0

Plan = Callable[[float, FloatArray], Sticks]
"""Returns the sticks at a time (s) and a state (13)."""


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
