"""Bodies in waves, shear and drifting currents against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.motion import record

from uwserver.environment.currents import ProfileConfig, profile_rows
from uwserver.environment.water import Sea
from uwserver.environment.waves import wave_number
from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, ForceTable, Lag, ThrusterParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import (
    FLOW_GRADIENT,
    FLOW_V_T,
    NU,
    PROFILE_SIZE,
    SHAPE_BOX,
    SHAPE_SPHERE,
    WAVE_SIZE,
    P,
    Q,
    SeaRows,
)

G, RHO = 9.81, 1025.0
NO_PROFILES, NO_WAVES = np.zeros((0, PROFILE_SIZE)), np.zeros((0, WAVE_SIZE))
ZERO6 = np.zeros((6, 6))


def sea(waves: FloatArray = NO_WAVES, profiles: FloatArray = NO_PROFILES, uniform: FloatArray | None = None) -> SeaRows:
    return SeaRows(np.zeros(7) if uniform is None else uniform, profiles, waves)


def wave(
    amplitude: float, omega: float, heading: float = 0.0, depth: float = math.inf, phase: float = 0.0
) -> FloatArray:
    """One component as a row (1, WAVE_SIZE)."""
    k = wave_number(omega, G, depth)
    return np.array([[k * math.cos(heading), k * math.sin(heading), k, omega, amplitude, phase, depth]])


def sphere(radius: float = 0.05, density: float = RHO, damping: float = 0.0) -> BodyParams:
    """A homogeneous sphere with its potential-flow added mass, half the water that it displaces."""
    water = RHO * 4.0 / 3.0 * math.pi * radius**3
    mass = water * density / RHO
    inertia = 0.4 * mass * radius**2
    return BodyParams(
        M_RB=np.diag([mass] * 3 + [inertia] * 3),
        M_A=np.diag([0.5 * water] * 3 + [0.0] * 3),
        D_L=damping * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
        D_Q=ZERO6,
        D_S=ZERO6,
        weight=mass * G,
        buoyancy=water * G,
        r_g=(0.0, 0.0, 0.0),
        r_b=(0.0, 0.0, 0.0),
        displaced=water,
    )  # fmt: skip


def released(
    body: BodyParams, rows: SeaRows, start: tuple[float, float, float], dt: float = 1.0 / 240.0
) -> Hydrodynamics:
    """The body let go with the velocity of the water around it."""
    hydro = Hydrodynamics([body], dt)
    hydro.sea = rows
    hydro.state[0, P : P + 3] = start
    hydro.state[0, NU : NU + 3] = Sea(rows).velocity(start, 0.0)
    return hydro


def drifted(rows: SeaRows, start: tuple[float, float, float], seconds: float, steps: int) -> FloatArray:
    """Where a particle of the water is after some time: RK4 of dx/dt = u(x, t)."""
    water, x, h = Sea(rows), np.array(start), seconds / steps

    def u(x: FloatArray, t: float) -> FloatArray:
        return np.array(water.velocity((x[0], x[1], x[2]), t))

    for n in range(steps):
        t = n * h
        k1 = u(x, t)
        k2 = u(x + 0.5 * h * k1, t + 0.5 * h)
        k3 = u(x + 0.5 * h * k2, t + 0.5 * h)
        k4 = u(x + h * k3, t + h)
        x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return x


def test_a_particle_with_the_density_of_water_moves_with_the_water() -> None:
    """Froude-Krylov plus added mass are exactly what accelerates the water itself; no drag helps."""
    rows = sea(np.concatenate([wave(0.5, 1.0, 0.3), wave(0.3, 1.7, -0.8, phase=1.0)]))
    start = (2.0, -1.0, 3.0)
    hydro = released(sphere(), rows, start)
    _, states = record(hydro, 20.0)
    assert np.abs(states[:, 0, P : P + 3] - start).max() > 0.3
    np.testing.assert_allclose(states[-1, 0, P : P + 3], drifted(rows, start, 20.0, 2400), atol=2e-4)
    np.testing.assert_allclose(
        states[-1, 0, NU : NU + 3], Sea(rows).velocity(tuple(states[-1, 0, :3]), 20.0), atol=2e-4
    )


def test_the_error_of_following_a_wave_falls_with_the_square_of_the_step() -> None:
    rows, start = sea(wave(0.5, 2.0)), (0.0, 0.0, 2.0)
    end = drifted(rows, start, 10.0, 4000)
    errors = []
    for dt in (0.04, 0.02, 0.01):
        _, states = record(released(sphere(), rows, start, dt), 10.0)
        errors.append(np.linalg.norm(states[-1, 0, :3] - end))
    assert errors[0] / errors[1] > 3.5
    assert errors[1] / errors[2] > 3.5


def test_the_orbit_is_a_circle_that_shrinks_with_depth() -> None:
    """Radius a exp(-k z), for an amplitude so small that the wave is linear for the particle too."""
    a, omega = 1e-3, 2.0 * math.pi / 4.0
    k = omega**2 / G
    for z in (1.0, 5.0, 10.0):
        _, states = record(released(sphere(), sea(wave(a, omega)), (0.0, 0.0, z)), 4.0)
        radius = 0.5 * np.ptp(states[:, 0, [0, 2]], axis=0)
        np.testing.assert_allclose(radius, a * math.exp(-k * z), rtol=2e-3)


@pytest.mark.parametrize("density", [500.0, 1025.0, 2500.0])
def test_a_sphere_in_an_oscillating_uniform_stream(density: float) -> None:
    """Without drag (m + m_a) v' = (rho V + m_a) u': the ratio of speeds is 3 / (1 + 2 s), s the relative density (Landau, Lifshitz 11)."""
    body = sphere(density=density)
    body = replace(body, weight=body.buoyancy)
    rate = 0.2
    hydro = Hydrodynamics([body], 0.01)
    hydro.sea = sea(uniform=np.array([0.0, 0.0, 0.0, rate, -rate, 0.5 * rate, 0.0]))
    hydro.state[0, 2], hydro.state[0, Q : Q + 4] = 50.0, quat_from_rpy(0.3, -0.5, 1.0)
    hydro.state[0, NU + 3 : NU + 6] = 0.4, -0.2, 0.3
    for n in range(200):
        hydro.advance(n * 0.01)
    moved = hydro.state[0, :3] - (0.0, 0.0, 50.0)
    ratio = 3.0 / (1.0 + 2.0 * density / RHO)
    np.testing.assert_allclose(moved, 0.5 * rate * ratio * 4.0 * np.array([1.0, -1.0, 0.5]), rtol=1e-6)


def test_accelerating_water_is_a_galilean_shift_with_gravity(full_body: BodyParams) -> None:
    """In water that accelerates as a whole by A everything is as in still water where A is taken from gravity: weight W - m A, buoyancy - rho V A.

    For a neutral, homogeneous-looking body (r_g = r_b, m = rho V) the two cancel: the run is that in still water, shifted.
    """
    mass = full_body.weight / G
    body = replace(full_body, r_b=full_body.r_g, buoyancy=full_body.weight, displaced=mass)
    A, dt, steps = np.array([0.05, -0.03, 0.02]), 1.0 / 240.0, 2400
    still, moving = Hydrodynamics([body], dt), Hydrodynamics([body], dt)
    for hydro in (still, moving):
        hydro.state[0, 2], hydro.state[0, NU : NU + 6] = 100.0, (0.5, -0.3, 0.2, 0.3, -0.2, 0.4)
        hydro.state[0, Q : Q + 4] = quat_from_rpy(0.4, -0.3, 0.8)
    moving.sea = sea(uniform=np.array([0.0, 0.0, 0.0, *A, 0.0]))
    for n in range(steps):
        still.advance(n * dt)
        moving.advance(n * dt)
    t = steps * dt
    np.testing.assert_allclose(moving.state[0, :3], still.state[0, :3] + 0.5 * A * t**2, atol=1e-8)
    np.testing.assert_allclose(moving.state[0, Q : Q + 4], still.state[0, Q : Q + 4], atol=1e-9)


def test_a_steady_sea_moves_bodies_as_a_uniform_current_does(full_body: BodyParams) -> None:
    """A uniform current told as a profile or as the sea's uniform part is the same current."""
    u = (0.4, -0.3, 0.1)
    flat = profile_rows(ProfileConfig(depth_m=(0.0, 500.0), velocity_ned_mps=(u, u)))
    ends = []
    for rows in (None, sea(profiles=flat), sea(uniform=np.array([*u, 0.0, 0.0, 0.0, 0.0]))):
        hydro = Hydrodynamics([full_body], 0.01)
        hydro.currents[0], hydro.sea = u, rows
        hydro.state[0, 2], hydro.state[0, NU + 3 : NU + 6] = 100.0, (0.3, -0.2, 0.4)
        for n in range(500):
            hydro.advance(n * 0.01)
        ends.append(hydro.state.copy())
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(ends[2], ends[0], rtol=1e-10, atol=1e-10)


def test_a_sheared_current_accelerates_what_sinks_through_it() -> None:
    """du/dt along the path is shear times the sinking speed; without drag (m + m_a) v' = m_a w du/dz, as Du/Dt is zero."""
    shear, sink = 0.02, 0.5
    profile = profile_rows(
        ProfileConfig(depth_m=(0.0, 100.0), velocity_ned_mps=((0.0, 0.0, 0.0), (100.0 * shear, 0.0, 0.0)))
    )
    body = sphere(density=1.5 * RHO)
    body = replace(body, weight=body.buoyancy)
    hydro = released(body, sea(profiles=profile), (0.0, 0.0, 10.0))
    hydro.state[0, NU + 2] = sink
    u0 = hydro.state[0, NU]
    _, states = record(hydro, 10.0)
    v = states[-1, 0, NU] - u0
    assert v == pytest.approx(10.0 * sink * shear * 0.5 / (1.5 + 0.5), rel=1e-6)


def test_pressure_and_velocity_obey_the_equation_of_motion() -> None:
    """rho du/dt = -grad p of the linear wave, and grad is what differences of the velocity say; finite depth, three waves."""
    waves = np.concatenate([wave(0.3, 1.1, 0.7, 12.0), wave(0.2, 2.0, -2.0, 12.0, 0.4), wave(0.1, 0.6, 3.0, 12.0, 2.0)])
    water, h, t = Sea(sea(waves)), 1e-4, 3.3
    x = np.array([4.0, -7.0, 5.0])

    def at(q: FloatArray, t: float) -> FloatArray:
        return np.array([*water.velocity((q[0], q[1], q[2]), t), G * water.head((q[0], q[1], q[2]), t)])

    u_t = (at(x, t + h) - at(x, t - h))[:3] / (2.0 * h)
    gradient = np.stack([(at(x + h * e, t) - at(x - h * e, t)) / (2.0 * h) for e in np.eye(3)], axis=1)
    np.testing.assert_allclose(u_t, -gradient[3], atol=1e-7)
    assert np.trace(gradient[:3]) == pytest.approx(0.0, abs=1e-7)
    np.testing.assert_allclose(gradient[:3], gradient[:3].T, atol=1e-7)  # irrotational
    # and the derivatives that the kernel computes by itself
    hydro = Hydrodynamics([sphere()], 0.01)
    hydro.sea = sea(waves)
    hydro.state[0, :3] = x
    hydro.rates_of_change(t)
    np.testing.assert_allclose(hydro.flows[0, FLOW_V_T : FLOW_V_T + 3], u_t, atol=1e-7)
    np.testing.assert_allclose(hydro.flows[0, FLOW_GRADIENT : FLOW_GRADIENT + 9].reshape(3, 3), gradient[:3], atol=1e-7)


def test_no_water_flows_through_the_bottom() -> None:
    water = Sea(sea(wave(0.5, 0.8, 0.3, 15.0)))
    assert water.velocity((1.0, 2.0, 15.0), 0.7)[2] == pytest.approx(0.0, abs=1e-12)
    assert abs(water.velocity((1.0, 2.0, 15.0), 0.7)[0]) > 0.01


def box(mass_part: float, half: tuple[float, float, float]) -> BodyParams:
    volume = 8.0 * half[0] * half[1] * half[2]
    mass = mass_part * RHO * volume
    D = np.diag([3.0 * mass] * 3 + [0.8 * mass * half[0] ** 2] * 3)
    return BodyParams(
        M_RB=np.diag([mass] * 3 + [0.2 * mass * half[0] ** 2] * 3),
        M_A=np.diag([0.3 * mass] * 3 + [0.02 * mass * half[0] ** 2] * 3),
        D_L=D, D_Q=ZERO6, D_S=ZERO6,
        weight=mass * G, buoyancy=RHO * G * volume, r_g=(0.0, 0.0, 0.0), r_b=(0.0, 0.0, 0.0),
        shapes=(BuoyancyShape(SHAPE_BOX, (0.0, 0.0, 0.0), half, volume),), displaced=RHO * volume,
    )  # fmt: skip


def test_a_small_raft_rides_on_a_long_wave() -> None:
    """It rises and falls with the elevation and lies in the slope, half immersed."""
    a, omega = 0.5, 2.0 * math.pi / 10.0
    rows = sea(wave(a, omega))
    hydro = Hydrodynamics([box(0.5, (0.2, 0.2, 0.03))], 0.01)
    hydro.sea = rows
    water = Sea(rows)
    hydro.state[0, 2] = -water.elevation(0.0, 0.0, 0.0)
    times, states = record(hydro, 60.0)
    late = times > 20.0
    height = np.array([water.elevation(s[0], s[1], t) for t, s in zip(times[late], states[late, 0], strict=True)])
    assert np.abs(-states[late, 0, 2] - height).max() < 0.03 * a
    # slope along x against pitch: bow up where the surface rises ahead
    ahead = np.array([water.elevation(s[0] + 1e-3, s[1], t) for t, s in zip(times[late], states[late, 0], strict=True)])
    slope = (ahead - height) / 1e-3
    w, x, y, z = states[late, 0, Q : Q + 4].T
    pitch = np.arcsin(2.0 * (w * y - z * x))
    assert np.abs(pitch - np.arctan(slope)).max() < 0.1 * np.abs(slope).max()


def test_at_rest_in_the_slope_nothing_pulls_along_it() -> None:
    """Buoyancy and Froude-Krylov force add up to a force square to the surface, as pressure is constant along it (to the order of the wave)."""
    rows = sea(wave(0.01, 2.0 * math.pi / 6.0, 0.4, phase=1.2))
    body = box(0.5, (0.1, 0.1, 0.1))
    hydro = Hydrodynamics([replace(body, D_L=ZERO6, weight=0.0)], 0.01)
    hydro.sea = rows
    water, h = Sea(rows), 1e-4
    hydro.state[0, 2] = -water.elevation(0.0, 0.0, 0.0)
    nu_dot, _ = hydro.rates_of_change(0.0)
    # without the added mass' share in the moving water
    half = replace(body, D_L=ZERO6, weight=0.0, M_A=1e-9 * np.eye(6))
    bare = Hydrodynamics([half], 0.01)
    bare.sea, bare.state[0] = rows, hydro.state[0]
    nu_dot, _ = bare.rates_of_change(0.0)
    slope = [
        (water.elevation(h * (i == 0), h * (i == 1), 0.0) - water.elevation(-h * (i == 0), -h * (i == 1), 0.0))
        / (2 * h)
        for i in (0, 1)
    ]
    np.testing.assert_allclose(nu_dot[0, :2] / nu_dot[0, 2], slope, rtol=0.02)


def test_waves_reach_deeper_than_the_still_surface() -> None:
    """A body whose highest part lies below z = 0 comes out of the water in a trough."""
    rows = sea(wave(1.0, 2.0 * math.pi / 8.0, phase=math.pi))  # trough at the origin
    body = replace(box(1.0, (0.1, 0.1, 0.1)), D_L=ZERO6)
    hydro = Hydrodynamics([body, body], 0.01)
    hydro.sea = rows
    hydro.state[:, 2] = 0.5, 1.5
    nu_dot, _ = hydro.rates_of_change(0.0)
    assert nu_dot[0, 2] == pytest.approx(G, rel=1e-6)
    assert abs(nu_dot[1, 2]) < 1.0


def test_a_wave_of_no_height_changes_nothing_at_the_surface() -> None:
    ends = []
    for rows in (None, sea(wave(0.0, 1.0))):
        hydro = Hydrodynamics([box(0.7, (0.3, 0.2, 0.1))], 0.01)
        hydro.sea = rows
        hydro.state[0, 2], hydro.state[0, Q : Q + 4] = -0.1, quat_from_rpy(0.3, 0.2, 0.0)
        for n in range(400):
            hydro.advance(n * 0.01)
        ends.append(hydro.state.copy())
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-9, atol=1e-12)


def test_a_sphere_under_a_crest_is_as_deep_as_the_crest_is_high() -> None:
    rows = sea(wave(0.4, 2.0 * math.pi / 8.0))
    shape = (BuoyancyShape(SHAPE_SPHERE, (0.0, 0.0, 0.0), (0.05, 0.05, 0.05), 1.0),)
    hydro = Hydrodynamics([replace(sphere(), shapes=shape), replace(sphere(), shapes=shape)], 0.01)
    hydro.sea = rows
    hydro.state[:, 2] = -0.3, -0.5
    nu_dot, _ = hydro.rates_of_change(0.0)
    assert abs(nu_dot[0, 2]) < 1.0  # immersed though above z = 0: neutral
    assert nu_dot[1, 2] == pytest.approx(G, rel=1e-6)


def test_a_propeller_pulls_where_the_wave_leaves_it_in_water() -> None:
    """In a trough it is dry though below z = 0, under a crest wet though above; half out where its hub is at the surface."""
    table = ForceTable((16.0,), (((-1.0, -30.0), (1.0, 30.0)),))
    thruster = ThrusterParams("t", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), table, 16.0, Lag(), disc_radius=0.05)
    body = replace(box(1.0, (0.1, 0.1, 0.1)), thrusters=(thruster,))
    a = 0.5
    for phase, depths, parts in ((math.pi, (0.3, a, 0.8), (0.0, 0.5, 1.0)), (0.0, (-0.3, -a, -0.8), (1.0, 0.5, 0.0))):
        hydro = Hydrodynamics([body] * 3, 0.01)
        hydro.sea = sea(wave(a, 1.0, phase=phase))
        hydro.state[:, 2] = depths
        hydro.thrusters["demand"] = 20.0
        _, tau = hydro.rates_of_change(0.0)
        np.testing.assert_allclose(tau[:, 1], 20.0 * np.array(parts), atol=1e-9)
