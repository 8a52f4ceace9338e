"""Linear lag of an actuator as a third-order state-space form with exact transitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import LAG_LEVELS


@dataclass(frozen=True)
class Lag:
    """Transfer function (b2 s2 + b1 s + b0) / (s3 + a2 s2 + a1 s + a0), or a first-order or no lag.

    Attributes:
        numerator: (b0, b1, b2).
        denominator: (a0, a1, a2) of the monic cubic; () for no lag; (1/tau,) for a first-order lag of time constant tau (s).
    """

    numerator: tuple[float, ...] = ()
    denominator: tuple[float, ...] = ()

    @classmethod
    def first_order(cls, tau: float) -> Lag:
        """1 / (tau s + 1); tau in s."""
        return cls((), (1.0 / tau,)) if tau > 0.0 else cls()

    def transition(self, dt: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Exact transition over half a sub-step, for each number of sub-steps 2**level of a tick of dt seconds.

        Returns:
            F (levels, 3, 3), G (levels, 3), C (3), D: x+ = F x + G u, y = C x + D u.
        """
        A, B, C, D = self._controllable_form()
        F, G = np.zeros((LAG_LEVELS, 3, 3)), np.zeros((LAG_LEVELS, 3))
        for level in range(LAG_LEVELS):
            h = 0.5 * dt / 2**level
            block = np.zeros((4, 4))
            block[:3, :3], block[:3, 3] = A * h, B * h
            exponential = expm(block)
            F[level], G[level] = exponential[:3, :3], exponential[:3, 3]
        return F, G, C, D

    def _controllable_form(self) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        A, B, C = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
        if not self.denominator:
            return A, B, C, 1.0
        if len(self.denominator) == 1:
            (rate,) = self.denominator
            A[0, 0], B[0], C[0] = -rate, rate, 1.0
            return A, B, C, 0.0
        a0, a1, a2 = self.denominator
        b0, b1, b2 = self.numerator
        # States scaled by a0 so that x[0] is the output of an all-pole lag: comparable magnitudes, an accurate exponential.
        A[0, 1] = A[1, 2] = 1.0
        A[2] = -a0, -a1, -a2
        B[2] = a0
        C[:] = b0 / a0, b1 / a0, b2 / a0
        return A, B, C, 0.0


def expm(M: FloatArray) -> FloatArray:
    """Matrix exponential by scaling, a Taylor series of degree 18 and squaring; for the small, load-time matrices of this module.

    (scipy has one, but importing scipy would cost a third of the start-up budget.)
    """
    squarings = max(0, int(np.ceil(np.log2(max(1e-300, float(np.linalg.norm(M, 1)))))) + 1)
    scaled = M / 2.0**squarings
    result, term = np.eye(len(M)), np.eye(len(M))
    for k in range(1, 19):
        term = term @ scaled / k
        result = result + term
    for _ in range(squarings):
        result = result @ result
    return result
