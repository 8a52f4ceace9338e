"""Long hulls in waves against strip theory in closed form: force and moment over a hull of one section throughout.

A strip is pulled by (rho A + a_perp) times the acceleration of the water. Over a length L in a wave along it that gives, with p = k L / 2, the
heave of a point times sin(p) / p, and the moment (rho A + a_perp) L w' (L / 2) (sin p - p cos p) / p^2.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uwserver.environment.water import Sea
from uwserver.environment.waves import wave_number
from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.appendage_params import Appendages, FoilParams
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, ForceTable, Lag, ThrusterParams
from uwserver.physics.kernel.layout import NU, PROFILE_SIZE, SHAPE_BOX, P, Q, SeaRows

G, RHO = 9.81, 1025.0
LENGTH, WIDTH = 4.0, 0.2
ZERO6 = np.zeros((6, 6))
WATER = RHO * WIDTH**2 * LENGTH
ADDED = 0.9 * WATER
"""Displaced water and added mass across the hull, kg."""
INERTIA = WATER * (LENGTH**2 + WIDTH**2) / 12.0


def hull(length: float | None = None) -> BodyParams:
    """A neutral, homogeneous hull of one section."""
    half = (LENGTH / 2, WIDTH / 2, WIDTH / 2)
    turning = ADDED * LENGTH**2 / 12.0
    return BodyParams(
        M_RB=np.diag([WATER, WATER, WATER, WATER * WIDTH**2 / 6.0, INERTIA, INERTIA]),
        M_A=np.diag([0.02 * WATER, ADDED, ADDED, 0.0, turning, turning]),
        D_L=ZERO6, D_Q=ZERO6, D_S=ZERO6,
        weight=WATER * G, buoyancy=WATER * G, r_g=(0.0,) * 3, r_b=(0.0,) * 3,
        shapes=(BuoyancyShape(SHAPE_BOX, (0.0,) * 3, half, WIDTH**2 * LENGTH),), displaced=WATER, length=length,
    )  # fmt: skip


def swell(length: float, heading: float = 0.0, amplitude: float = 0.01, depth: float = math.inf) -> SeaRows:
    """One wave by its length (m) and where it goes to (rad)."""
    k = 2.0 * math.pi / length
    omega = math.sqrt(G * k * (1.0 if math.isinf(depth) else math.tanh(k * depth)))
    row = [k * math.cos(heading), k * math.sin(heading), k, omega, amplitude, 0.0, depth]
    return SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), np.array([row]))


def afloat(body: BodyParams, sea: SeaRows, z: float, dt: float = 1.0 / 240.0, heading: float = 0.0) -> Hydrodynamics:
    hydro = Hydrodynamics([body], dt)
    hydro.sea = sea
    hydro.state[0, P + 2], hydro.state[0, Q : Q + 4] = z, quat_from_rpy(0.0, 0.0, heading)
    return hydro


def amplitudes(hydro: Hydrodynamics, axis: int) -> float:
    """Of the acceleration about one axis of B over a period of the wave."""
    assert hydro.sea is not None
    times = np.linspace(0.0, 2.0 * math.pi / hydro.sea.waves[0, 3], 24, endpoint=False)
    found = np.array([hydro.rates_of_change(t)[0][0, axis] for t in times])
    return float(np.abs(np.mean(found * np.exp(2j * math.pi * np.arange(24) / 24))) * 2.0)


def forms(p: float) -> tuple[float, float]:
    """sin(p)/p, and (sin p - p cos p)/p^2."""
    return (1.0, 0.0) if p == 0.0 else (math.sin(p) / p, (math.sin(p) - p * math.cos(p)) / p**2)


@pytest.mark.parametrize("heading", [0.0, math.pi, 0.5 * math.pi, 0.8], ids=["head", "following", "beam", "quartering"])
@pytest.mark.parametrize(("wave", "z"), [(9.0, 8.0), (9.0, 2.0), (5.0, 3.0), (40.0, 5.0)])
def test_heave_and_pitch_are_those_of_strip_theory(wave: float, z: float, heading: float) -> None:
    """The bars: 3 % in heave, 5 % in pitch. A point would heave 42 % too much in head seas of 9 m, and never pitch."""
    hydro = afloat(hull(), swell(wave, heading), z)
    k, omega = 2.0 * math.pi / wave, math.sqrt(G * 2.0 * math.pi / wave)
    lift = 0.01 * omega**2 * math.exp(-k * z)
    force, moment = forms(abs(0.5 * k * LENGTH * math.cos(heading)) if abs(math.cos(heading)) > 1e-9 else 0.0)
    assert amplitudes(hydro, 2) == pytest.approx(lift * force, rel=0.03, abs=2e-3 * lift)
    pitch = (WATER + ADDED) * lift * 0.5 * LENGTH * moment / (INERTIA + ADDED * LENGTH**2 / 12.0)
    assert amplitudes(hydro, 4) == pytest.approx(pitch, rel=0.05, abs=1e-9)
    point = afloat(hull(0.0), swell(wave, heading), z)
    assert amplitudes(point, 2) == pytest.approx(lift, rel=1e-3)
    assert amplitudes(point, 4) < 1e-12


def test_sway_and_yaw_in_quartering_seas() -> None:
    """The water moves sideways with sin(heading) of its speed along the wave."""
    heading, k, z = 0.8, 2.0 * math.pi / 9.0, 3.0
    hydro = afloat(hull(), swell(9.0, heading), z)
    push = 0.01 * G * k * math.exp(-k * z) * math.sin(heading)
    force, moment = forms(0.5 * k * LENGTH * math.cos(heading))
    assert amplitudes(hydro, 1) == pytest.approx(push * force, rel=0.03)
    yaw = (WATER + ADDED) * push * 0.5 * LENGTH * moment / (INERTIA + ADDED * LENGTH**2 / 12.0)
    assert amplitudes(hydro, 5) == pytest.approx(yaw, rel=0.05)


def test_a_hull_that_is_turned_feels_the_wave_as_one_that_comes_from_there() -> None:
    straight, turned = (
        afloat(hull(), swell(9.0, 0.8), 3.0),
        afloat(hull(), swell(9.0, 0.0), 3.0, heading=-0.8),
    )
    for axis in (1, 2, 4, 5):
        assert amplitudes(turned, axis) == pytest.approx(amplitudes(straight, axis), rel=1e-9)


def test_a_free_hull_heaves_and_pitches_through_the_wave() -> None:
    """Let go with the motion of the closed form, two periods long; its vertical course and its rate of pitch follow it."""
    wave, z, a = 9.0, 3.0, 0.002
    hydro = afloat(hull(), swell(wave, amplitude=a), z)
    k, omega = 2.0 * math.pi / wave, math.sqrt(G * 2.0 * math.pi / wave)
    force, moment = forms(0.5 * k * LENGTH)
    height = a * math.exp(-k * z) * force
    pitch = (WATER + ADDED) * a * math.exp(-k * z) * 0.5 * LENGTH * moment / (INERTIA + ADDED * LENGTH**2 / 12.0)
    # At t = 0 the crest is above: at its highest place it stands still and pitches fastest.
    hydro.state[0, P + 2] = z - height
    hydro.state[0, NU] = a * omega * math.exp(-k * z) * force
    hydro.state[0, NU + 4] = pitch * omega
    steps = round(2.0 * 2.0 * math.pi / omega * 240.0)
    course = np.empty((steps, 2))
    for n in range(steps):
        course[n] = hydro.state[0, P + 2] - z, hydro.state[0, NU + 4]
        hydro.advance(n / 240.0)
    t = np.arange(steps) / 240.0
    np.testing.assert_allclose(course[:, 0], -height * np.cos(omega * t), atol=0.03 * height)
    np.testing.assert_allclose(course[:, 1], pitch * omega * np.cos(omega * t), atol=0.05 * pitch * omega)


def test_shallow_water_has_its_own_wave() -> None:
    """cosh and sinh instead of exp: heave at mid-depth of 10 m."""
    wave, depth, z = 9.0, 6.0, 3.0
    k = 2.0 * math.pi / wave
    omega = math.sqrt(G * k * math.tanh(k * depth))
    assert wave_number(omega, G, depth) == pytest.approx(k)
    lift = 0.01 * omega**2 * math.sinh(k * (depth - z)) / math.sinh(k * depth)
    hydro = afloat(hull(), swell(wave, depth=depth), z)
    assert amplitudes(hydro, 2) == pytest.approx(lift * forms(0.5 * k * LENGTH)[0], rel=0.03)


def test_a_short_hull_gets_the_force_of_a_point_and_turns_with_the_wave() -> None:
    """kL = 0.03: force of a point within 1e-4; a slender neutral hull turns as the line of water that it lies in, at rate dw/dx."""
    wave, z = 2.0 * math.pi * LENGTH / 0.03, 20.0
    strips, point = afloat(hull(), swell(wave), z), afloat(hull(0.0), swell(wave), z)
    for axis in (0, 2):
        assert amplitudes(strips, axis) == pytest.approx(amplitudes(point, axis), rel=1e-4)
    k, omega = 2.0 * math.pi / wave, math.sqrt(G * 2.0 * math.pi / wave)
    assert amplitudes(strips, 4) == pytest.approx(k * 0.01 * omega**2 * math.exp(-k * z), rel=0.01)


def test_a_cube_is_not_turned_by_a_wave() -> None:
    """Pressure that is linear along a cube has no moment about its middle."""
    half = (0.25,) * 3
    body = replace(hull(), shapes=(BuoyancyShape(SHAPE_BOX, (0.0,) * 3, half, 0.125),))
    hydro = afloat(body, swell(9.0), 3.0)
    assert len(hydro.strips) > 0
    assert amplitudes(hydro, 4) < 1e-12
    slender = afloat(hull(), swell(9.0), 3.0)
    assert amplitudes(slender, 4) > 1e-4


def test_a_wave_of_no_height_changes_nothing() -> None:
    ends = []
    for sea in (None, swell(9.0, amplitude=0.0)):
        hydro = afloat(replace(hull(), D_L=20.0 * np.eye(6)), swell(9.0), 5.0)
        hydro.sea = sea
        hydro.state[0, NU : NU + 6] = 0.5, -0.2, 0.1, 0.2, -0.1, 0.3
        for n in range(200):
            hydro.advance(n / 240.0)
        ends.append(hydro.state.copy())
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-9, atol=1e-12)


def test_drag_acts_on_the_velocity_past_the_whole_hull() -> None:
    """Linear damping of a hull held still: that of the mean, and of the turning, of the water."""
    D = np.diag([0.0, 0.0, 300.0, 0.0, 400.0, 0.0])
    heavy = replace(hull(), M_RB=1e9 * np.eye(6), M_A=1e-9 * np.eye(6), displaced=0.0, D_L=D)
    hydro = afloat(heavy, swell(9.0), 3.0)
    k, omega = 2.0 * math.pi / 9.0, math.sqrt(G * 2.0 * math.pi / 9.0)
    w, (force, moment) = 0.01 * omega * math.exp(-k * 3.0), forms(0.5 * k * LENGTH)
    assert 1e9 * amplitudes(hydro, 2) == pytest.approx(300.0 * w * force, rel=0.01)
    turning = w * 0.5 * LENGTH * moment / (LENGTH**2 / 12.0)
    assert 1e9 * amplitudes(hydro, 4) == pytest.approx(400.0 * turning, rel=0.01)


@pytest.mark.parametrize("x", [-2.0, 0.0, 1.8])
def test_a_thruster_takes_the_inflow_of_its_place(x: float) -> None:
    table = ForceTable((16.0,), (((-1.0, -30.0), (1.0, 30.0)),))
    thruster = ThrusterParams("t", (x, 0.0, 0.1), (0.0, 0.0, 1.0), table, 16.0, Lag(), inflow=2.0)
    sea = swell(9.0, amplitude=0.3)
    hydro = afloat(replace(hull(), thrusters=(thruster,)), sea, 3.0)
    hydro.thrusters["demand"] = 25.0
    for t in (0.0, 0.5, 1.1):
        _, tau = hydro.rates_of_change(t)
        w, most = (
            Sea(sea).velocity((x, 0.0, 3.1), t)[2],
            0.3 * math.sqrt(G * 2 * math.pi / 9) * math.exp(-3.1 * 2 * math.pi / 9),
        )
        assert tau[0, 2] == pytest.approx(25.0 + 2.0 * 5.0 * w, abs=0.03 * 10.0 * most)


def test_a_fin_takes_the_flow_of_its_place() -> None:
    """At the stern the wave may go down while it goes up in the middle."""
    fin = FoilParams("", (-1.9, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), 20.0, 3.0, 0.0, 0.0, 1.0, 0.5, 0.6)
    sea = swell(6.0, amplitude=0.02)
    body = replace(hull(), M_RB=1e6 * np.eye(6), M_A=1e-9 * np.eye(6), displaced=0.0)
    with_fin, bare = (afloat(replace(body, appendages=Appendages(foils=f)), sea, 3.0) for f in ((fin,), ()))
    for hydro in (with_fin, bare):
        hydro.state[0, NU] = 2.0
    for t in (0.0, 0.4, 0.9):
        lift = 1e6 * (with_fin.rates_of_change(t)[0] - bare.rates_of_change(t)[0])[0, 2]
        u, _, w = Sea(sea).velocity((-1.9, 0.0, 3.0), t)
        # lift coefficient 3 alpha, alpha = w / (2 - u) from below, on 20 V^2; z down
        assert lift == pytest.approx(20.0 * 3.0 * (2.0 - u) * w, rel=0.03, abs=5e-3)
