"""The REMUS 100 of the Python Vehicle Simulator (Fossen): its equations, written independently of the kernel, and its step inputs.

The equations are Fossen's with the terms of the simulator: hull as a wing of low aspect ratio, cross-flow drag in sway and yaw, fins whose force is
at a right angle to the hull, linear K_T and K_Q over the whole range of speed, C_A without the terms of the Munk moments. They use Euler angles; the
kernel uses quaternions.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.body import body_params
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Environment
from uwserver_bench.proofs.motion import DEEP, record

RHO, G, LENGTH, DIAMETER = 1026.0, 9.81, 1.6, 0.19
OVERRIDE: dict[str, object] = {
    "buoyancy": {"volume_m3": 31.02938498 / RHO},
    "foils": {"hull": {"inflow": "speed", "stall_deg": 178.0}},
    "propellers": {"main": {"inflow": "speed", "position_frd_m": [0.0, 0.0, 0.0]}},
}
"""Changes that make remus100_pvs exactly the model of the simulator: neutral in its water, propeller and hull with its inflow, no stall."""


FIVE = 0.0872664625997165
"""Five degrees, rad."""
STEPS: list[tuple[float, float, tuple[float, float, float]]] = [
    (0.0, 25.0, (FIVE, -FIVE, 1525.0)),
    (25.0, 50.0, (FIVE, -FIVE, 1525.0)),
    (50.0, 100.0, (FIVE, 0.0, 1525.0)),
]
"""The step inputs of the simulator: from, to, (rudder, stern planes, rpm). Rudder and planes 5 degrees, planes back to zero at 50 s."""

SIMULATED = {
    0.0025: (3.7267858898, -9.1193892217, -39.5438085497),
    0.00125: (3.7227548176, -9.1193845789, -39.5423081701),
}
"""For each Euler step (s) the place (m) at 100 s in the simulator itself (commit c717e07, no current)."""


def remus_track(rate_hz: float, override: dict[str, object] | None = None) -> list[FloatArray]:
    """Return the states (13) of remus100_pvs in the kernel at the ends of STEPS. `override` replaces OVERRIDE."""
    changes = OVERRIDE if override is None else override
    entry = VehicleEntry(model="remus100_pvs", position_ned_m=(0.0, 0.0, DEEP), override=changes)
    environment = Environment(density_kgpm3=RHO)
    resolved = load(Scenario(schema=1, environment=environment, vehicles={"auv": entry}), adapters={}).vehicles["auv"]
    hydro = Hydrodynamics([body_params(resolved.vehicle, resolved.devices, environment)], 1.0 / rate_hz)
    hydro.state[0, 2] = DEEP
    ends = []
    for start, end, (rudder, planes, rpm) in STEPS:
        hydro.servos["command"] = rudder, planes, rpm / 60.0 * 2.0 * math.pi  # in the order of the vehicle file
        record(hydro, end - start)
        ends.append(hydro.state[0] - np.array([0.0, 0.0, DEEP, *[0.0] * 10]))
    return ends


class Remus:
    """The model of the simulator. With `munk` it has the complete C_A."""

    def __init__(self, munk: bool = False) -> None:
        a, b = LENGTH / 2.0, DIAMETER / 2.0
        m = 4.0 / 3.0 * math.pi * RHO * a * b * b
        e = math.sqrt(1.0 - (b / a) ** 2)
        logarithm = math.log((1.0 + e) / (1.0 - e))
        alpha = 2.0 * (1.0 - e * e) / e**3 * (0.5 * logarithm - e)
        beta = 1.0 / e**2 - (1.0 - e * e) / (2.0 * e**3) * logarithm
        k_rotation = e**4 * (beta - alpha) / ((2.0 - e * e) * (2.0 * e * e - (2.0 - e * e) * (beta - alpha)))
        roll, pitch = 0.4 * m * b * b, 0.2 * m * (a * a + b * b)
        self.weight, self.z_g = m * G, 0.02
        H = np.eye(6)
        H[:3, 3:] = self._cross(np.array([0.0, 0.0, self.z_g])).T
        self.M_RB = H.T @ np.diag([m, m, m, roll, pitch, pitch]) @ H
        k1, k2 = alpha / (2.0 - alpha), beta / (2.0 - beta)
        self.M_A = np.diag([m * k1, m * k2, m * k2, 0.3 * roll, k_rotation * pitch, k_rotation * pitch])
        self.M = self.M_RB + self.M_A
        self.munk = munk
        metacentric = self.weight * self.z_g
        self.D = np.array(
            [
                self.M[0, 0] / 20.0,
                self.M[1, 1] / 20.0,
                self.M[2, 2] / 20.0,
                0.6 * math.sqrt(metacentric * self.M[3, 3]),
                1.6 * math.sqrt(metacentric * self.M[4, 4]),
                self.M[5, 5],
            ]
        )
        self.area = 0.7 * LENGTH * DIAMETER
        self.drag = 0.42 * math.pi * b * b / self.area
        self.ratio = DIAMETER**2 / self.area

    @staticmethod
    def _cross(a: FloatArray) -> FloatArray:
        return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])

    def _coriolis(self, M: FloatArray, nu: FloatArray) -> FloatArray:
        p = M @ nu
        C = np.zeros((6, 6))
        C[:3, 3:] = C[3:, :3] = -self._cross(p[:3])
        C[3:, 3:] = -self._cross(p[3:])
        return C

    def nu_dot(self, eta: FloatArray, nu: FloatArray, rudder: float, planes: float, rpm: float) -> FloatArray:
        """Return the acceleration (6) in B for the actual angles (rad) and shaft speed (rpm)."""
        u, v, w, _, _, r = nu
        speed = math.sqrt(u * u + v * v + w * w)
        C_A = self._coriolis(self.M_A, nu)
        if not self.munk:
            for i, j in ((0, 4), (2, 4), (0, 5), (1, 5)):
                C_A[i, j] = C_A[j, i] = 0.0
        D = self.D.copy()
        D[:2] *= math.exp(-3.0 * speed)
        tau: FloatArray = -(self._coriolis(self.M_RB, nu) + C_A) @ nu - D * nu
        angle = math.atan2(w, u)
        lift = math.pi * self.ratio / (1.0 + math.sqrt(1.0 + (0.5 * self.ratio) ** 2)) * angle
        drag = self.drag + lift**2 / (math.pi * 0.7 * self.ratio)
        pressure = 0.5 * RHO * speed**2 * self.area
        tau[0] += pressure * (lift * math.sin(angle) - drag * math.cos(angle))
        tau[2] += pressure * (-lift * math.cos(angle) - drag * math.sin(angle))
        hoerner = 1.2108 + (0.5 - 0.4933) / (0.5585 - 0.4933) * (1.0836 - 1.2108)
        x = np.linspace(-LENGTH / 2.0, LENGTH / 2.0, 21)
        strips = 0.5 * RHO * DIAMETER * hoerner * np.abs(v + x * r) * (v + x * r) * LENGTH / 20.0
        tau[1] -= strips.sum()
        tau[5] -= x @ strips
        _, theta, phi = eta[5], eta[4], eta[3]
        tau[3] -= self.z_g * self.weight * math.cos(theta) * math.sin(phi)
        tau[4] -= self.z_g * self.weight * math.sin(theta)
        n, Va = rpm / 60.0, 0.944 * speed
        D_p, slope_T, slope_Q = 0.14, (0.1798 - 0.4566) / 0.6632, (0.0312 - 0.07) / 0.6632
        tau[0] += 0.9 * RHO * D_p**4 * (0.4566 * n * n + slope_T * Va / D_p * n)
        tau[3] += 0.1 * RHO * D_p**5 * (0.07 * n * n + slope_Q * Va / D_p * n)
        side = 0.5 * RHO * (u * u + v * v) * 0.0133 * 0.5 * rudder
        up = 0.5 * RHO * (u * u + w * w) * 0.0133 * 0.7 * planes
        fins = np.array([-side * rudder - up * planes, -side, -up, 0.0, -0.8 * up, 0.8 * side])
        result: FloatArray = np.linalg.solve(self.M, tau + fins)
        return result

    def derivative(
        self, command: Callable[[float], tuple[float, float, float]]
    ) -> Callable[[float, FloatArray], FloatArray]:
        """Return the derivative (15) of (eta, nu, rudder, stern planes, rpm) under commands that depend on time; lags of 0.1, 0.1 and 1 s."""

        def f(t: float, y: FloatArray) -> FloatArray:
            phi, theta, psi = y[3:6]
            sp, cp, st, ct, ss, cs = (g(x) for x in (phi, theta, psi) for g in (math.sin, math.cos))
            R = np.array(
                [
                    [cs * ct, -ss * cp + cs * st * sp, ss * sp + cs * cp * st],
                    [ss * ct, cs * cp + sp * st * ss, -cs * sp + st * ss * cp],
                    [-st, ct * sp, ct * cp],
                ]
            )
            p, q, r = y[9:12]
            rates = [p + (q * sp + r * cp) * st / ct, q * cp - r * sp, (q * sp + r * cp) / ct]
            asked = np.array(command(t))
            return np.concatenate(
                [R @ y[6:9], rates, self.nu_dot(y[:6], y[6:12], *y[12:15]), (asked - y[12:15]) / [0.1, 0.1, 1.0]]
            )

        return f

    def run(
        self, spans: list[tuple[float, float, tuple[float, float, float]]], rtol: float = 1e-10
    ) -> list[FloatArray]:
        """Return the states at the end of each span (from, to, command), from rest at the origin, integrated by DOP853."""
        from scipy.integrate import solve_ivp  # imported here, because uwserver runs without scipy

        y, ends = np.zeros(15), []
        for start, end, command in spans:
            f = self.derivative(lambda _, command=command: command)  # type: ignore[misc]
            done = solve_ivp(f, (start, end), y, method="DOP853", rtol=rtol, atol=1e-12)
            y = done.y[:, -1]
            ends.append(y)
        return ends
