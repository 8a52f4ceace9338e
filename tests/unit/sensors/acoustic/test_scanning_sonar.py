"""The scanning sonar: levels against the closed sonar equation, speckle against Rayleigh, the paper's picture ray by ray, and the head."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy import integrate, stats

from uwserver.frames import quat_from_rpy, rotate
from uwserver.sensors import Pose, ScanningSonarConfig
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.testing.sensors import scopes
from uwserver.units import rad

HEIGHT = 4.0
BOTTOM = Plane((0.0, 0.0, 5.0 + HEIGHT), (0.0, 0.0, -1.0))
LEVELS = ScanningSonarConfig(rate_hz=20, ideal=True, output="pressure", bins=300, range_m=30.0)
DEEP = 1000.0  # far from the surface


@pytest.fixture
def facing(scope):
    """`facing(shape, ..., **state)`: 1000 m below the surface, before some shapes given relative to that."""

    def build(*shapes, **state):
        made = scope(**{"p_NB": (0.0, 0.0, DEEP), **state})
        moved = [
            replace(s, center=(*s.center[:2], s.center[2] + DEEP))
            if isinstance(s, Sphere)
            else replace(s, point=(*s.point[:2], s.point[2] + DEEP))
            for s in shapes
        ]
        made.geometry = FakeGeometry(moved)
        return made

    return build


def row(config, instant, seed=0):
    """Bins of one ping as an array."""
    sonar = config.build(Pose())
    sonar.start(seed)
    return np.array(sonar.sense(instant).values[3])


def test_contract():
    deep = [s for s in scopes() if s.p_NB[2] > 1.0]
    small = {"rate_hz": 20, "bins": 32, "rays_vertical": 9, "rays_horizontal": 3}
    for config in (ScanningSonarConfig(**small), ScanningSonarConfig(model="paper", output="pressure", **small)):
        check_sensor(config, instants=deep)


# -- levels -----------------------------------------------------------------------------------------------------------------------------


def one_way(angle, width):
    """sinc^2 with half power at half the width, from its definition."""
    x = 2.0 * 1.391557 * angle / width  # sin(x)/x = 1/sqrt 2 at 1.391557
    return 1.0 if x == 0.0 else (math.sin(x) / x) ** 2


def sonar_equation(config, instant, height, r):
    """Level (dB re 1 uPa) of a flat sediment at slant range r below a horizontal beam: SL - 40 lg r - 2 alpha r + S_b + 10 lg A + 2 BP.

    A resolution cell has the area A = Phi r dr, Phi the integral of the two-way pattern over azimuth; S_b = -27 dB + 20 lg (h / r).
    """
    alpha = instant.water.absorption(config.frequency_hz, DEEP)
    cell = instant.water.sound_speed(DEEP) / (2.0 * config.bandwidth_hz)
    width, tall = rad(config.beam_width_horizontal_deg), rad(config.beam_width_vertical_deg)
    phi = integrate.quad(lambda a: one_way(a, width) ** 2, -width, width)[0]
    pattern = 20.0 * math.log10(one_way(math.asin(height / r), tall))
    backscatter = -27.0 + 20.0 * math.log10(height / r)
    area = 10.0 * math.log10(phi * r * cell)
    compressed = 10.0 * math.log10(config.bandwidth_hz * config.pulse_s)
    return compressed + config.source_level_db - 40.0 * math.log10(r) - 2.0 * alpha * r + backscatter + area + pattern


@pytest.mark.parametrize("r", [10.0, 14.0, 18.0, 23.0, 29.0])
def test_mean_level_is_that_of_the_sonar_equation(facing, r):
    instant = facing(Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0)))
    amplitude = row(LEVELS, instant)
    k = int(r / 30.0 * 300)
    level = 20.0 * math.log10(amplitude[k] * 1e6)
    assert level == pytest.approx(sonar_equation(LEVELS, instant, HEIGHT, (k + 0.5) * 0.1), abs=0.5)


@pytest.mark.parametrize("r", [10.0, 14.0, 18.0, 23.0, 29.0])
def test_mean_of_noisy_pings_is_the_mean_level(facing, r):
    """10 lg of the mean intensity, with noise taken off."""
    config = msgspec.structs.replace(LEVELS, ideal=False)
    instant = facing(Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0)))
    quiet = row(LEVELS, instant) ** 2
    sonar = config.build(Pose())
    noise = 1e-12 * sonar._noise
    total = np.zeros(300)
    for _ in range(400):
        sonar.memory = sonar.turn_on()
        total += np.square(sonar.sense(instant).values[3])
    k = int(r / 30.0 * 300)
    near = slice(k - 5, k + 6)
    assert 10.0 * np.log10((total[near] / 400 - noise).sum() / quiet[near].sum()) == pytest.approx(0.0, abs=0.2)


def test_level_does_not_depend_on_the_number_of_rays(facing):
    """Rays x 4: less than 0.2 dB, in every tenth of the range that is seen; on a bottom and on a wall."""
    more = msgspec.structs.replace(LEVELS, rays_horizontal=26, rays_vertical=142)
    bottom, wall = Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0)), Plane((21.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    for shapes in ((bottom,), (wall,), (bottom, wall)):
        few, many = (np.square(row(config, facing(*shapes))).reshape(10, 30).sum(axis=1) for config in (LEVELS, more))
        seen = many > 1e-4 * many.max()
        assert seen.any()
        assert np.abs(10.0 * np.log10(few[seen] / many[seen])).max() < 0.2


def test_a_bottom_has_neither_gaps_nor_stripes(facing):
    """Neighbouring bins of a flat bottom differ by little, though they are more than the rows of rays."""
    amplitude = row(msgspec.structs.replace(LEVELS, bins=1000), facing(Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0))))
    assert np.abs(np.diff(20.0 * np.log10(amplitude[400:]))).max() < 1.0  # speckle has 5.6 dB


def test_a_wall_gives_all_its_energy_near_its_range(facing):
    amplitude = row(LEVELS, facing(Plane((21.0, 0.0, 0.0), (-1.0, 0.0, 0.0))))
    energy = amplitude**2
    assert energy[: 21 * 10 - 1].sum() < 1e-9 * energy.sum()
    assert energy[209:230].sum() > 0.9 * energy.sum()


@pytest.mark.parametrize("reach", [5.0, 10.0, 30.0, 75.0])
@pytest.mark.parametrize("model", ["sonar_equation", "paper"])
def test_echoes_right_up_to_the_last_bin(facing, model, reach):
    """A wall at the very end of the range is in the last bin, one just behind it in none; every bin has its turn."""
    config = msgspec.structs.replace(
        LEVELS, model=model, range_m=reach, bins=200, beam_width_vertical_deg=1.0, beam_width_horizontal_deg=1.0
    )
    for k in (0, 1, 100, 198, 199):
        at = (k + 0.5) * reach / 200
        amplitude = row(config, facing(Plane((at, 0.0, 0.0), (-1.0, 0.0, 0.0))))
        assert int(amplitude.argmax()) == k
        assert amplitude[k] > 0.0
    last = row(config, facing(Plane((reach * (1 - 1e-3), 0.0, 0.0), (-1.0, 0.0, 0.0))))
    assert int(last.argmax()) == 199
    assert not row(config, facing(Plane((reach * 1.04, 0.0, 0.0), (-1.0, 0.0, 0.0)))).any()


# -- the paper --------------------------------------------------------------------------------------------------------------------------


def test_the_papers_picture_ray_by_ray(facing):
    """3 x 30 degrees, 13 x 71 rays, sum of dot products over the bin of each range: a plain loop gives the same to 1e-9."""
    config = ScanningSonarConfig(rate_hz=20, model="paper", output="pressure", bins=300)
    slope, ball = Plane((0.0, 0.0, HEIGHT), (0.1, -0.2, -1.0)), Sphere((12.0, 0.2, 0.5), 1.5)
    instant = facing(slope, ball, q_NB=quat_from_rpy(0.05, -0.1, 0.2))
    expected = np.zeros(300)
    for i in range(13):
        for j in range(71):
            az, el = (rad(3.0 * ((i + 0.5) / 13 - 0.5)), rad(30.0 * ((j + 0.5) / 71 - 0.5)))
            d = np.array(rotate(instant.q_NB, (math.cos(el) * math.cos(az), math.cos(el) * math.sin(az), math.sin(el))))
            hit = instant.geometry.raycast(np.array([instant.p_NB]), d[None], 30.0)
            if hit.distance[0] <= 30.0:
                expected[min(int(hit.distance[0] / 30.0 * 300), 299)] += abs(hit.normal[0] @ d) / (13 * 71)
    assert expected.max() > 0.0
    assert row(config, instant) == pytest.approx(expected, abs=1e-9)
    counts = row(msgspec.structs.replace(config, output="counts"), instant)
    assert counts.tolist() == np.rint(255 * expected).tolist()


# -- noise ------------------------------------------------------------------------------------------------------------------------------


def test_speckle_is_rayleigh(facing):
    """Amplitude before compression over its expected root mean square: Kolmogorov-Smirnov, 20 seeds."""
    config = msgspec.structs.replace(LEVELS, ideal=False)
    instant = facing(Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0)))
    expected = np.sqrt(row(LEVELS, instant) ** 2 + 1e-12 * config.build(Pose())._noise)
    p = []
    for seed in range(40, 60):
        sonar = config.build(Pose())
        sonar.start(seed)
        amplitudes = []
        for _ in range(10):
            sonar.memory = sonar.turn_on()
            amplitudes.append(sonar.sense(instant).values[3] / expected)
        p.append(stats.kstest(np.concatenate(amplitudes), stats.rayleigh(scale=math.sqrt(0.5)).cdf).pvalue)
    assert sum(value > 0.05 for value in p) >= 18
    assert min(p) >= 0.001


def test_noise_alone_has_its_level(facing):
    """NL + 10 lg B - DI with nothing in sight."""
    config = msgspec.structs.replace(LEVELS, ideal=False, bins=4000)
    mean = np.mean(row(config, facing()) ** 2) * 1e12
    index = 10.0 * math.log10(4.0 * math.pi / (rad(3.0) * rad(30.0)))
    assert 10.0 * math.log10(mean) == pytest.approx(42.0 + 50.0 - index, abs=0.2)


def test_compression(facing):
    """Counts are level, time-varied gain and gain on 255 steps of 80 dB; a step of gain moves all that is not clipped."""
    instant = facing(Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0)))
    pressure, counts = row(LEVELS, instant), row(msgspec.structs.replace(LEVELS, output="counts"), instant)
    alpha = instant.water.absorption(7e5, DEEP)
    r = (np.arange(300) + 0.5) * 0.1
    level = 20.0 * np.log10(np.maximum(pressure * 1e6, 1e-15)) - 120.0
    level += np.minimum(30.0 * np.log10(r) + 2.0 * alpha * r, 60.0)
    assert counts.tolist() == pytest.approx(np.clip(level / 80.0 * 255.0, 0, 255).tolist(), abs=0.51)
    assert 0 < counts.max() < 255
    louder = row(msgspec.structs.replace(LEVELS, output="counts", gain_db=8.0), instant)
    plain = (counts > 0) & (louder < 255)
    assert np.abs(louder[plain] - counts[plain] - 25.5).max() < 1.01


def test_a_wrong_sound_speed_moves_the_echo(facing):
    config = msgspec.structs.replace(
        LEVELS, ideal=False, bins=3000, assumed_sound_speed_mps=1400.0, noise_level_db=-100.0
    )
    instant = facing(Plane((25.0, 0.0, 0.0), (-1.0, 0.0, 0.0)))
    amplitude = row(config, instant)
    first = int(np.argmax(amplitude > 0.01 * amplitude.max()))
    assert first == pytest.approx(25.0 * 1400.0 / instant.water.sound_speed(DEEP) * 100, abs=1.5)


# -- the head ---------------------------------------------------------------------------------------------------------------------------


def angles(config, instant, n):
    sonar = config.build(Pose())
    found = []
    for _ in range(n):
        sonar.memory.ready = 0.0
        found.append(sonar.sense(instant).values[0])
    return np.array(found)


def test_a_full_turn(facing):
    config = ScanningSonarConfig(rate_hz=20, step_deg=1.8, rays_horizontal=1, rays_vertical=3, bins=8)
    turned = angles(config, facing(), 401)
    assert np.unwrap(turned)[200] == pytest.approx(2.0 * math.pi)
    assert np.diff(np.unwrap(turned)) == pytest.approx(np.full(400, rad(1.8)))


def test_a_sector_goes_to_and_fro(facing):
    config = ScanningSonarConfig(
        rate_hz=20, step_deg=10.0, sector_center_deg=90.0, sector_width_deg=60.0, rays_horizontal=1, rays_vertical=3, bins=8
    )  # fmt: skip
    turned = np.rint(np.degrees(angles(config, facing(), 14))).astype(int).tolist()
    assert turned == [60, 70, 80, 90, 100, 110, 120, 110, 100, 90, 80, 70, 60, 70]


def test_the_head_points_from_x_to_y(facing):
    """A ball to starboard is seen when the head stands at 90 degrees, and only there; a mount turned upside down sees it at -90."""
    config = msgspec.structs.replace(LEVELS, step_deg=90.0)
    ball = facing(Sphere((0.0, 15.0, 0.0), 1.0))
    for mount, expected in ((Pose(), 90), (Pose(q=quat_from_rpy(math.pi, 0.0, 0.0)), -90)):
        sonar = config.build(mount)
        seen = {}
        for _ in range(4):
            sonar.memory.ready = 0.0
            reading = sonar.sense(ball)
            seen[round(math.degrees(reading.values[0]))] = any(reading.values[3])
        assert [angle for angle, found in seen.items() if found] == [expected]


def test_each_ping_has_its_own_pose(facing):
    """Smear: a vehicle that turns against the head sees one wall at the same range in every ping."""
    config = msgspec.structs.replace(LEVELS, step_deg=30.0)
    sonar = config.build(Pose())
    wall = Plane((21.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    first = []
    for k in range(5):
        sonar.memory.ready = 0.0
        first.append(int(np.argmax(sonar.sense(facing(wall, q_NB=quat_from_rpy(0.0, 0.0, -k * rad(30.0)))).values[3])))
    assert len(set(first)) == 1


def test_timing(facing):
    """Delivered when the last echo is there; the next ping waits for it and the overhead."""
    config = ScanningSonarConfig(rate_hz=240, range_m=30.0, rays_horizontal=1, rays_vertical=3, bins=8)
    c = facing().water.sound_speed(DEEP)
    sonar = config.build(Pose())
    readings = [sonar.sense(facing(t_ns=round(k * 1e9 / 240))) for k in range(240)]
    told = [k for k, reading in enumerate(readings) if reading is not None]
    assert readings[0].delay_ns == round(1e9 * 60.0 / c)
    assert set(np.diff(told)) == {math.ceil((60.0 / c + 0.01) * 240)}


def test_settings_change_picture_and_sector(facing):
    sonar = LEVELS.build(Pose())
    wall = facing(Plane((12.0, 0.0, 0.0), (-1.0, 0.0, 0.0)))
    before = int(np.argmax(sonar.sense(wall).values[3]))
    sonar.change({"range": 15.0, "sector_width": 0.5, "sector_center": 0.0, "step": 0.25})
    sonar.memory.ready, sonar.memory.index = 0.0, 1
    reading = sonar.sense(wall)
    assert reading.values[:2] == [0.0, 15.0]
    assert int(np.argmax(reading.values[3])) == pytest.approx(2 * before, abs=2)


def test_in_the_air_it_sees_nothing(scope):
    reading = LEVELS.build(Pose()).sense(scope(p_NB=(0.0, 0.0, -0.1)))
    assert not reading.valid
    assert reading.values[3] == (None,) * 300


def test_the_surface_is_seen_from_below(scope):
    """Looking up in open water: the first echo at the depth."""
    sonar = LEVELS.build(Pose())
    amplitude = np.array(sonar.sense(scope(p_NB=(0.0, 0.0, 8.0), q_NB=quat_from_rpy(0.0, math.pi / 2, 0.0))).values[3])
    assert int(np.argmax(amplitude > 0.0)) == pytest.approx(79, abs=1)
