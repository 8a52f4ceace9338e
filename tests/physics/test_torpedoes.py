"""What all vehicles with fins share: signs of their fins, level running with the fins at zero, steady dives and circles with them held."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from uwserver.frames import rpy_from_quat
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU
from uwserver.scenario.world.tables import Environment
from uwserver.units import deg, rad
from uwserver.validation.manoeuvres.helm import Helm, Sticks
from uwserver.validation.manoeuvres.report import resolve
from uwserver.validation.manoeuvres.runs import Track, Waters, hold, then

SHIPPED = Path(__file__).parents[2] / "scenarios" / "uwserver_scenarios" / "vehicles"
HINGES = {
    (path.stem, name): (fin["hinge_frd"], fin["position_frd_m"])
    for path in sorted(SHIPPED.glob("*.toml"))
    for name, fin in msgspec.toml.decode(path.read_bytes()).get("fins", {}).items()
}
"""Hinge and place (B, m) of each shipped vehicle's fins."""
TORPEDOES = {"eca_a9": 157.0, "lauv": 169.7, "npsauv2": 157.08, "remus100": 159.7, "tethys": 31.416}
"""Full shaft speed, rad/s."""


def turned(body: BodyParams, fin: str, angle: float) -> FloatArray:
    """Accelerations (6) that a fin's angle adds at 1.5 m/s ahead."""
    hydro = Hydrodynamics([body, body], 0.01)
    hydro.state[:, 2], hydro.state[:, NU] = 500.0, 1.5
    rows = [k for k, name in enumerate(servo.name for servo in body.appendages.servos) if name == f"fins.{fin}"]
    hydro.servos["value"][rows[0]] = hydro.servos["command"][rows[0]] = angle
    rates = hydro.rates_of_change(0.0)[0]
    added: FloatArray = rates[0] - rates[1]
    return added


@pytest.mark.parametrize(("model", "fin"), HINGES)
def test_signs_of_fins_are_alike(load_vehicle: Callable[..., BodyParams], model: str, fin: str) -> None:
    """Positive: a vertical or slanted fin turns to starboard, a level one has its trailing edge down and lifts."""
    (_, level, upright), place = HINGES[model, fin]
    added = turned(load_vehicle(model), fin, 0.1)
    if upright:
        assert added[5] > 1e-3
    else:
        assert level > 0.0
        assert added[2] < -1e-3
        assert np.sign(added[4]) == np.sign(place[0])


def test_every_torpedo_is_looked_at() -> None:
    assert set(TORPEDOES) <= {model for model, _ in HINGES}


@pytest.mark.parametrize("throttle", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("model", TORPEDOES)
def test_torpedoes_run_level_with_their_fins_at_zero(
    load_vehicle: Callable[..., BodyParams], model: str, throttle: float
) -> None:
    """Real ones are trimmed: less than 2 m a minute up or down and 2 degrees of pitch, whatever the speed.

    Nothing but a righting arm of some centimetres holds roll against the propeller's torque: a LAUV at full throttle leans by 12 degrees.
    """
    body = load_vehicle(model)
    hydro = Hydrodynamics([body], 0.01)
    hydro.state[0, 2] = 500.0
    shaft = [servo.name for servo in body.appendages.servos].index("propellers.main")
    hydro.servos["command"][shaft] = throttle * TORPEDOES[model]
    for tick in range(12000):
        hydro.advance(0.01 * tick)
    before = hydro.state[0].copy()
    for tick in range(12000, 13000):
        hydro.advance(0.01 * tick)
    climb = 6.0 * (before[2] - hydro.state[0, 2])
    roll, pitch, _ = rpy_from_quat(tuple(hydro.state[0, 3:7]))
    assert hydro.state[0, NU] > 0.3 * throttle
    assert abs(climb) < 2.0
    assert abs(math.degrees(pitch)) < 2.0
    assert abs(math.degrees(roll)) < 15.0


@pytest.mark.parametrize("model", ["lauv", "eca_a9"])
def test_stopped_torpedoes_float_up_level(load_vehicle: Callable[..., BodyParams], model: str) -> None:
    """Positive buoyancy brings a dead vehicle home."""
    hydro = Hydrodynamics([load_vehicle(model)], 0.01)
    hydro.state[0, 2] = 500.0
    for tick in range(12000):
        hydro.advance(0.01 * tick)
    assert 498.5 > hydro.state[0, 2] > 470.0
    assert abs(math.degrees(rpy_from_quat(tuple(hydro.state[0, 3:7]))[1])) < 3.0


HELD = tuple(side * rad(angle) for angle in (2.0, 5.0, 10.0) for side in (1.0, -1.0))
"""Angles of planes or rudder that are held, rad."""


def waters(load_vehicle: Callable[..., BodyParams], model: str) -> Waters:
    return Waters(Helm(resolve(model, Environment()).vehicle, load_vehicle(model)))


APPROACH_S = 40.0
"""Straight ahead, in which each reaches its speed."""


def held(sea: Waters, throttle: float, seconds: float, stick: str) -> list[Track]:
    """After the approach, with planes or rudder at each of HELD."""
    before = Sticks(surge=throttle)
    plans = [then(before, APPROACH_S, before._replace(**{stick: angle})) for angle in HELD]
    return [track.since(APPROACH_S) for track in sea.sail(plans, APPROACH_S + seconds)]


@pytest.mark.parametrize("throttle", [0.5, 1.0])
@pytest.mark.parametrize("model", TORPEDOES)
def test_planes_held_make_a_steady_dive_and_no_loop(
    load_vehicle: Callable[..., BodyParams], model: str, throttle: float
) -> None:
    """Open loop for a minute: it pitches the way of its planes, further by larger ones, and nobody stands on the nose."""
    pitch = {}
    for angle, track in zip(HELD, held(waters(load_vehicle, model), throttle, 60.0, "planes"), strict=True):
        assert deg(track.tilt.max()) < 80.0, deg(angle)
        pitch[round(deg(angle))] = float(track.pitch[-1] - track.pitch[0])
    assert [pitch[angle] for angle in (-10, -5, -2, 2, 5, 10)] == sorted(pitch.values(), reverse=True)
    assert pitch[2] < 0.0 < pitch[-2]


@pytest.mark.parametrize("throttle", [pytest.param(0.5, marks=pytest.mark.slow), 1.0])
@pytest.mark.parametrize("model", TORPEDOES)
def test_a_rudder_held_makes_a_circle(load_vehicle: Callable[..., BodyParams], model: str, throttle: float) -> None:
    """To its own side and at one rate: all of the way's last third is as far from one point, and level."""
    for angle, track in zip(HELD, held(waters(load_vehicle, model), throttle, 120.0 / throttle, "rudder"), strict=True):
        end = track.since(80.0 / throttle)
        rates = np.diff(end.heading)
        assert np.all(np.sign(rates) == np.sign(angle))
        assert np.ptp(rates) < 0.05 * abs(rates.mean())
        x, y = end.p[:, 0], end.p[:, 1]
        a, b, c = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=1), x * x + y * y, rcond=None)[0]
        radius = math.sqrt(c + 0.25 * (a * a + b * b))
        assert np.abs(np.hypot(x - 0.5 * a, y - 0.5 * b) - radius).max() < 0.02 * radius
        assert deg(track.tilt.max()) < 15.0


def test_with_its_whole_munk_moment_a_lauv_loops(load_vehicle: Callable[..., BodyParams]) -> None:
    """Why its file takes most of it out: 2 degrees are too much, with the righting arm and without the lift of its sources."""
    sea = waters(load_vehicle, "lauv")
    body = sea.helm.body
    x, y, z = body.r_b
    bare = replace(body, D_S=np.zeros((6, 6)), r_b=(x, y, 0.5 * z), appendages=replace(body.appendages, derivatives=()))
    sea.helm.body = bare
    (track,) = sea.sail([then(Sticks(surge=1.0), 120.0, Sticks(surge=1.0, planes=rad(5.0)))], 180.0)
    assert deg(track.tilt.max()) > 170.0


def test_tethys_turns_as_in_the_simulator_of_its_makers(load_vehicle: Callable[..., BodyParams]) -> None:
    """osrf/lrauv, test_mission_yoyo_circle.cc: 0.037 rad/s at 1 m/s with a rudder of 9 degrees."""
    (track,) = waters(load_vehicle, "tethys").sail([hold(Sticks(surge=1.0, rudder=rad(9.0)))], 200.0)
    end = track.steady
    assert float(np.diff(end.heading).mean() / end.t[1]) == pytest.approx(0.037, rel=0.05)
    assert end.speed.mean() == pytest.approx(1.0, abs=0.05)
