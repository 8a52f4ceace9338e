"""Questions of compiled code to the world have the answers of `Scope`, `Water`, `Earth` and `Wiring`, which are written in plain Python."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sensor_rig import CAST, EARTH, MOUNT, Q, at, full_speed, world_with

from uwserver.environment.column import DENSITY, SALINITY, SOUND_SPEED, TEMPERATURE, WaterColumn
from uwserver.environment.water import Sea, Water
from uwserver.environment.waves import wave_number
from uwserver.frames import conjugate, multiply
from uwserver.physics.kernel.compiled import entry
from uwserver.physics.kernel.layout import (
    PROFILE_SIZE,
    WAVE_AMPLITUDE,
    WAVE_DEPTH,
    WAVE_K,
    WAVE_KX,
    WAVE_OMEGA,
    WAVE_PHASE,
    WAVE_SIZE,
    SeaRows,
)  # fmt: skip
from uwserver.physics.rays.raycast import NOTHING, SURFACE, no_hits
from uwserver.sensors import instant
from uwserver.sensors.compiled import HEAD
from uwserver.sensors.surroundings import ScopeArrays

LAYERS = Water(1023.0, 9.81, 18.0, 101_325.0, (0.3, -0.1, 0.05), given=WaterColumn(CAST, 9.81, 1023.0))
UNIFORM = Water(1025.0, 9.81, 12.0, 101_325.0, (0.0, 0.2, 0.0))


def swell() -> Water:
    """A wave and a current that changes, over layers."""
    waves = np.zeros((1, WAVE_SIZE))
    waves[0, [WAVE_K, WAVE_KX, WAVE_OMEGA, WAVE_AMPLITUDE]] = wave_number(0.8, 9.81, math.inf), 0.06, 0.8, 0.5
    waves[0, [WAVE_PHASE, WAVE_DEPTH]] = 0.3, math.inf
    rows = SeaRows(np.array([0.2, -0.1, 0.0, 0.01, 0.0, 0.0, 0.0]), np.zeros((0, PROFILE_SIZE)), waves)
    return replace(LAYERS, sea=Sea(rows))


WATERS = {"uniform": UNIFORM, "layers": LAYERS, "swell": swell()}
PLACES = [(1.0, 2.0, 5.0), (-30.0, 4.0, -2.0), (500.0, -700.0, 17.5), (0.0, 0.0, 400.0)]


@entry
def ask(heads, surroundings, t, out):
    """One answer after the other."""
    head = heads[0]
    p = instant.p_NS(head, surroundings)
    out[0], out[1], out[2] = p
    out[3], out[4], out[5], out[6] = instant.q_NS(head, surroundings)
    out[7], out[8], out[9] = instant.velocity_of(head, surroundings)
    out[10], out[11], out[12] = instant.specific_force(head, surroundings)
    for k in range(1, 5):
        out[12 + k] = instant.water_property(surroundings, k, p[2])
    out[17] = instant.gauge_pressure(surroundings, p, t)
    out[18], out[19], out[20] = instant.water_velocity(surroundings, p, t)
    out[21] = instant.submergence(surroundings, p, t)
    out[22], out[23], out[24] = instant.magnetic_field(surroundings, p)
    out[25] = instant.absorption(surroundings, 5e5, p[2])
    out[26] = instant.depth_of(surroundings, instant.gauge_pressure(surroundings, (p[0], p[1], max(0.0, p[2])), t))
    out[27], out[28], out[29], out[30] = instant.q_SB(head)


@entry
def inside(heads, surroundings, voltage, out):
    """What the vehicle is wired to; then the supply is set."""
    head = heads[0]
    out[0] = instant.shaft_speed(head, surroundings, 0)
    out[1] = instant.power(head, surroundings)
    out[2] = instant.supply_voltage(head, surroundings)
    if voltage >= 0.0:
        instant.supply(head, surroundings, voltage)


def head_on(mount):
    heads = np.zeros(1, HEAD)
    heads["p"], heads["q"], heads["to_S"] = mount.p, mount.q, conjugate(mount.q)
    return heads


@pytest.mark.parametrize("p", PLACES)
@pytest.mark.parametrize("water", WATERS)
def test_answers_are_those_of_plain_python(scope, water, p):
    rates = {"v_NB_B": (0.7, -0.3, 0.1), "w_NB_B": (0.1, -0.2, 0.3), "nu_dot": (0.2, 0.1, -0.3, 0.01, 0.03, -0.02)}
    seen = at(scope, 0.25, p_NB=p, q_NB=Q, water=WATERS[water], **rates)
    there, out, t = ScopeArrays(seen), np.zeros(31), seen.t
    ask(head_on(MOUNT), there.table, t, out)
    here, w = seen.position(MOUNT.p), seen.water
    depth = max(0.0, here[2])
    expected = [
        *here, *multiply(Q, MOUNT.q), *seen.velocity_of(MOUNT.p), *seen.specific_force(MOUNT),
    ]  # fmt: skip
    assert out[:13] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    column = {
        TEMPERATURE: w.temperature_at(depth), SALINITY: w.salinity_at(depth), DENSITY: w.density_at(depth),
        SOUND_SPEED: w.sound_speed(depth),
    }  # fmt: skip
    assert {k: out[12 + k] for k in column} == pytest.approx(column, rel=1e-12)
    assert out[17] == pytest.approx(w.pressure(here, t) - w.atmospheric_pressure, rel=1e-12, abs=1e-9)
    assert out[18:21] == pytest.approx(w.velocity(here, t), rel=1e-12, abs=1e-15)
    assert out[21] == pytest.approx(seen.submergence(here), rel=1e-12, abs=1e-12)
    assert out[22:25] == pytest.approx(EARTH.magnetic_field(here), rel=1e-12)
    assert out[25] == pytest.approx(w.absorption(5e5, here[2]), rel=1e-12)
    if w.sea is None:
        assert out[26] == pytest.approx(depth, rel=1e-9, abs=1e-9)
    assert out[27:] == pytest.approx(conjugate(MOUNT.q), abs=1e-15)


def test_a_swell_really_moves_the_water(scope):
    """Or else the answers about it would compare nothing with nothing."""
    water = WATERS["swell"]
    assert abs(water.elevation(1.0, 2.0, 0.25)) > 0.1
    assert water.velocity((1.0, 2.0, 1.0), 0.25) != water.velocity((1.0, 2.0, 9.0), 0.25)


def test_the_inside_of_a_vehicle_is_that_of_its_wiring(scope):
    world = world_with()
    full_speed(world, 1.0, "depth", -0.6)
    wiring = world.sensors["rov/imu"].wiring
    heads, there, out = head_on(MOUNT), ScopeArrays(scope(wiring=wiring)), np.zeros(3)
    inside(heads, there.table, -1.0, out)
    assert wiring.power() > 100.0
    row, lag = wiring.hydro.thrusters[0], wiring.hydro.lags[int(wiring.hydro.thrusters[0]["lag"])]
    force = float(lag["C"] @ row["x"] + lag["D"] * row["demand"]) / float(row["installed"])
    speed = wiring.electrics["t1"].turn(force)
    assert speed < 0.0
    assert out.tolist() == pytest.approx([speed, wiring.power(), wiring.voltage], rel=1e-12)
    inside(heads, there.table, 11.5, out)
    assert wiring.voltage == 11.5
    assert (wiring.hydro.thrusters["fresh"] == 1).all()
    assert (wiring.hydro.thrusters["efficiency"] > 0.0).all()
    inside(heads, there.table, 0.0, out)
    assert not wiring.hydro.thrusters["efficiency"].any()


def test_a_thruster_that_nobody_knows_has_no_speed_and_draws_nothing(scope):
    wiring = world_with().sensors["rov/imu"].wiring
    there, out = ScopeArrays(scope(wiring=wiring)), np.zeros(3)
    there.arrays["electrics"]["wired"] = 0
    inside(head_on(MOUNT), there.table, 5.0, out)
    assert math.isnan(out[0])
    assert out[1:].tolist() == [0.0, 0.0]
    assert wiring.voltage != 5.0


@pytest.mark.parametrize(
    ("down", "limit", "hit", "distance", "body"),
    [
        (-0.5, 100.0, math.inf, 8.0, SURFACE),  # up, and nothing before it
        (-0.5, 100.0, 5.0, 5.0, 3),  # something nearer
        (-0.5, 7.0, math.inf, math.inf, NOTHING),  # too far
        (0.5, 100.0, math.inf, math.inf, NOTHING),  # down
    ],
)
def test_a_ray_meets_the_surface(down, limit, hit, distance, body):
    hits = no_hits(1)
    hits.distance[0], hits.body[0] = hit, 3 if hit < math.inf else NOTHING
    meet(4.0, np.array([[math.sqrt(0.75), 0.0, down]]), limit, hits)
    assert (hits.distance[0], hits.body[0]) == (distance, body)
    if body == SURFACE:
        assert hits.normal[0].tolist() == [0.0, 0.0, 1.0]


@entry
def meet(height, direction, limit, hits):
    instant.meet_surface(height, direction, limit, 0, hits)
