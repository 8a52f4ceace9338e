"""Does the real one do that? Otter, Slocum, Minerva, LBV150, VideoRay Pro 4 and Girona 500: speeds, trim and terminal behaviour."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from attitudes import rpy_deg

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q
from uwserver.ports import Sample
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.world import World

RATE = 100
DEEP = 500.0
KNOT = 0.5144
ROVS = ("girona500", "lbv150", "minerva", "videoray_pro4")
MINERVA = (1.03, 0.70, 0.556)
"""Where the source's propellers, K_T = 0.24 - 0.25 J - 0.66 J^2 + 0.5 J^3 at 1450 rpm with their losses, meet its damping: m/s ahead, right, down."""
THROTTLES = tuple(way * part for part in (0.1, 0.3, 0.5, 0.7, 1.0) for way in (1.0, -1.0))

LoadVehicle = Callable[..., BodyParams]


def follow(hydro: Hydrodynamics, seconds: float, command: Callable[[float], None]) -> FloatArray:
    """States (steps + 1, n, 13) of a run that a function of time commands."""
    states = [hydro.state.copy()]
    for k in range(round(seconds * RATE)):
        command(k / RATE)
        assert hydro.advance(k / RATE) < 0
        states.append(hydro.state.copy())
    return np.array(states)


def push(
    body: BodyParams, commands: list[dict[str, float]], seconds: float = 20.0, ramp: float = 2.0,
    depth: float = DEEP, start: FloatArray | None = None,
) -> FloatArray:  # fmt: skip
    """States of one run for each set of thruster commands by name, ramped up; `start` (n, 6) is the velocity at first."""
    hydro = Hydrodynamics([body] * len(commands), 1.0 / RATE)
    hydro.state[:, 2] = depth
    if start is not None:
        hydro.state[:, NU:] = start
    full = np.array([command.get(thruster.name, 0.0) for command in commands for thruster in body.thrusters])

    def command(t: float) -> None:
        hydro.thrusters["command"] = full * (min(1.0, t / ramp) if ramp > 0.0 else 1.0)
        hydro.thrusters["fresh"] = 1

    return follow(hydro, seconds, command)


def ahead(body: BodyParams) -> list[str]:
    """Names of the thrusters that drive ahead."""
    return [thruster.name for thruster in body.thrusters if thruster.axis[0] > 0.5]


def surge(body: BodyParams, throttles: tuple[float, ...] = THROTTLES) -> list[dict[str, float]]:
    return [dict.fromkeys(ahead(body), throttle) for throttle in throttles]


# -- ROVs -----------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ROVS)
@pytest.mark.parametrize("ramp", [2.0, 0.0])
def test_rovs_drive_straight_and_level(load_vehicle: LoadVehicle, model: str, ramp: float) -> None:
    """A pilot pushes the stick, slowly or at once, and the vehicle goes there."""
    body = load_vehicle(model)
    rpy = rpy_deg(push(body, surge(body), ramp=ramp))
    assert np.abs(rpy[:, :, 0]).max() < 5.0
    assert np.abs(rpy[:, :, 1]).max() < (15.0 if ramp else 25.0)
    assert np.abs(rpy[3 * RATE :, :, 1]).max() < 8.0
    assert np.abs(rpy[:, :, 2]).max() < 20.0


@pytest.mark.parametrize("model", ROVS)
@pytest.mark.parametrize("drift_deg", [2.0, -2.0])
def test_rovs_keep_their_course_when_disturbed(load_vehicle: LoadVehicle, model: str, drift_deg: float) -> None:
    """From their speed with 2 degrees of drift and 2 degrees/s: 20 degrees in 20 s."""
    body = load_vehicle(model)
    start = np.zeros((len(THROTTLES), 6))
    start[:, 0] = push(body, surge(body))[-1, :, NU]
    start[:, 1] = np.abs(start[:, 0]) * math.tan(math.radians(drift_deg))
    start[:, 5] = math.radians(2.0)
    rpy = rpy_deg(push(body, surge(body), ramp=0.0, start=start))
    assert np.abs(rpy[:, :, 2]).max() < 20.0


def test_with_the_whole_munk_moment_a_rov_leaves_its_course(load_vehicle: LoadVehicle) -> None:
    """Why terms of C_A are taken out: the matrices of the source alone throw an LBV150 round."""
    body = load_vehicle("lbv150")
    bare = replace(body, D_S=np.zeros((6, 6)), appendages=replace(body.appendages, derivatives=()))
    start = np.array([[1.3, 0.05, 0.0, 0.0, 0.0, 0.03]])
    rpy = rpy_deg(push(bare, surge(body, (1.0,)), ramp=0.0, start=start))
    assert np.abs(rpy[:, :, 2]).max() > 60.0


@pytest.mark.parametrize(
    ("model", "command", "axis", "speed", "within"),
    [
        # the LBV300 with twice the thrust ahead: 4 knots (University of the Azores, ROV SP); the manual of the LBV150: a current of 1.5 knots
        ("lbv150", {"port": 1.0, "starboard": 1.0}, 0, 4.0 * KNOT / math.sqrt(2.0), 0.1),
        # VideoRay, as recalled: 4.2 knots
        ("videoray_pro4", {"port": 1.0, "starboard": 1.0}, 0, 4.2 * KNOT, 0.02),
        # propellers and damping of the source, K_T(J) and all; NTNU AUR-Lab, as recalled: 2.0 knots ahead, 1.3 sideways, 1.2 down
        ("minerva", {"main_port": 1.0, "main_starboard": 1.0}, 0, MINERVA[0], 0.06),
        ("minerva", {"lateral": 1.0, "main_port": -0.88, "main_starboard": 0.6}, 1, MINERVA[1], 0.06),
        ("minerva", {"vertical_port": 1.0, "vertical_starboard": 1.0}, 2, MINERVA[2], 0.06),
        # equations of UWSim: sqrt(2 x 153.8 / 148), here with damping at rest
        ("girona500", {"surge_port": 1.0, "surge_starboard": 1.0}, 0, 1.44, 0.06),
    ],
)
def test_full_speed(
    load_vehicle: LoadVehicle, model: str, command: dict[str, float], axis: int, speed: float, within: float
) -> None:
    """As published, in parts of it."""
    assert push(load_vehicle(model), [command])[-1, 0, NU + axis] == pytest.approx(speed, rel=within)


@pytest.mark.parametrize(
    ("model", "command", "low", "high"),
    [
        # NTNU AUR-Lab, as recalled: 60 degrees/s
        ("minerva", {"main_port": 1.0, "main_starboard": -1.0, "lateral": 1.0}, 50.0, 70.0),
        ("lbv150", {"port": 1.0, "starboard": -1.0}, 60.0, 180.0),
        ("videoray_pro4", {"port": 1.0, "starboard": -1.0}, 90.0, 270.0),
        ("girona500", {"surge_port": 1.0, "surge_starboard": -1.0}, 15.0, 60.0),
    ],
)
def test_turning_on_the_spot(
    load_vehicle: LoadVehicle, model: str, command: dict[str, float], low: float, high: float
) -> None:
    """Degrees/s to starboard at full sticks; it stays upright."""
    states = push(load_vehicle(model), [command])
    assert low < math.degrees(states[-1, 0, NU + 5]) < high
    assert np.abs(rpy_deg(states)[:, :, :2]).max() < 30.0


@pytest.mark.parametrize("model", ROVS)
def test_rovs_come_to_rest_upright_and_rise_slowly(load_vehicle: LoadVehicle, model: str) -> None:
    """Left alone, lying on the side and turning: a little buoyancy brings them home, level."""
    hydro = Hydrodynamics([load_vehicle(model)], 1.0 / RATE)
    hydro.state[0, 2] = DEEP
    hydro.state[0, Q : Q + 4] = quat_from_rpy(1.5, 0.3, 0.0)
    hydro.state[0, NU:] = 0.3, -0.2, 0.1, 0.5, -0.4, 0.6
    end = follow(hydro, 90.0, lambda t: None)[-1]
    assert np.abs(rpy_deg(end[None])[0, 0, :2]).max() < 1.0
    assert -0.2 < end[0, NU + 2] < 0.0
    assert np.abs(end[0, NU + 3 :]).max() < 0.01


# -- Otter ----------------------------------------------------------------------------------------------------------------------------------


def test_the_otter_floats_level_at_its_draft(load_vehicle: LoadVehicle) -> None:
    """MSS: 13.4 cm with 55 kg, which is z = 0."""
    rest = push(load_vehicle("otter"), [{}], depth=0.1)[-1]
    assert rest[0, 2] == pytest.approx(0.0, abs=1e-3)
    assert np.abs(rpy_deg(rest[None])).max() < 0.05


@pytest.mark.parametrize(("axis", "expected"), [(0, 0.744), (1, 0.690)])
def test_the_otter_rolls_and_pitches_with_the_periods_of_its_metacentric_heights(
    load_vehicle: LoadVehicle, axis: int, expected: float
) -> None:
    """2 pi sqrt(M / G) of the source's G = m g GM, GM_T = 1.98 m and GM_L = 4.41 m; damped, so a little longer."""
    hydro = Hydrodynamics([load_vehicle("otter")], 1.0 / RATE)
    hydro.state[0, Q : Q + 4] = quat_from_rpy(*(0.1 if k == axis else 0.0 for k in range(3)))
    tilt = rpy_deg(follow(hydro, 3.0, lambda t: None))[:, 0, axis]
    crossings = np.flatnonzero(np.diff(np.sign(tilt)))[:4] / RATE
    assert 2.0 * np.diff(crossings).mean() == pytest.approx(expected, rel=0.15)


def test_the_otter_makes_six_knots_and_stays_on_the_water(load_vehicle: LoadVehicle) -> None:
    """Its source: 24.4 kgf for 6 knots; it does not dive under, whatever the thrust, and keeps its course when disturbed."""
    body = load_vehicle("otter")
    start = np.zeros((10, 6))
    start[:, 1], start[:, 5] = 0.1, math.radians(2.0)
    states = push(body, surge(body), 30.0, depth=0.0, start=start)
    assert states[-1, THROTTLES.index(1.0), NU] == pytest.approx(6.0 * KNOT, rel=0.05)
    assert np.abs(states[:, :, 2]).max() < 0.03
    rpy = rpy_deg(states)
    assert np.abs(rpy[:, :, :2]).max() < 3.0
    assert np.abs(rpy[:, :, 2]).max() < 10.0


def test_the_otter_turns_by_one_thruster_to_the_other_side(load_vehicle: LoadVehicle) -> None:
    states = push(load_vehicle("otter"), [{"port": 1.0}, {"port": 1.0, "starboard": -1.0}], 30.0, depth=0.0)
    turn = np.degrees(states[-1, :, NU + 5])
    assert 5.0 < turn[0] < turn[1] < 40.0
    assert states[-1, 0, NU] > 1.0


def test_the_otter_comes_up_and_floats_again(load_vehicle: LoadVehicle) -> None:
    """Pushed 2 m under, and let go."""
    states = push(load_vehicle("otter"), [{}], depth=2.0)
    assert states[:, 0, 2].min() > -0.2
    assert states[-1, 0, 2] == pytest.approx(0.0, abs=1e-3)


@pytest.fixture(scope="module")
def at_sea() -> tuple[World, list[Sample]]:
    """Half a minute on waves half a metre high: an Otter at half throttle whose USBL looks for a LAUV 20 m down."""
    builder = ScenarioBuilder("sea", seed=1, rate_hz=240, adapters={})
    builder.waves(significant_height_m=0.5, peak_period_s=5.0, direction_deg=30.0)
    builder.vehicle("ship", "otter", position_ned_m=(0.0, 0.0, 0.0))
    builder.vehicle("auv", "lauv", position_ned_m=(30.0, 10.0, 20.0))
    beacons = {"auv": {"vehicle": "auv"}}
    builder.sensor("ship", "usbl", "usbl", profile="seatrac_x150", rate_hz=1, mount="transducer", beacons=beacons)
    world = build(load(builder.build(), adapters={}))
    fixes: list[Sample] = []
    for _ in range(60):
        world.command("ship/thrusters", u=[0.5, 0.5])
        for _ in range(5):
            fixes += [sample for sample in world.step(24) if sample.port == "ship/usbl"]
            ship = world.vehicles["ship"]
            x, y, z = ship.p_NB
            assert abs(z + world.water.elevation(x, y, world.t_ns / 1e9)) < 0.08
            assert max(abs(math.degrees(angle)) for angle in ship.pose.rpy[:2]) < 12.0
    return world, fixes


def test_the_otter_rides_the_waves_and_makes_way(at_sea: tuple[World, list[Sample]]) -> None:
    """With the surface up and down, leaning with its slope, and ahead all the same; the fixture looks at each tenth of a second."""
    ship = at_sea[0].vehicles["ship"]
    assert ship.p_NB[0] > 15.0
    assert abs(ship.p_NB[1]) < 5.0


def test_the_otter_carries_an_usbl(at_sea: tuple[World, list[Sample]]) -> None:
    """It hears the beacon on the vehicle below each second, and knows how far away it is."""
    world, fixes = at_sea
    assert len(fixes) > 25
    away = math.dist(world.vehicles["ship"].p_NB, world.vehicles["auv"].p_NB)
    assert fixes[-1].value[1] == pytest.approx(away, abs=2.0)


# -- Slocum ---------------------------------------------------------------------------------------------------------------------------------


class Glider:
    """A Slocum 100 m down, in still water."""

    def __init__(self, body: BodyParams, depth: float = 100.0) -> None:
        self.hydro = Hydrodynamics([body], 1.0 / RATE)
        self.hydro.state[0, 2] = depth
        self.names = [servo.name for servo in body.appendages.servos]

    def fly(self, seconds: float, **servos: float) -> FloatArray:
        """States (steps + 1, 13) with these set points from now on."""
        for name, value in servos.items():
            row = next(k for k, known in enumerate(self.names) if known.endswith(f".{name}"))
            self.hydro.servos["command"][row] = value
        return follow(self.hydro, seconds, lambda t: None)[:, 0]


def glide(states: FloatArray) -> tuple[float, float]:
    """Speed (m/s) and slope of the path (degrees, up) over the last 20 s."""
    way = (states[-1, :3] - states[-1 - 20 * RATE, :3]) / 20.0
    return float(np.linalg.norm(way)), -math.degrees(math.atan2(way[2], math.hypot(way[0], way[1])))


@pytest.mark.parametrize(("volume", "side"), [(500e-6, -1.0), (0.0, 1.0)])
def test_the_slocum_glides_as_the_flight_model_says(load_vehicle: LoadVehicle, volume: float, side: float) -> None:
    """Merckelbach et al. 2019: tan(path) = C_D / C_L, 0.25 g = rho S U^2 sqrt(C_D^2 + C_L^2) / 2: 0.3 to 0.4 m/s at 25 degrees."""
    states = Glider(load_vehicle("slocum")).fly(240.0, pump=volume)
    speed, slope = glide(states)
    assert 0.3 < speed < 0.4
    assert side * slope == pytest.approx(25.0, abs=2.0)
    alpha = abs(math.atan2(states[-1, NU + 2], states[-1, NU]))
    C_D, C_L = 0.15 + 10.5 * alpha**2, 7.5 * alpha
    assert math.degrees(math.atan2(C_D, C_L)) == pytest.approx(abs(slope), abs=0.8)
    assert 0.5 * 1025.0 * 0.1 * speed**2 * math.hypot(C_D, C_L) == pytest.approx(0.25625 * 9.80665, rel=0.03)


def test_the_slocum_saws_through_the_water(load_vehicle: LoadVehicle) -> None:
    """Down, up and down again: it goes ahead all the time and comes back to its depth."""
    glider = Glider(load_vehicle("slocum"))
    legs = [glider.fly(300.0, pump=volume) for volume in (500e-6, 0.0, 500e-6)]
    depths = [leg[-1, 2] for leg in legs]
    assert depths[0] > 135.0
    assert abs(depths[1] - 100.0) < 5.0
    assert depths[2] > 135.0
    assert all(leg[-1, 0] - leg[0, 0] > 75.0 for leg in legs)


def test_the_battery_steepens_the_glide(load_vehicle: LoadVehicle) -> None:
    flat, steep = (glide(Glider(load_vehicle("slocum")).fly(240.0, pump=500e-6, battery=way))[1] for way in (0.0, 0.01))
    assert steep < flat - 5.0


def test_the_slocum_turns_by_its_rudder(load_vehicle: LoadVehicle) -> None:
    """To starboard, on a circle of some metres, and it keeps gliding."""
    glider = Glider(load_vehicle("slocum"))
    glider.fly(120.0, pump=500e-6)
    states = glider.fly(120.0, rudder=math.radians(26.0))
    rate = states[-1, NU + 5]
    assert rate > 0.0
    assert 3.0 < np.linalg.norm(states[-1, NU : NU + 3]) / rate < 12.0
    assert states[-1, 2] > states[0, 2] + 10.0


def test_the_slocum_floats_with_its_pump_empty(load_vehicle: LoadVehicle) -> None:
    states = Glider(load_vehicle("slocum"), depth=8.0).fly(240.0, pump=0.0)
    assert abs(states[-1, 2]) < 0.12
    assert np.abs(states[-1, NU + 3 :]).max() < 0.01
