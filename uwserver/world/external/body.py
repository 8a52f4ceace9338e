"""A body that follows poses: where it is comes from outside, and nothing here moves it."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.ports import NOWHERE_M, Sample
from uwserver.world.external.motion import Bytes, Moving
from uwserver.world.external.source import Source
from uwserver.world.part import Part, Stage, State

NOTHING_MOVES: Bytes = np.zeros(0, np.int8)
UNYIELDING_KG = 1e9
"""Mass, and moments of inertia in kg m2, of a body that others cannot push: a hit of a ton at 10 m/s changes it by 10 um/s until the end of
the tick, when its source is asked again."""
_APART_M = 1e3
"""Bodies that are nowhere are so far from each other."""


class External(Part):
    """Puts a body where its source says, after each step of the kernel.

    What is not known is nowhere: high above the water, where no ray and no contact finds it (`NOWHERE_M`). What it remembers are the arrays
    of the bodies, and a live source the pose that came last (`source.Heard`); so it has nothing of its own to save.
    """

    state_type = State
    stage: ClassVar[Stage] = Stage.FORCES

    def __init__(
        self, name: str, hydro: Hydrodynamics, row: int, source: Source, ghost: bool, moving: Moving | None = None
    ) -> None:
        """Of a body that was added with `led_params`.

        Args:
            name: of the vehicle.
            hydro, row: its arrays.
            source: of its poses, in simulation time.
            moving: what its actuators give, for who looks; None where it has none.
            ghost: nothing touches it, so that the kernel need not move it within a tick either.
        """
        self._path, self._hydro, self._row = f"{name}/external", hydro, row
        self.source, self._ghost, self._moving = source, ghost, moving

    @property
    def path(self) -> str:
        """See `Part`."""
        return self._path

    def achieved(self, t_ns: int) -> Bytes:
        """What its actuators give, each of -127..127, as in `SceneState.achieved`."""
        return NOTHING_MOVES if self._moving is None else self._moving.achieved(t_ns)

    def settle(self, t_ns: int) -> None:
        """Stand where the source says at this time. The velocity is that at which it strikes others in the coming tick."""
        pose, hydro, row = self.source.at(t_ns), self._hydro, self._row
        state = hydro.state[row]
        if pose is None:
            state[:] = 0.0
            state[P + 2] = -(NOWHERE_M + _APART_M * (row + 1))
            state[Q] = 1.0
            hydro.bodies["retired"][row] = 1
            return
        state[P : P + 3], state[Q : Q + 4], state[NU : NU + 6] = pose.p_NB, pose.q_NB, pose.nu
        hydro.bodies["retired"][row] = 1 if self._ghost else 0

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """The kernel has moved it: it is put where it belongs, before any sensor looks."""
        self.settle(t_ns)

    def save(self) -> State:
        """Nothing."""
        return State()

    def load(self, state: Any) -> None:
        """The arrays of the bodies have been put back already."""


@cache
def led_params() -> BodyParams:
    """A body without water, weight or damping, that yields to nothing."""
    nothing = np.zeros((6, 6))
    none = (0.0, 0.0, 0.0)
    return BodyParams(UNYIELDING_KG * np.eye(6), nothing, nothing, nothing, nothing, 0.0, 0.0, none, none, length=0.0)


def is_nowhere(p_NB: tuple[float, ...]) -> bool:
    """Whether a position (m, N) is that of a body of which nobody knows where it is."""
    return p_NB[2] <= -NOWHERE_M
