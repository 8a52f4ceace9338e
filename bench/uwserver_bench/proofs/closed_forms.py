"""Motions with a known answer, run through the kernel: terminal velocities, natural frequencies, floating equilibria, added mass."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.frames import quat_from_rpy, rpy_from_quat
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, SHAPE_BOX, SHAPE_SPHERE, Q
from uwserver_bench.proofs.motion import DEEP, angular_frequency, record

DENSITY, GRAVITY = 1025.0, 9.81
ZERO6 = np.zeros((6, 6))


class ClosedForm(NamedTuple):
    """A quantity, its closed form, and the result of the kernel; SI."""

    name: str
    unit: str
    expected: float
    measured: float

    @property
    def error(self) -> float:
        """The relative error of the kernel."""
        return abs(self.measured / self.expected - 1.0)


def table_a1(damped: bool = True, weight: float = 131.588) -> BodyParams:
    """Return the BlueROV2 Heavy of von Benzon et al. (2022), Table A1, in fresh water. It is neutral unless a weight (N) is given."""
    return BodyParams(
        M_RB=np.diag([13.5, 13.5, 13.5, 0.26, 0.23, 0.37]),
        M_A=np.diag([6.36, 7.12, 18.68, 0.189, 0.135, 0.222]),
        D_L=np.diag([13.7, 0.0, 33.0, 0.0, 0.8, 0.0]) * damped,
        D_Q=np.diag([141.0, 217.0, 190.0, 1.19, 0.47, 1.5]) * damped,
        D_S=ZERO6,
        weight=weight,
        buoyancy=131.588,
        r_g=(0.0, 0.0, 0.0),
        r_b=(0.0, 0.0, -0.01),
    )


def floating(kind: int, half: tuple[float, float, float], mass: float, volume: float, low: float) -> BodyParams:
    """Return a damped body that floats; its centre of gravity is `low` metres below the centre of its shape."""
    D = np.diag([3.0 * mass] * 3 + [0.8 * mass] * 3)
    return BodyParams(
        M_RB=np.diag([mass] * 3 + [0.2 * mass] * 3),
        M_A=np.diag([0.5 * mass] * 3 + [0.05 * mass] * 3),
        D_L=D,
        D_Q=ZERO6,
        D_S=ZERO6,
        weight=mass * GRAVITY,
        buoyancy=DENSITY * GRAVITY * volume,
        r_g=(0.0, 0.0, low),
        r_b=(0.0, 0.0, 0.0),
        shapes=(BuoyancyShape(kind, (0.0, 0.0, 0.0), half, volume),),
    )


def terminal_velocities() -> list[ClosedForm]:
    """Return steady velocities of Table A1 under a constant force or moment along one axis, and of its sinking."""
    cases = [
        ("surge", 0, 10.0),
        ("surge", 0, 40.0),
        ("sway", 1, 10.0),
        ("sway", 1, 40.0),
        ("heave", 2, 10.0),
        ("heave", 2, 40.0),
    ]
    cases.append(("yaw", 5, 10.0))
    hydro = Hydrodynamics([table_a1()] * len(cases) + [table_a1(weight=132.57)], 0.02)
    hydro.state[:, 2] = DEEP
    for row, (_, axis, force) in enumerate(cases):
        hydro.wrenches["bias"][row, axis] = force
    _, states = record(hydro, 60.0)
    results = []
    for row, (name, axis, force) in enumerate(cases):
        unit = ("N", "m/s") if axis < 3 else ("N m", "rad/s")
        results.append(
            ClosedForm(
                f"{name} at {force:g} {unit[0]}", unit[1], _steady(axis, force), float(states[-1, row, NU + axis])
            )
        )
    results.append(ClosedForm("free sinking", "m/s", _steady(2, 132.57 - 131.588), float(states[-1, -1, NU + 2])))
    return results


def _steady(axis: int, force: float) -> float:
    """Return v of linear v + quadratic v^2 = force."""
    body = table_a1()
    a, b = body.D_Q[axis, axis], body.D_L[axis, axis]
    return float((-b + math.sqrt(b * b + 4.0 * a * force)) / (2.0 * a))


def natural_frequencies() -> list[ClosedForm]:
    """Return the frequencies of small undamped roll and pitch of Table A1: omega^2 = B 0.01 m / (I + added inertia)."""
    hydro = Hydrodynamics([table_a1(damped=False)] * 2, 1.0 / 240.0)
    hydro.state[:, 2] = DEEP
    hydro.state[0, Q : Q + 4] = quat_from_rpy(0.005, 0.0, 0.0)
    hydro.state[1, Q : Q + 4] = quat_from_rpy(0.0, 0.005, 0.0)
    times, states = record(hydro, 40.0)
    results = []
    for row, name in enumerate(("roll", "pitch")):
        body = table_a1()
        inertia = body.M_RB[3 + row, 3 + row] + body.M_A[3 + row, 3 + row]
        angle = np.array([rpy_from_quat(q)[row] for q in states[:, row, Q : Q + 4]])
        results.append(
            ClosedForm(
                f"{name}, undamped", "rad/s", math.sqrt(body.buoyancy * 0.01 / inertia), angular_frequency(times, angle)
            )
        )
    return results


def floating_equilibria() -> list[ClosedForm]:
    """Return the draft of a box and of a sphere that move until they rest, and the tilt of the box, which returns to level."""
    half, radius = (0.5, 0.4, 0.15), 0.3
    box_mass, sphere_mass = 150.0, 40.0
    box = floating(SHAPE_BOX, half, box_mass, 8.0 * math.prod(half), 0.02)
    sphere = floating(SHAPE_SPHERE, (radius, 0.0, 0.0), sphere_mass, 4.0 / 3.0 * math.pi * radius**3, 0.05)
    hydro = Hydrodynamics([box, sphere], 0.01)
    hydro.state[:, 2] = -0.1, 0.2
    hydro.state[:, Q : Q + 4] = quat_from_rpy(0.2, 0.1, 0.3)
    _, states = record(hydro, 60.0)
    return [
        ClosedForm(
            "box, draft", "m", box_mass / (DENSITY * 4.0 * half[0] * half[1]), float(states[-1, 0, 2]) + half[2]
        ),
        ClosedForm("sphere, draft", "m", _cap_height(sphere_mass / DENSITY, radius), float(states[-1, 1, 2]) + radius),
    ]


def _cap_height(volume: float, radius: float) -> float:
    """Return h of pi h^2 (3 r - h) / 3 = volume, by bisection."""
    low, high = 0.0, 2.0 * radius
    for _ in range(80):
        mid = 0.5 * (low + high)
        low, high = (mid, high) if math.pi * mid * mid * (3.0 * radius - mid) / 3.0 < volume else (low, mid)
    return low


def sphere_added_mass() -> list[ClosedForm]:
    """Return the acceleration of a heavy sphere that sinks without damping, a = (W - B) / (m + 2/3 pi rho r^3), and its path in one second."""
    radius, mass = 0.25, 120.0
    added = 2.0 / 3.0 * math.pi * DENSITY * radius**3
    volume = 4.0 / 3.0 * math.pi * radius**3
    inertia = 0.4 * mass * radius**2
    sphere = BodyParams(
        M_RB=np.diag([mass] * 3 + [inertia] * 3),
        M_A=np.diag([added] * 3 + [0.0] * 3),
        D_L=ZERO6,
        D_Q=ZERO6,
        D_S=ZERO6,
        weight=mass * GRAVITY,
        buoyancy=DENSITY * GRAVITY * volume,
        r_g=(0.0, 0.0, 0.0),
        r_b=(0.0, 0.0, 0.0),
        shapes=(BuoyancyShape(SHAPE_SPHERE, (0.0, 0.0, 0.0), (radius, 0.0, 0.0), volume),),
    )
    hydro = Hydrodynamics([sphere], 0.01)
    hydro.state[0, 2] = DEEP
    a = GRAVITY * (mass - DENSITY * volume) / (mass + added)
    rates, _ = hydro.rates_of_change(0.0)
    _, states = record(hydro, 1.0)
    return [
        ClosedForm("sphere let go, acceleration", "m/s2", a, float(rates[0, 2])),
        ClosedForm("sphere let go, way in 1 s", "m", 0.5 * a, float(states[-1, 0, 2]) - DEEP),
    ]


def closed_forms() -> list[ClosedForm]:
    """Return all quantities with closed forms."""
    return [*terminal_velocities(), *natural_frequencies(), *floating_equilibria(), *sphere_added_mass()]


def tilt(state: FloatArray) -> float:
    """Return the angle (rad) between the z axis of a body and the vertical, from its state row."""
    x, y = state[Q + 1], state[Q + 2]
    return math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * float(x * x + y * y))))
