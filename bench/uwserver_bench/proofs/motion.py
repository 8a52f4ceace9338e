"""Checks of motions for tests and reports: conservation of momentum and energy, stability by energy, and time series."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.energy import kinetic_energy, rotations
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, STATE_SIZE, P, Q

DEEP = 500.0
"""Start depth (m) from which no run here reaches the surface."""
FASTEST = 3.0
"""Largest surge of `decay_rise`, m/s: no shipped vehicle is made for more."""


def momentum(hydro: Hydrodynamics) -> FloatArray:
    """Return (n, 6): momentum of bodies and water in still water, and angular momentum about the origin of N, both in N."""
    M = hydro.bodies["M_RB"] + hydro.bodies["M_A"]
    p = np.einsum("nij,nj->ni", M, hydro.state[:, NU : NU + 6])
    R = rotations(hydro.state)
    linear = np.einsum("nij,nj->ni", R, p[:, :3])
    angular = np.einsum("nij,nj->ni", R, p[:, 3:]) + np.cross(hydro.state[:, P : P + 3], linear)
    return np.concatenate([linear, angular], axis=1)


def potential_energy(hydro: Hydrodynamics, states: FloatArray) -> FloatArray:
    """Return (steps, n): potential energy of weight and buoyancy, J, of states (steps, n, 13) of fully submerged bodies."""
    q = states[:, :, Q : Q + 4]
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=2, keepdims=True), 2, 0)
    # The third row of R_NB is z_N in B.
    down = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=2)
    W, B = hydro.bodies["weight"], hydro.bodies["buoyancy"]
    lever = W[:, None] * hydro.bodies["r_g"] - B[:, None] * hydro.bodies["r_b"]
    energy: FloatArray = -(W - B) * states[:, :, 2] - np.einsum("tni,ni->tn", down, lever)
    return energy


def random_wrenches(
    bodies: list[BodyParams], steps: int, dt: float, seed: int = 1
) -> Callable[[int], FloatArray | None]:
    """Return a function of the number of a step. It returns a new random wrench (n, 6) every half second, otherwise None: up to half the weight, and
    up to the moment that accelerates the body by 1 rad/s2."""
    rng = np.random.default_rng(seed)
    limits = np.array(
        [[0.5 * body.weight] * 3 + [body.M_RB[i, i] + body.M_A[i, i] for i in (3, 4, 5)] for body in bodies]
    )
    hold = max(1, round(0.5 / dt))
    draws = rng.uniform(-1.0, 1.0, (steps // hold + 1, len(bodies), 6)) * limits
    return lambda k: draws[k // hold] if k % hold == 0 else None


def energy_excess(bodies: list[BodyParams], dt: float, seconds: float, seed: int = 1) -> FloatArray:
    """Return (n): the largest rise of kinetic energy in one step beyond the work of the step, over the kinetic energy of the step.

    The bodies are deep in still water and begin at rest, under `random_wrenches` and random commands to all fins, propellers, ballasts and moving
    masses, each held for half a second. A stable integrator stays below 1e-6. The work of the wrench and of the parts that servos move is integrated
    by Simpson's rule, with the middle of the step from a second world with half the step. The work of weight and buoyancy is the difference of the
    potential energy. Damping, hull derivatives, and the drag of foils and strips can only dissipate energy, so they are left out.

    Raises:
        FloatingPointError: a state diverged.
    """
    steps = round(seconds / dt)
    hydro, middle = Hydrodynamics(bodies, dt), Hydrodynamics(bodies, 0.5 * dt)
    hydro.state[:, 2] = DEEP
    wrench, rng = random_wrenches(bodies, steps, dt, seed), np.random.default_rng(seed)
    states = np.empty((steps + 1, len(bodies), STATE_SIZE))
    work = np.empty((steps, len(bodies)))
    states[0], start = hydro.state, _power(hydro, 0.0)
    for k in range(steps):
        drawn = wrench(k)
        if drawn is not None:
            hydro.wrenches["bias"] = drawn
            hydro.servos["command"] = rng.uniform(hydro.servos["low"], hydro.servos["high"])
            start = _power(hydro, k * dt)
        for name in ("state", "servos", "wrenches"):
            getattr(middle, name)[...] = getattr(hydro, name)
        if hydro.advance(k * dt) >= 0 or middle.advance(k * dt) >= 0:
            raise FloatingPointError(f"diverged in step {k} of {dt} s")
        end = _power(hydro, (k + 1) * dt)
        work[k] = dt / 6.0 * (start + 4.0 * _power(middle, (k + 0.5) * dt) + end)
        states[k + 1], start = hydro.state, end
    work -= np.diff(potential_energy(hydro, states), axis=0)
    kinetic = np.array([kinetic_energy(hydro.bodies, row, hydro.currents) for row in states])
    excess = np.diff(kinetic, axis=0) - work
    largest: FloatArray = np.max(excess / np.maximum(kinetic[:-1], kinetic[1:]), axis=0)
    return largest


def _power(hydro: Hydrodynamics, t: float) -> FloatArray:
    """Return (n): power of all that may add energy, W: the applied wrench, and the parts that servos move."""
    power: FloatArray = np.einsum("ni,ni->n", hydro.state[:, NU : NU + 6], hydro.rates_of_change(t)[1])
    return power


def decay_rise(body: BodyParams, dt: float, seconds: float, count: int = 100, seed: int = 1) -> FloatArray:
    """Return (count): the largest rise of the energy of a body in one step, over this energy, while it comes to rest from random states.

    It is in deep, still water, without thrust, with its servos at neutral, so that nothing can add energy. The energy is the kinetic energy of body
    and water, and the potential energy of weight and buoyancy. In the denominator the potential energy is zero when the body hangs upright, at any
    depth. Each axis gets up to the velocity that has the same energy as a surge of `FASTEST`.

    Raises:
        FloatingPointError: a state diverged.
    """
    rng, hydro = np.random.default_rng(seed), Hydrodynamics([body] * count, dt)
    M = np.diag(body.M_RB + body.M_A)
    hydro.state[:, 2] = DEEP
    hydro.state[:, NU : NU + 6] = rng.uniform(-1.0, 1.0, (count, 6)) * FASTEST * np.sqrt(M[0] / M)
    q = rng.normal(size=(count, 4))
    hydro.state[:, Q : Q + 4] = q / np.linalg.norm(q, axis=1, keepdims=True)
    _, states = record(hydro, seconds)
    nu = states[:, :, NU : NU + 6]
    kinetic = 0.5 * np.einsum("tni,ij,tnj->tn", nu, body.M_RB + body.M_A, nu, optimize=True)
    potential = potential_energy(hydro, states)
    lever = np.linalg.norm(body.weight * np.array(body.r_g) - body.buoyancy * np.array(body.r_b))
    size = kinetic + potential + (body.weight - body.buoyancy) * states[:, :, 2] + lever
    rise: FloatArray = np.max(np.diff(kinetic + potential, axis=0) / np.maximum(size[:-1], size[1:]), axis=0)
    return rise


def record(hydro: Hydrodynamics, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Run from the present state, and return times (steps + 1) and states (steps + 1, n, 13).

    Raises:
        FloatingPointError: a state diverged.
    """
    steps = round(seconds / hydro.dt)
    states = np.empty((steps + 1, len(hydro), STATE_SIZE))
    states[0] = hydro.state
    for k in range(steps):
        if hydro.advance(k * hydro.dt) >= 0:
            raise FloatingPointError(f"diverged in step {k} of {hydro.dt} s")
        states[k + 1] = hydro.state
    return np.linspace(0.0, steps * hydro.dt, steps + 1), states


def angular_frequency(times: FloatArray, signal: FloatArray) -> float:
    """Return the angular frequency of an oscillation about zero, rad/s, from the mean time between its upward crossings."""
    k = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    if len(k) < 2:
        raise ValueError("two upward crossings of zero are needed")
    crossings = times[k] - signal[k] * (times[k + 1] - times[k]) / (signal[k + 1] - signal[k])
    return float(2.0 * np.pi * (len(k) - 1) / (crossings[-1] - crossings[0]))
