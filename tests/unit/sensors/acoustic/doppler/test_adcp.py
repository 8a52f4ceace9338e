"""The current profiler against closed forms: uniform and sheared water, motion, tilt, ambiguity, side lobes, blanking, noise, bottom track.

Also of uwserver.sensors.acoustic.doppler.cell_echoes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwserver.environment.currents import ProfileConfig, profile_rows
from uwserver.environment.water import Sea, Water
from uwserver.frames import quat_from_rpy
from uwserver.physics.kernel.layout import (
    PROFILE_SIZE,
    WAVE_AMPLITUDE,
    WAVE_DEPTH,
    WAVE_K,
    WAVE_KX,
    WAVE_KY,
    WAVE_OMEGA,
    WAVE_PHASE,
    WAVE_SIZE,
    SeaRows,
)  # fmt: skip
from uwserver.scenario.vehicle.devices import check_profile
from uwserver.sensors import Pose
from uwserver.sensors.acoustic.doppler.adcp import AdcpConfig
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane
from uwserver.testing.sensors import measured, scopes

SHIPPED = Path(__file__).parents[5] / "scenarios" / "uwserver_scenarios" / "devices"
DEEP = 200.0  # far from the surface
CURRENT = (0.4, -0.3, 0.05)
QUIET = AdcpConfig(rate_hz=2, cells=20, beam_sigma_mps=0.0, bottom_sigma_mps=0.0, bottom_range_sigma_m=0.0)
"""With its physics, without its noise."""
THETA = math.radians(20.0)


def flowing(velocity, *depths):
    """Water whose velocity is linear between these depths (m), where it is as the function says; by default linear down to 300 m."""
    depths = depths or (0.0, DEEP + 100.0)
    rows = profile_rows(ProfileConfig(depth_m=depths, velocity_ned_mps=tuple(velocity(z) for z in depths)))
    sea = Sea(SeaRows(np.zeros(7), rows, np.zeros((0, WAVE_SIZE))))
    return Water(1025.0, 9.81, 12.0, 101_325.0, (0.0, 0.0, 0.0), sea)


STILL = Water(1025.0, 9.81, 12.0, 101_325.0, (0.0, 0.0, 0.0))


@pytest.fixture
def deep(scope):
    """`deep(bottom=30, **state)`: in 200 m of depth, over a flat bottom so far below, or over none."""

    def build(bottom=None, **state):
        made = scope(**{"p_NB": (0.0, 0.0, DEEP), "water": STILL, **state})
        if bottom is not None:
            made.geometry = FakeGeometry([Plane((0.0, 0.0, DEEP + bottom), (0.0, 0.0, -1.0))])
        return made

    return build


def change(config=QUIET, **keys):
    return msgspec.structs.replace(config, **keys)


def profile(config, instant, mount=None, **settings):
    """Values of one ensemble by the names of their fields, as arrays; nan for None."""
    sensor = config.build(mount or Pose())
    if settings:
        sensor.change(settings)
    return fields_of(sensor, measured(sensor, instant))


def fields_of(sensor, reading):
    found = {"valid": reading[0]}
    for field, value in zip(sensor.fields, reading[1], strict=True):
        array = np.array([math.nan if v is None else v for v in (value if isinstance(value, tuple) else (value,))])
        found[field.name] = array.reshape(field.shape) if field.shape else float(array[0])
    return found


def test_contract():
    for keys in ({}, {"ideal": True}, {"axial_beam": True, "pings": 4}, {"beam_azimuth_deg": (0.0, 120.0, 240.0)}):
        check_sensor(
            AdcpConfig(rate_hz=2, cells=5, scale_sigma=0.01, heading_sigma_deg=1, **keys), instants=scopes()[::4]
        )


# -- velocities -------------------------------------------------------------------------------------------------------------------------


def test_uniform_water(deep):
    seen = profile(QUIET, deep(water=replace(STILL, current=CURRENT)))
    assert seen["valid"]
    assert seen["distances"] == pytest.approx(0.5 + np.arange(1, 21))
    assert seen["velocities_S"] == pytest.approx(np.tile(CURRENT, (20, 1)), abs=1e-12)
    assert seen["error_velocities"] == pytest.approx(np.zeros(20), abs=1e-12)
    assert np.isnan(seen["velocities_N"]).all()  # for there is no bottom to tell the ground by
    first = (math.sin(THETA) * math.cos(math.pi / 4), math.sin(THETA) * math.sin(math.pi / 4), math.cos(THETA))
    assert seen["beam_velocities"][:, 0] == pytest.approx(np.full(20, np.dot(first, CURRENT)), abs=1e-12)


def test_sheared_water_is_told_at_the_middle_of_each_cell(deep):
    water = flowing(lambda z: (0.01 * (z - DEEP), -0.02 * (z - DEEP), 0.0))
    seen = profile(QUIET, deep(water=water))
    z = seen["distances"]
    assert seen["velocities_S"] == pytest.approx(np.stack([0.01 * z, -0.02 * z, 0.0 * z], axis=1), abs=1e-12)


def test_a_cell_is_the_triangular_mean_over_two_cells(deep):
    """For u = z^2 the mean of a triangle of half width h is z^2 + h^2 / 6."""
    # It is asked for the water at each of these depths.
    depths = DEEP + 1.5 + np.arange(21.0)
    water = flowing(lambda z: (0.001 * (z - DEEP) ** 2, 0.0, 0.0), *depths.tolist())
    seen = profile(change(cell_size_m=2.0, cells=10), deep(water=water))
    assert seen["velocities_S"][:, 0] == pytest.approx(0.001 * (seen["distances"] ** 2 + 4.0 / 6.0), abs=1e-12)


def test_waves_are_told_where_each_beam_meets_them(deep):
    """Of a tilted device, and at its time: three points of equal weight along each beam, also beyond the range."""
    waves = np.zeros((1, WAVE_SIZE))
    waves[0, [WAVE_K, WAVE_KX, WAVE_KY, WAVE_OMEGA]] = 0.1, 0.06, 0.08, 1.0
    waves[0, [WAVE_AMPLITUDE, WAVE_PHASE, WAVE_DEPTH]] = 1.5, 0.3, math.inf
    sea = Sea(SeaRows(np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros((0, PROFILE_SIZE)), waves))
    rpy, p = (0.1, -0.2, 0.7), np.array((3.0, -2.0, 15.0))
    instant = deep(p_NB=tuple(p), q_NB=quat_from_rpy(*rpy), t_ns=3_000_000_000, water=replace(STILL, sea=sea))
    seen = profile(change(ideal=True, cells=6, max_range_m=3.0), instant)
    azimuths = np.radians((45.0, 135.0, 225.0, 315.0))
    beams_S = np.stack(
        [np.cos(azimuths) * math.sin(THETA), np.sin(azimuths) * math.sin(THETA), [math.cos(THETA)] * 4], 1
    )
    for i, beam in enumerate(Rotation.from_euler("ZYX", rpy[::-1]).apply(beams_S)):
        ranges = (seen["distances"][:, None] + (-0.5, 0.0, 0.5)) / math.cos(THETA)
        along = [[np.dot(beam, sea.velocity(tuple(p + r * beam), 3.0)) for r in cell] for cell in ranges]
        assert seen["beam_velocities"][:, i] == pytest.approx(np.mean(along, axis=1), abs=1e-12)
    assert np.ptp(seen["beam_velocities"]) > 0.1


def test_a_moving_vehicle_sees_the_water_go_by_and_knows_the_ground(deep):
    v, w, rpy = np.array((1.2, -0.4, 0.2)), np.array((0.02, -0.03, 0.1)), (0.05, -0.1, 0.7)
    mount = Pose((0.5, 0.2, 0.3), quat_from_rpy(0.02, 0.03, 0.4))
    instant = deep(
        40.0,
        water=replace(STILL, current=CURRENT),
        q_NB=quat_from_rpy(*rpy),
        v_NB_B=tuple(v),
        w_NB_B=tuple(w),
    )
    seen = profile(QUIET, instant, mount)
    NB = Rotation.from_euler("ZYX", rpy[::-1])
    BS = Rotation.from_quat([*mount.q[1:], mount.q[0]])
    v_S = BS.inv().apply(v + np.cross(w, mount.p))
    assert seen["velocities_S"] == pytest.approx(np.tile((NB * BS).inv().apply(CURRENT) - v_S, (20, 1)), abs=1e-12)
    assert seen["v_S"] == pytest.approx(v_S, abs=1e-12)
    assert seen["velocities_N"] == pytest.approx(np.tile(CURRENT, (20, 1)), abs=1e-12)


def test_a_device_that_looks_up(deep):
    water = flowing(lambda z: (0.01 * (DEEP - z), 0.0, 0.0))
    seen = profile(QUIET, deep(water=water, q_NB=quat_from_rpy(math.pi, 0.0, 0.0)))
    assert seen["velocities_S"][:, 0] == pytest.approx(0.01 * seen["distances"], abs=1e-12)


def test_one_beam_less_gives_the_same_vectors_without_an_error_velocity(deep):
    instant = deep(water=replace(STILL, current=CURRENT))
    instant.geometry = FakeGeometry([Plane((2.0, 2.0, DEEP), (-math.sqrt(0.5), -math.sqrt(0.5), 0.0))])
    seen = profile(change(side_lobe_db=-300.0), instant)
    blocked = np.isnan(seen["beam_velocities"][:, 0])
    assert blocked.any()
    assert not blocked.all()
    assert not np.isnan(seen["beam_velocities"][:, 1:]).any()
    assert seen["velocities_S"] == pytest.approx(np.tile(CURRENT, (20, 1)), abs=1e-9)
    assert (np.isnan(seen["error_velocities"]) == blocked).all()


def test_two_beams_give_no_vector(deep):
    """A wall ends the other two, 3.9 m along the axis, which is too near for a bottom."""
    instant = deep(water=replace(STILL, current=CURRENT))
    wall, bottom = Plane((1.0, 0.0, DEEP), (-1.0, 0.0, 0.0)), Plane((0.0, 0.0, DEEP + 20.0), (0.0, 0.0, -1.0))
    instant.geometry = FakeGeometry([wall, bottom])
    seen = profile(change(side_lobe_db=-300.0, bottom_min_altitude_m=10.0), instant)
    there = np.isfinite(seen["beam_velocities"])
    assert there[:2].all()
    assert (there[2:18] == [False, True, True, False]).all()
    assert (np.isfinite(seen["velocities_S"]) == there.all(axis=1)[:, None]).all()
    assert (np.isfinite(seen["beam_ranges"]) == [False, True, True, False]).all()
    assert math.isnan(seen["altitude"])
    assert np.isnan(seen["v_S"]).all()


def test_the_axial_beam_tells_the_vertical(deep):
    seen = profile(change(axial_beam=True), deep(water=replace(STILL, current=CURRENT)))
    assert seen["beam_velocities"].shape == (20, 5)
    assert seen["beam_velocities"][:, 4] == pytest.approx(np.full(20, 0.05), abs=1e-12)


# -- tilt -------------------------------------------------------------------------------------------------------------------------------

PITCH, SHEAR = math.radians(8.0), 0.02
ACROSS = (0.0, 90.0, 180.0, 270.0)


@pytest.fixture
def pitched(deep):
    return deep(water=flowing(lambda z: (SHEAR * (z - DEEP), 0.0, 0.0)), q_NB=quat_from_rpy(0.0, PITCH, 0.0))


def test_without_mapping_tilt_mixes_depths(pitched):
    """Closed form of the two beams in the plane of the tilt: beam 0 points to theta + pitch from the vertical backwards, beam 2 forwards."""
    seen = profile(change(beam_azimuth_deg=ACROSS, bin_mapping="off"), pitched)
    r = seen["distances"] / math.cos(THETA)
    # In N, nose up: a beam at the angle a forward of the vertical is (sin a, cos a).
    fore, aft = THETA + PITCH, PITCH - THETA
    b = [SHEAR * r * math.cos(a) * math.sin(a) for a in (fore, aft)]
    x_S = (b[0] - b[1]) / (2.0 * math.sin(THETA))
    assert seen["velocities_S"][:, 0] == pytest.approx(x_S, abs=1e-12)
    assert np.abs(seen["velocities_S"][:, 0] / (SHEAR * seen["distances"] * math.cos(PITCH)) - 1.0).max() > 0.02


def test_mapping_sorts_the_cells_by_depth(pitched):
    """Linear interpolation of linear shear is exact at each level that all four beams reach."""
    config = change(beam_azimuth_deg=ACROSS, cells=30, max_range_m=80.0)
    seen = profile(config, pitched)
    u = SHEAR * seen["distances"]
    expected = np.stack([u * math.cos(PITCH), 0.0 * u, u * math.sin(PITCH)], axis=1)
    there = np.isfinite(seen["error_velocities"])
    assert there.sum() >= 20
    assert seen["velocities_S"][there] == pytest.approx(expected[there], abs=1e-12)


def test_the_nearest_cell_is_half_a_cell_off_at_most(pitched):
    config = change(beam_azimuth_deg=ACROSS, bin_mapping="nearest", max_range_m=80.0)
    seen = profile(config, pitched)
    there = np.isfinite(seen["error_velocities"])
    off = seen["velocities_S"][there, 0] - SHEAR * seen["distances"][there] * math.cos(PITCH)
    assert 1e-4 < np.abs(off).max() <= 0.5 * SHEAR * 2.0


def test_own_compass_turns_the_velocities_over_ground(deep):
    config = change(heading_sigma_deg=2.0, tilt_sigma_deg=0.0)
    sensor = config.build(Pose())
    seen = fields_of(sensor, measured(sensor, deep(30.0, water=replace(STILL, current=CURRENT))))
    turned = Rotation.from_euler("z", sensor.memory.tilt[2]).apply(CURRENT)
    assert abs(sensor.memory.tilt[2]) > 1e-3
    assert seen["velocities_N"][:10] == pytest.approx(np.tile(turned, (10, 1)), abs=1e-9)
    draws = []
    for key in range(400):
        sensor.start(key)
        draws.append(math.degrees(sensor.memory.tilt[2]))
    assert np.std(draws) == pytest.approx(2.0, rel=0.1)


# -- ambiguity, range, cells ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.0, 0.9, -0.9, 1.1, -1.1, 2.5])
def test_a_velocity_beyond_the_ambiguity_comes_back_on_the_other_side(deep, speed):
    config = change(axial_beam=True, ambiguity_velocity_mps=1.0)
    seen = profile(config, deep(water=replace(STILL, current=(0.0, 0.0, speed))))
    along = speed if abs(speed) < 1.0 else speed - 2.0 * round(speed / 2.0)
    assert seen["beam_velocities"][:, 4] == pytest.approx(np.full(20, along), abs=1e-12)


def test_nothing_is_heard_in_the_blanking_distance(deep):
    """Water that rushes by in the first two metres is not in any cell when these are blanked, and in the first ones when not."""
    water = flowing(lambda z: (1.0 if z < DEEP + 2.1 else 0.0, 0.0, 0.0), 0.0, DEEP + 2.1 - 1e-6, DEEP + 2.1)
    assert profile(change(blanking_m=2.0), deep(water=water))["velocities_S"][:, 0] == pytest.approx(np.zeros(20))
    seen = profile(change(blanking_m=2.0), deep(water=water), blanking=0.0)
    assert seen["distances"][0] == 1.0
    assert seen["velocities_S"][:4, 0] == pytest.approx([1.0, 2.0 / 3.0, 0.0, 0.0], abs=1e-12)


def reach_of(config, instant, cell):
    """Where the last cell lies that has a velocity."""
    seen = profile(change(config, beam_sigma_mps=0.0, cells=256), instant, cell_size=cell)
    return seen["distances"][np.isfinite(seen["velocities_S"][:, 0])].max()


PUBLISHED = [
    ("workhorse300", {1.0: 83.0, 2.0: 93.0, 4.0: 103.0, 8.0: 116.0}),
    ("workhorse600", {0.5: 38.0, 1.0: 42.0, 2.0: 46.0, 4.0: 51.0}),
]


@pytest.mark.parametrize(("name", "ranges"), PUBLISHED)
def test_range_grows_with_the_cell_as_published(deep, name, ranges):
    """Spreading, absorption and the energy of the pulse give the other rows of the maker's table from the one that the profile holds."""
    config = device(name)
    instant = deep()
    for cell, published in ranges.items():
        assert reach_of(config, instant, cell) == pytest.approx(published, rel=0.085)


def device(name):
    """The configuration of a shipped device."""
    keys = check_profile(msgspec.toml.decode((SHIPPED / f"{name}.toml").read_bytes()), lambda *_: None)
    return msgspec.convert({"rate_hz": 1, **keys}, AdcpConfig)


def test_echo_and_correlation_fall_with_range(deep):
    instant = deep()
    seen = profile(change(cells=40), instant)
    r = seen["distances"] / math.cos(THETA)
    alpha = instant.water.absorption(6e5, DEEP)
    far = 40.0 / math.cos(THETA)
    expected = 20.0 * np.log10(far / r) + 2.0 * alpha * (far - r)
    assert seen["echoes"][:, 0] == pytest.approx(expected, abs=1e-6)
    strength = 10.0 ** (0.1 * expected)
    assert seen["correlations"][:, 0] == pytest.approx(0.5 * strength / (1.0 + strength), abs=1e-9)
    lost = seen["distances"] > 40.0
    assert (np.isnan(seen["beam_velocities"][:, 0]) == lost).all()
    assert lost.any()


# -- boundaries -------------------------------------------------------------------------------------------------------------------------


def test_side_lobes_spoil_the_last_part_above_the_bottom(deep):
    """Clean to h cos theta (94 % with beams at 20 degrees); there the bottom, at rest, pulls the velocity along a beam to that of the bottom."""
    height, ratio = 18.0, 10.0 ** (0.1 * 10.0)
    config = change(cell_size_m=0.2, cells=95, side_lobe_db=10.0, bottom_max_altitude_m=50.0)
    seen = profile(config, deep(height, v_NB_B=(1.0, 0.0, 0.0)))
    z, u = seen["distances"], seen["velocities_S"][:, 0]
    clean = z + 0.1 < height * math.cos(THETA)
    spoilt = (z - 0.1 > height * math.cos(THETA)) & (z + 0.1 < height)
    assert clean.sum() > 70
    assert spoilt.sum() > 3
    assert u[clean] == pytest.approx(np.full(clean.sum(), -1.0), abs=1e-9)
    # The nearest bottom lies straight below and does not come nearer: zero, with ten times the echo of the water.
    assert u[spoilt] == pytest.approx(np.full(spoilt.sum(), -1.0 / (1.0 + ratio)), abs=1e-9)
    assert np.isnan(u[z > height]).all()
    last, next_ = np.flatnonzero(clean)[-1], np.flatnonzero(spoilt)[0]
    assert seen["echoes"][next_, 0] - seen["echoes"][last, 0] == pytest.approx(10.0 * math.log10(1.0 + ratio), abs=0.5)
    ideal = profile(change(config, ideal=True), deep(height, v_NB_B=(1.0, 0.0, 0.0)))["velocities_S"][:, 0]
    assert ideal[spoilt] == pytest.approx(np.full(spoilt.sum(), -1.0), abs=1e-12)


def test_a_bottom_that_comes_nearer_shows_its_own_speed(deep):
    """The device sinks: straight below the bottom comes at the whole speed, along a beam the water only at its part."""
    config = change(cell_size_m=0.2, cells=95, side_lobe_db=10.0)
    seen = profile(config, deep(18.0, v_NB_B=(0.0, 0.0, 0.3)))
    z, beam = seen["distances"], seen["beam_velocities"][:, 0]
    spoilt = (z - 0.1 > 18.0 * math.cos(THETA)) & (z + 0.1 < 18.0)
    expected = -0.3 * (math.cos(THETA) + 10.0) / 11.0
    assert beam[spoilt] == pytest.approx(np.full(spoilt.sum(), expected), abs=1e-9)


def test_tilt_brings_the_side_lobe_nearer_than_the_beams_tell(deep):
    """The shortest way to the bottom is the vertical, whatever the tilt: cells of every beam are spoilt from range h on."""
    config = change(cell_size_m=0.2, cells=90, beam_azimuth_deg=ACROSS, bin_mapping="off")
    seen = profile(config, deep(15.0, v_NB_B=(1.0, 0.0, 0.0), q_NB=quat_from_rpy(0.0, PITCH, 0.0)))
    r = seen["distances"] / math.cos(THETA)
    raw = seen["beam_velocities"][:, 0]
    along = -math.sin(THETA)
    assert raw[r + 0.11 < 15.0] == pytest.approx(np.full((r + 0.11 < 15.0).sum(), along), abs=1e-9)
    spoilt = (r - 0.11 > 15.0) & (r + 0.11 < 15.0 / math.cos(THETA + PITCH))
    assert spoilt.any()
    assert np.abs(raw[spoilt] - along).min() > 0.1


def test_the_surface_spoils_the_last_cells_of_a_device_that_looks_up(deep):
    instant = deep(p_NB=(0.0, 0.0, 18.0), v_NB_B=(1.0, 0.0, 0.0), q_NB=quat_from_rpy(math.pi, 0.0, 0.0))
    seen = profile(change(cell_size_m=0.2, cells=95), instant)
    z, u = seen["distances"], seen["velocities_S"][:, 0]
    clean = z + 0.1 < 18.0 * math.cos(THETA)
    assert u[clean] == pytest.approx(np.full(clean.sum(), -1.0), abs=1e-9)
    assert np.nanmax(u) > -0.2
    assert np.isnan(u[z > 18.0]).all()
    assert np.isnan(seen["v_S"]).all()  # the surface is no bottom


# -- noise ------------------------------------------------------------------------------------------------------------------------------


def ensembles(config, instant, count, **settings):
    """So many, each with its own random numbers."""
    sensor = config.build(Pose())
    sensor.change(settings)
    for number in range(count):
        sensor.begin(number)
        sensor.memory = msgspec.structs.replace(sensor.memory, ready=0.0)
        yield fields_of(sensor, (True, sensor.sense(instant).values))


def spread(config, instant, count=300, cells=4, **settings):
    """Standard deviations over ensembles of x, y, z, the error velocity and one beam, of the first cells."""
    rows = [
        np.column_stack(
            [seen["velocities_S"][:cells], seen["error_velocities"][:cells], seen["beam_velocities"][:cells, 0]]
        )
        for seen in ensembles(config, instant, count, **settings)
    ]
    return np.std(np.concatenate(rows), axis=0)


NOISY = change(beam_sigma_mps=0.02, cells=4, max_range_m=1000.0, frequency_hz=5e4)
"""So strong an echo that only the noise of a strong one is left."""


def test_noise_of_a_janus(deep):
    """sigma_xy = sigma_b / (sqrt 2 sin theta), sigma_z = sigma_b / (2 cos theta); the error velocity is scaled to be as the horizontal."""
    x, y, z, e, b = spread(NOISY, deep())
    horizontal = 0.02 / (math.sqrt(2.0) * math.sin(THETA))
    assert (x, y, e) == pytest.approx((horizontal,) * 3, rel=0.1)
    assert (z, b) == pytest.approx((0.02 / (2.0 * math.cos(THETA)), 0.02), rel=0.1)


def test_noise_goes_down_with_cell_size_and_pings(deep):
    assert spread(NOISY, deep(), cell_size=2.0)[4] == pytest.approx(0.01, rel=0.1)
    assert spread(NOISY, deep(), cell_size=0.5)[4] == pytest.approx(0.04, rel=0.1)
    assert spread(NOISY, deep(), pings=16)[4] == pytest.approx(0.005, rel=0.1)


@pytest.mark.parametrize("pings", [1, 2, 3])
def test_each_beam_and_cell_has_noise_of_its_own(deep, pings):
    told = [seen["beam_velocities"].ravel() for seen in ensembles(NOISY, deep(), 400, pings=pings)]
    between = np.corrcoef(np.array(told).T) - np.eye(16)
    assert np.abs(between).max() < 4.5 / math.sqrt(400)
    assert np.std(told) == pytest.approx(0.02 / math.sqrt(pings), rel=0.05)


def test_a_weak_echo_is_noisier(deep):
    """At the end of the range the correlation is halved: sqrt((16 - 1) / (4 - 1)) times the noise."""
    config = change(NOISY, cells=1, cell_size_m=1.0, blanking_m=19.0, max_range_m=20.0 + 1e-6, frequency_hz=6e5)
    assert spread(config, deep(), 800, 1)[4] == pytest.approx(0.02 * math.sqrt(5.0), rel=0.12)


def test_near_the_ambiguity_pings_fall_to_both_sides(deep):
    config = change(NOISY, axial_beam=True, ambiguity_velocity_mps=1.0)
    seen = profile(change(config, pings=256), deep(water=replace(STILL, current=(0.0, 0.0, 1.0))))
    assert np.abs(seen["beam_velocities"][:, 4]).max() < 0.25  # the mean of +1 and -1


# -- sound, bottom, time ----------------------------------------------------------------------------------------------------------------


def test_a_wrong_sound_speed_stretches_velocities_and_places(deep):
    instant = deep(20.0, water=flowing(lambda z: (0.01 * (z - DEEP), 0.0, 0.0)), v_NB_B=(0.0, 0.8, 0.0))
    c = instant.water.sound_speed(DEEP)
    seen = profile(change(cells=10), instant, sound_speed=1.04 * c)
    # An echo that the device places at z comes from z / 1.04, and its Doppler shift is taken for 1.04 times the velocity.
    assert seen["velocities_S"][:, 0] == pytest.approx(0.01 * seen["distances"], abs=1e-9)
    assert seen["velocities_S"][:, 1] == pytest.approx(np.full(10, -0.8 * 1.04), abs=1e-9)
    assert seen["v_S"] == pytest.approx((0.0, 0.8 * 1.04, 0.0), abs=1e-9)
    assert seen["altitude"] == pytest.approx(20.0 * 1.04, abs=1e-9)


def test_bottom_track_over_a_slope_knows_the_altitude_along_the_axis(deep):
    rpy = (0.1, -0.15, 0.4)
    seen = profile(QUIET, deep(25.0, q_NB=quat_from_rpy(*rpy), v_NB_B=(0.5, 0.1, -0.2)))
    axis = Rotation.from_euler("ZYX", rpy[::-1]).apply((0.0, 0.0, 1.0))
    assert seen["altitude"] == pytest.approx(25.0 / axis[2], abs=1e-9)
    assert seen["v_S"] == pytest.approx((0.5, 0.1, -0.2), abs=1e-12)


def test_bottom_track_ends_at_its_largest_altitude_and_speed(deep):
    assert profile(QUIET, deep(79.5))["altitude"] == pytest.approx(79.5)
    for lost in (
        profile(QUIET, deep(80.5)),
        profile(change(bottom_max_altitude_m=0.0), deep(20.0)),
        profile(change(bottom_max_speed_mps=0.5), deep(20.0, v_NB_B=(3.0, 0.0, 0.0))),
        profile(QUIET, deep(0.4)),
    ):
        assert math.isnan(lost["altitude"])
        assert np.isnan(lost["v_S"]).all()
        assert np.isnan(lost["beam_ranges"]).all()


def test_noise_of_bottom_track(deep):
    config = change(bottom_sigma_mps=0.01, bottom_range_sigma_m=0.05, cells=1)
    found = [[*seen["v_S"], seen["beam_ranges"][2]] for seen in ensembles(config, deep(20.0), 500)]
    horizontal = 0.01 / (math.sqrt(2.0) * math.sin(THETA))
    expected = (horizontal, horizontal, 0.01 / (2.0 * math.cos(THETA)), 0.05)
    assert np.std(found, axis=0) == pytest.approx(expected, rel=0.15)


def test_an_ensemble_lasts_as_long_as_its_pings(deep):
    config = change(pings=10, bottom_max_altitude_m=0.0, processing_s=0.05)
    sensor, instant = config.build(Pose()), deep()
    reading = sensor.sense(instant)
    travel = 2.0 * (20.5 + 0.5) / math.cos(THETA) / instant.water.sound_speed(DEEP)
    assert reading.delay_ns == pytest.approx(1e9 * (10.0 * travel + 0.05), abs=2)
    late = round(1e9 * 10.0 * travel)
    assert sensor.sense(replace(instant, t_ns=late - 5_000_000)) is None
    assert sensor.sense(replace(instant, t_ns=late + 5_000_000)) is not None


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"cell_size_m": 20.0}, "cell_size_m must lie between"),
        ({"correlation_threshold": 0.6}, "every cell is lost"),
        ({"bottom_max_altitude_m": 0.2}, "or 0 to leave out bottom track"),
        ({"beam_azimuth_deg": (0.0, 180.0, 0.0)}, "different sides"),
    ],
)
def test_keys_that_do_not_go_together(keys, text):
    with pytest.raises(ValueError, match=text):
        AdcpConfig(rate_hz=1, **keys)
