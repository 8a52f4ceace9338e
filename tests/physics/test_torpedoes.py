"""What all vehicles with fins share: signs of their fins, and level running with the fins at zero."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from uwserver.frames import rpy_from_quat
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU

SHIPPED = Path(__file__).parents[2] / "scenarios" / "uwserver_scenarios" / "vehicles"
HINGES = {
    (path.stem, name): (fin["hinge_frd"], fin["position_frd_m"])
    for path in sorted(SHIPPED.glob("*.toml"))
    for name, fin in msgspec.toml.decode(path.read_bytes()).get("fins", {}).items()
}
"""Hinge and place (B, m) of each shipped vehicle's fins."""
TORPEDOES = {"eca_a9": 157.0, "lauv": 169.7, "npsauv2": 157.08, "remus100": 159.7, "tethys": 50.0}
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
