"""The ROVs as a pilot knows them, sticks open loop: they go where they are pushed, stay upright, and come to rest when the sticks are let go.

Bars: thrust ramped up in 2 s leans a BlueROV2 by at most 15 degrees, a step by 25 and after 3 s by 8; its course holds within 20 degrees in 20 s,
also from 2 degrees of drift and 2 degrees/s; it reaches 1.0 to 1.6 m/s (maker: 1.5). RexROV holds its course within 10 degrees in 40 s. The files
of the published identifications do not: they show that the measures can fail.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from attitudes import rpy_deg, upright
from uwserver_bench.proofs.closed_forms import table_a1

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q

BLUEROVS = ("bluerov2", "bluerov2_heavy")
IDENTIFIED = ("bluerov2_wu", "bluerov2_heavy_von_benzon")
RATE = 120
DEEP = 500.0
THROTTLES = tuple(0.1 * k * way for k in range(1, 11) for way in (1, -1))

LoadVehicle = Callable[..., BodyParams]


@dataclass(frozen=True)
class Track:
    """Runs side by side: attitude (steps, n, 3) as roll, pitch and unwrapped yaw in degrees, velocity (steps, n, 6), uprightness (steps, n)."""

    rpy: FloatArray
    nu: FloatArray
    upright: FloatArray

    def since(self, seconds: float, rate: int = RATE) -> Track:
        k = round(seconds * rate)
        return Track(self.rpy[k:], self.nu[k:], self.upright[k:])


def mixed(body: BodyParams, surge: float = 0.0, sway: float = 0.0, heave: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """Commands of the thrusters for sticks of -1..1, as an autopilot's manual mode adds them up: ahead, right, down, turn right."""
    commands = []
    for thruster in body.thrusters:
        x, y, z = thruster.axis
        turn = thruster.r[0] * y - thruster.r[1] * x
        sticks = (surge, x), (sway, y), (heave, z), (yaw, turn)
        commands.append(sum(stick * np.sign(round(along, 6)) for stick, along in sticks))
    return np.clip(np.array(commands), -1.0, 1.0)


def drive(
    body: BodyParams, sticks: Sequence[dict[str, float]], seconds: float, *, ramp: float = 0.0, release: float = math.inf,
    start: FloatArray | None = None, depth: float = DEEP, current: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Track:  # fmt: skip
    """One run for each set of sticks, ramped up over `ramp` seconds and let go at `release`; `start` (n, 6) is the velocity at first."""
    hydro = Hydrodynamics([body] * len(sticks), 1.0 / RATE)
    hydro.state[:, 2], hydro.currents[:] = depth, current
    if start is not None:
        hydro.state[:, NU:] = start
    full = np.concatenate([mixed(body, **stick) for stick in sticks])

    def command(t: float) -> None:
        share = 0.0 if t >= release else min(1.0, t / ramp) if ramp > 0.0 else 1.0
        hydro.thrusters["command"], hydro.thrusters["fresh"] = share * full, 1

    return follow(hydro, seconds, command)


def follow(hydro: Hydrodynamics, seconds: float, command: Callable[[float], None], rate: int = RATE) -> Track:
    states = [hydro.state.copy()]
    for k in range(round(seconds * rate)):
        command(k / rate)
        assert hydro.advance(k / rate) < 0
        states.append(hydro.state.copy())
    trail = np.array(states)
    return Track(rpy_deg(trail), trail[:, :, NU:], upright(trail))


def ahead(throttles: Sequence[float] = THROTTLES) -> list[dict[str, float]]:
    return [{"surge": throttle} for throttle in throttles]


@pytest.mark.parametrize("name", BLUEROVS)
def test_thrust_ramped_up_leans_a_bluerov_a_little(load_vehicle: LoadVehicle, name: str) -> None:
    track = drive(load_vehicle(name), ahead(), 20.0, ramp=2.0)
    assert np.abs(track.rpy[:, :, 1]).max() <= 15.0
    assert np.abs(track.rpy[:, :, 0]).max() <= 5.0


@pytest.mark.parametrize("name", BLUEROVS)
def test_a_step_of_thrust_makes_a_bluerov_nod_and_no_more(load_vehicle: LoadVehicle, name: str) -> None:
    track = drive(load_vehicle(name), ahead(), 20.0)
    assert np.abs(track.rpy[:, :, 1]).max() <= 25.0
    assert np.abs(track.since(3.0).rpy[:, :, 1]).max() <= 8.0
    assert track.upright.min() > 0.9


@pytest.mark.parametrize("name", IDENTIFIED)
def test_the_identifications_as_published_do_not_meet_these_bars(load_vehicle: LoadVehicle, name: str) -> None:
    """Righting arms of 1 and 2 cm, drag without a moment, the whole Munk moment."""
    stepped = drive(load_vehicle(name), ahead((0.5, 1.0)), 20.0)
    assert np.abs(stepped.rpy[:, 0, 1]).max() > 45.0
    assert stepped.upright[:, 1].min() < -0.9


def test_the_identified_heavy_is_that_of_the_closed_forms(load_vehicle: LoadVehicle) -> None:
    """Terminal velocities and natural frequencies are proven with Table A1; its file has the same numbers, but for damping at rest."""
    body, table = load_vehicle("bluerov2_heavy_von_benzon", density_kgpm3=1000.0, gravity_mps2=9.82), table_a1()
    for name in ("M_RB", "M_A", "D_Q", "D_S", "buoyancy", "r_g", "r_b"):
        np.testing.assert_allclose(getattr(body, name), getattr(table, name), rtol=1e-9, err_msg=name)
    np.testing.assert_allclose(body.D_L, table.D_L + np.diag([0.0, 1.0, 0.0, 0.1, 0.0, 0.1]))
    assert not body.appendages.derivatives


@pytest.mark.parametrize("name", BLUEROVS)
def test_a_bluerov_holds_its_course(load_vehicle: LoadVehicle, name: str) -> None:
    """From rest, and from its speed with 2 degrees of drift and 2 degrees/s, to either side."""
    body = load_vehicle(name)
    from_rest = drive(body, ahead(), 20.0)
    assert np.abs(from_rest.rpy[:, :, 2]).max() <= 20.0
    speed = from_rest.nu[-1, :, 0]
    for drift in (math.radians(2.0), math.radians(-2.0)):
        start = np.zeros((len(speed), 6))
        start[:, 0], start[:, 1], start[:, 5] = (
            speed * math.cos(drift),
            np.abs(speed) * math.sin(drift),
            math.radians(2.0),
        )
        assert np.abs(drive(body, ahead(), 20.0, start=start).rpy[:, :, 2]).max() <= 20.0


def test_full_throttle_gives_the_makers_speed_and_less_with_the_pods_of_the_heavy(load_vehicle: LoadVehicle) -> None:
    """Blue Robotics: 1.5 m/s (BlueROV2, technical details)."""
    standard, heavy = (drive(load_vehicle(name), ahead((1.0, -1.0)), 20.0).nu[-1, :, 0] for name in BLUEROVS)
    assert standard == pytest.approx([1.5, -1.5], rel=0.1)
    assert 1.0 < heavy[0] < standard[0] < 1.6
    assert heavy[0] > 0.8 * standard[0]


def test_the_two_files_of_one_hull_are_consistent(load_vehicle: LoadVehicle) -> None:
    """The Heavy is the same hull with four thrusters more: no less drag along any axis, and no more than their frontal areas explain."""
    standard, heavy = (load_vehicle(name) for name in BLUEROVS)
    ratio = np.diag(heavy.D_Q)[:3] / np.diag(standard.D_Q)[:3]
    assert np.all((ratio >= 1.0) & (ratio <= 1.7))
    np.testing.assert_allclose(heavy.D_S, standard.D_S)
    np.testing.assert_allclose(np.subtract(heavy.r_b, heavy.r_g), np.subtract(standard.r_b, standard.r_g))


@pytest.mark.parametrize(("name", "identified"), list(zip(BLUEROVS, IDENTIFIED, strict=True)))
def test_a_bluerov_spins_as_both_identifications_say(load_vehicle: LoadVehicle, name: str, identified: str) -> None:
    """Yaw drag 1.55 (Wu 2018) and 1.5 (von Benzon et al. 2022): 3.7 rad/s at full stick with the
    identified thruster, which loses less in the inflow than the T200 of open water."""
    track = drive(load_vehicle(name), [{"yaw": 1.0}], 10.0)
    level = replace(load_vehicle(identified), r_g=(0.0, 0.0, 0.2))  # which a pilot would have to hold upright
    assert track.nu[-1, 0, 5] == pytest.approx(drive(level, [{"yaw": 1.0}], 10.0).nu[-1, 0, 5], rel=0.12)
    assert np.abs(track.rpy[:, 0, :2]).max() <= 10.0


@pytest.mark.parametrize("name", BLUEROVS)
def test_a_bluerov_goes_sideways_and_up_and_down(load_vehicle: LoadVehicle, name: str) -> None:
    """No published figure was found; ahead is its fastest way, and no other is slower than half of that."""
    sticks = [{"sway": 1.0}, {"heave": 1.0}, {"heave": -1.0}, {"surge": 1.0}]
    track = drive(load_vehicle(name), sticks, 20.0)
    right, down, up, along = (track.nu[-1, k, axis] for k, axis in enumerate((1, 2, 2, 0)))
    for speed in (right, down, -up):
        assert 0.5 * along < speed < 0.9 * along
    assert np.abs(track.rpy[:, 1:3, :2]).max() <= 1.0
    assert np.abs(track.rpy[:, 0, :2]).max() <= 25.0
    assert np.abs(track.since(3.0).rpy[:, 0, :2]).max() <= 8.0


COMBINED: list[dict[str, float]] = [
    {"surge": 1.0, "heave": 1.0},
    {"surge": 1.0, "heave": -1.0},
    {"surge": -1.0, "heave": 1.0},
    {"surge": -1.0, "heave": -1.0},
    {"surge": 1.0, "yaw": 0.3},
    {"surge": 0.5, "yaw": 1.0},
    {"surge": 1.0, "sway": 1.0},
    {"sway": 1.0, "heave": 1.0},
    {"sway": -1.0, "heave": -1.0},
    {"heave": 1.0, "yaw": -1.0},
    {"surge": 0.7, "sway": 0.7, "heave": 1.0, "yaw": 0.5},
]


@pytest.mark.parametrize("name", BLUEROVS)
@pytest.mark.parametrize("share", [0.3, 0.6, 1.0])
def test_combined_sticks_lean_a_bluerov_and_let_go_it_rests_upright(
    load_vehicle: LoadVehicle, name: str, share: float
) -> None:
    """Let go after 10 s it is level within 3 degrees and below 0.15 m/s in 3 s, and creeps then with its buoyancy alone."""
    sticks = [{axis: share * value for axis, value in stick.items()} for stick in COMBINED]
    track = drive(load_vehicle(name), sticks, 16.0, release=10.0)
    assert np.abs(track.rpy[:, :, :2]).max() <= 30.0
    rest = track.since(13.0)
    assert np.abs(rest.rpy[:, :, :2]).max() <= 3.0
    assert np.linalg.norm(rest.nu[:, :, :2], axis=2).max() < 0.15
    assert np.abs(rest.nu[-1, :, 5]).max() < math.radians(3.0)


@pytest.mark.parametrize("name", BLUEROVS)
@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilted_bluerov_rocks_back_in_a_few_swings(load_vehicle: LoadVehicle, name: str, axis: int) -> None:
    """With 5 cm between its centres it swings in about 1.5 s; from 20 degrees it overshoots, and after three swings it is level."""
    hydro = Hydrodynamics([load_vehicle(name)], 1.0 / RATE)
    half = math.radians(10.0)
    hydro.state[0, 2], hydro.state[0, Q], hydro.state[0, Q + 1 + axis] = DEEP, math.cos(half), math.sin(half)
    angle = follow(hydro, 8.0, lambda t: None).rpy[:, 0, axis]
    crossings = np.flatnonzero(np.diff(np.sign(angle[: round(4.5 * RATE)])) != 0) / RATE
    assert 1.3 <= 2.0 * np.diff(crossings[:3]).mean() <= 1.9
    assert angle.min() < -2.0
    assert np.abs(angle[round(5.0 * RATE) :]).max() < 1.5


@pytest.mark.parametrize("name", BLUEROVS)
@pytest.mark.parametrize("current", [(0.0, 0.5, 0.0), (0.5, 0.0, 0.0), (-0.5, 0.0, 0.0)])
def test_a_current_carries_a_bluerov_and_turns_it_little(
    load_vehicle: LoadVehicle, name: str, current: tuple[float, float, float]
) -> None:
    """Half a metre a second comes up at once, the sticks too."""
    track = drive(load_vehicle(name), [{}, {"surge": 0.3}, {"surge": 1.0}], 20.0, current=current)
    assert np.abs(track.rpy[:, :, :2]).max() <= 25.0
    assert np.abs(track.rpy[:, :, 2]).max() <= 20.0


@pytest.mark.parametrize("name", BLUEROVS)
def test_at_the_surface_a_bluerov_floats_upright_and_can_leave_it(load_vehicle: LoadVehicle, name: str) -> None:
    sticks = [{}, {"surge": 1.0}, {"surge": -1.0}, {"sway": 1.0}, {"heave": -1.0}, {"heave": 1.0}]
    track = drive(load_vehicle(name), sticks, 15.0, depth=0.3)
    assert np.abs(track.rpy[:, :, :2]).max() <= 25.0
    assert np.abs(track.nu[-1, 0]).max() < 0.05
    assert track.nu[-1, 1, 0] > 1.0
    assert track.nu[-1, 5, 2] > 0.7


@pytest.mark.parametrize("name", [*BLUEROVS, *IDENTIFIED, "rexrov"])
def test_damping_takes_energy_out_at_every_velocity(load_vehicle: LoadVehicle, name: str) -> None:
    """Also with the couplings of drag below the centre of gravity, over six decades of velocity."""
    body = load_vehicle(name)
    rng = np.random.default_rng(2)
    nu = rng.normal(size=(50_000, 6)) * 10.0 ** rng.uniform(-3.0, 0.5, (50_000, 6))
    for D, flow in ((body.D_L, nu), (body.D_Q, np.abs(nu) * nu), (body.D_S, np.abs(nu[:, :1]) * nu)):
        assert np.einsum("ni,ij,nj->n", nu, D, flow).min() >= 0.0


@pytest.mark.parametrize("name", [*BLUEROVS, "rexrov"])
def test_hull_derivatives_do_no_work(load_vehicle: LoadVehicle, name: str) -> None:
    """They come in whole pairs: their powers cancel at every velocity, ahead, astern and sideways."""
    hydro = Hydrodynamics([load_vehicle(name)], 0.01)
    terms = hydro.derivatives
    assert len(terms) >= 9
    nu = np.random.default_rng(4).normal(size=(1000, 6))
    powers = terms["coefficient"] * nu[:, terms["axis"]] * nu[:, terms["j"]] * nu[:, terms["k"]]
    assert np.abs(powers.sum(axis=1)).max() <= 1e-9 * np.abs(powers).max()


def pushed(body: BodyParams, wrenches: list[list[float]], seconds: float, start: FloatArray | None = None) -> Track:
    rate = 60
    hydro = Hydrodynamics([body] * len(wrenches), 1.0 / rate)
    hydro.state[:, 2], hydro.wrenches["bias"] = DEEP, np.array(wrenches)
    if start is not None:
        hydro.state[:, NU:] = start
    return follow(hydro, seconds, lambda t: None, rate)


def test_rexrov_holds_its_course(load_vehicle: LoadVehicle) -> None:
    """10 degrees in 40 s, from a tenth to the whole of its autopilot's largest force; with heave too, and from 2 degrees of drift and 2 degrees/s."""
    body = load_vehicle("rexrov")
    surges = (250.0, 1000.0, 2500.0, -250.0, -2500.0)
    for heave in (0.0, 1500.0, -1500.0):
        from_rest = pushed(body, [[surge, 0.0, heave, 0.0, 0.0, 0.0] for surge in surges], 40.0)
        assert np.abs(from_rest.rpy).max() <= 10.0
    wrenches = [[surge, 0.0, 0.0, 0.0, 0.0, 0.0] for surge in surges]
    start = np.zeros((len(surges), 6))
    start[:, 0] = pushed(body, wrenches, 40.0).nu[-1, :, 0]
    start[:, 1], start[:, 5] = np.abs(start[:, 0]) * math.sin(math.radians(2.0)), math.radians(2.0)
    assert np.abs(pushed(body, wrenches, 40.0, start).rpy).max() <= 10.0


def test_rexrov_without_its_hull_terms_leaves_its_course(load_vehicle: LoadVehicle) -> None:
    body = load_vehicle("rexrov")
    bare = replace(body, D_S=np.zeros((6, 6)), appendages=replace(body.appendages, derivatives=()))
    assert np.abs(pushed(bare, [[1000.0, 0.0, 0.0, 0.0, 0.0, 0.0]], 40.0).rpy[:, 0, 2]).max() > 360.0
