"""Contacts with a known answer, run through the solver: hits with the whole 6x6 mass, load at rest, and the force that starts a slide."""

from __future__ import annotations

import numpy as np

from uwserver.frames import Quat, Vec3, conjugate, quat_from_rpy, rotate
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams, rigid_body_inertia
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q
from uwserver_bench.proofs.closed_forms import ClosedForm
from uwserver_bench.proofs.colliders import Floor

FEET: tuple[Vec3, ...] = ((0.2, 0.15, 0.1), (0.2, -0.15, 0.1), (-0.2, -0.15, 0.1), (-0.2, 0.15, 0.1))
OFF_DIAGONAL: FloatArray = np.array(
    [
        [6.4, 0.3, -0.8, 0.1, 0.9, 0.0],
        [0.3, 7.1, 0.5, -0.7, 0.0, 0.4],
        [-0.8, 0.5, 18.7, 0.2, -0.3, 0.0],
        [0.1, -0.7, 0.2, 0.19, 0.01, 0.0],
        [0.9, 0.0, -0.3, 0.01, 0.24, 0.02],
        [0.0, 0.4, 0.0, 0.0, 0.02, 0.22],
    ]
)
DIAGONAL: FloatArray = np.diag(np.diag(OFF_DIAGONAL))
HITS: dict[str, tuple[Vec3, Vec3, FloatArray]] = {
    "head-on": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.2), DIAGONAL),
    "oblique": ((0.4, 0.6, 0.3), (0.0, 0.0, 0.2), DIAGONAL),
    "off-centre": ((0.0, 0.0, 0.0), (0.25, 0.1, 0.2), DIAGONAL),
    "oblique and off-centre": ((0.4, 0.6, 0.3), (0.25, 0.1, 0.2), DIAGONAL),
    "the same, off-diagonal M_A": ((0.4, 0.6, 0.3), (0.25, 0.1, 0.2), OFF_DIAGONAL),
}
"""For each hit the attitude (roll, pitch, yaw), the point of the body that hits (B, m), and M_A."""


def vehicle(M_A: FloatArray, heavy: float = 0.0, damping: float = 0.0, mass: float = 13.5) -> BodyParams:
    """Return a small ROV of `mass` kg that weighs `heavy` newtons in water, by default without damping."""
    M_RB = rigid_body_inertia(mass, np.diag([0.26, 0.23, 0.37]) * mass / 13.5, (0.0, 0.0, 0.0))
    D = damping * np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
    zero, origin = np.zeros((6, 6)), (0.0, 0.0, 0.0)
    return BodyParams(M_RB, M_A, D, zero, zero, 100.0 + heavy, 100.0, origin, origin)


def jacobian(q: Quat, arm: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the Jacobian (6) of a direction in N at a point whose arm is given in N, without code of the solver."""
    to_body = np.array([rotate(q, tuple(e)) for e in np.eye(3)])  # rows are the columns of R_NB: R^T
    return np.concatenate([to_body @ direction, np.cross(to_body @ arm, to_body @ direction)])


def hit(name: str, e: float) -> tuple[FloatArray, FloatArray, float, float]:
    """Run one of `HITS` on a floor without friction. Returns the velocity after it (6), its closed form, the impulse (N s), and its closed form."""
    rpy, arm_B, M_A = HITS[name]
    body, q = vehicle(M_A), quat_from_rpy(*rpy)
    arm = np.array(rotate(q, arm_B))
    nu = np.concatenate([np.array(rotate(conjugate(q), (0.3, -0.1, 1.0))), np.zeros(3)])
    hydro = Hydrodynamics([body], 1e-9)  # so short that only the hit happens in the step
    hydro.state[0, :3], hydro.state[0, Q : Q + 4], hydro.state[0, NU:] = -arm, q, nu
    hydro.collider = Floor({0: (arm_B,)}, restitution=e)
    hydro.advance(0.0)
    J = jacobian(q, arm, np.array([0.0, 0.0, -1.0]))
    response = np.linalg.solve(body.M_RB + body.M_A, J)
    impulse = float(-(1.0 + e) * (J @ nu) / (J @ response))
    return hydro.state[0, NU:].copy(), nu + response * impulse, -float(hydro.touched.impulse[0, 2]), impulse


def contact_forms() -> list[ClosedForm]:
    """Return the impulses of all hits, the load of a vehicle at rest, and the force that makes it slide, with their closed forms."""
    forms = []
    for name in HITS:
        for e in (0.0, 0.5):
            _, _, measured, expected = hit(name, e)
            forms.append(ClosedForm(f"hit on the world, {name}, e = {e:g}", "N s", expected, measured))
    for name, M_A in (("diagonal", DIAGONAL), ("off-diagonal", OFF_DIAGONAL)):
        forms.append(ClosedForm(f"load of a vehicle at rest, {name} M_A", "N", 20.0, _load(M_A)))
        forms.append(ClosedForm(f"break-away force, mu = 0.5, {name} M_A", "N", 10.0, break_away(M_A, 0.7)))
    return forms


def _load(M_A: FloatArray) -> float:
    hydro = standing(M_A, 1.0 / 240.0)
    for k in range(480):
        hydro.advance(k * hydro.dt)
    return float(-hydro.touched.impulse[:, 2].sum() / hydro.dt)


def standing(M_A: FloatArray, dt: float, damping: float = 0.0) -> Hydrodynamics:
    """Return a vehicle that weighs 20 N in water, on four feet on a floor with mu = 0.5."""
    hydro = Hydrodynamics([vehicle(M_A, 20.0, damping)], dt)
    hydro.state[0, 2] = -0.1
    hydro.collider = Floor({0: FEET}, friction=0.5)
    return hydro


def break_away(M_A: FloatArray, heading: float) -> float:
    """Return the force (N) along a heading (rad), at the height of the floor, at which a standing vehicle moves at 1 mm/s; it rises by 0.1 N/s."""
    hydro = standing(M_A, 0.01, damping=1.0)
    direction = np.array([np.cos(heading), np.sin(heading), 0.0])
    force = 0.0
    for k in range(12_000):
        force = 9.0 + 0.1 * k * hydro.dt
        hydro.wrenches["bias"][0] = np.concatenate([force * direction, np.cross((0.0, 0.0, 0.1), force * direction)])
        hydro.advance(k * hydro.dt)
        if np.linalg.norm(hydro.state[0, NU : NU + 2]) > 1e-3:
            break
    return force
