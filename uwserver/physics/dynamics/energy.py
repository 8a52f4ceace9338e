"""Kinetic energy of bodies and of the water that moves with them, from the kernel's arrays; plain numpy, for tests and reports."""

from __future__ import annotations

import numpy as np

from uwserver.frames import matrix
from uwserver.physics.kernel.arrays import FloatArray, Records
from uwserver.physics.kernel.layout import NU, Q


def rotations(state: FloatArray) -> FloatArray:
    """Return R_NB (n, 3, 3) of the quaternions of state rows (n, 13), which may have any norm."""
    q = state[:, Q : Q + 4] / np.linalg.norm(state[:, Q : Q + 4], axis=1, keepdims=True)
    return np.array([matrix(row) for row in q.tolist()]).reshape(-1, 3, 3)


def relative_velocities(state: FloatArray, currents: FloatArray) -> FloatArray:
    """Return nu_r (n, 6) in B of state rows (n, 13) in currents (n, 3) of N."""
    nu_r = state[:, NU : NU + 6].copy()
    nu_r[:, :3] -= np.einsum("nij,ni->nj", rotations(state), currents)
    return nu_r


def kinetic_energy(bodies: Records, state: FloatArray, currents: FloatArray) -> FloatArray:
    """Return the energy (n), J: (nu^T M_RB nu + nu_r^T M_A nu_r) / 2, fully submerged.

    Args:
        bodies: (n) BODY records.
        state: (n, 13) p_NB, q_NB, nu.
        currents: (n, 3) water velocity in N, m/s.
    """
    nu, nu_r = state[:, NU : NU + 6], relative_velocities(state, currents)
    body = np.einsum("ni,nij,nj->n", nu, bodies["M_RB"], nu)
    water = np.einsum("ni,nij,nj->n", nu_r, bodies["M_A"], nu_r)
    energy: FloatArray = 0.5 * (body + water)
    return energy
