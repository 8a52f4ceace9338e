"""The scanning sonar: levels against the closed sonar equation, speckle against Rayleigh, the paper's picture ray by ray, and the head.

Also of uwserver.sensors.acoustic.scanning_sonar, uwserver.sensors.acoustic.imaging.blocks and
uwserver.sensors.acoustic.imaging.block_arrays.
"""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy import integrate, stats

from uwserver.frames import quat_from_rpy, rotate
from uwserver.physics.geometry.shapes import Box, Cylinder, Placed, Solid
from uwserver.physics.rays.casting import Rays
from uwserver.sensors import Pose, ScanningSonarConfig
from uwserver.sensors.acoustic.head import HeadMemory
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


def built(config, mount=None, seed=0):
    """A sonar that is switched on."""
    sonar = config.build(mount or Pose())
    sonar.start(seed)
    return sonar


def be_ready(sonar):
    """The last ping is over; the head stays where it is."""
    memory = sonar.memory
    memory.ready = 0.0
    sonar.memory = memory


def row(config, instant, seed=0):
    """Bins of one ping as an array."""
    sonar = built(config, seed=seed)
    return np.array(sonar.sense(instant).values[3])


def test_contract():
    deep = [s for s in scopes() if s.p_NB[2] > 1.0]
    small = {"rate_hz": 20, "bins": 32, "rays_vertical": 9, "rays_horizontal": 3}
    for config in (
        ScanningSonarConfig(**small),
        ScanningSonarConfig(output="complex", **small),
        ScanningSonarConfig(model="paper", output="pressure", **small),
    ):
        check_sensor(config, instants=deep)
    with pytest.raises(ValueError, match='"paper" knows no phase'):
        ScanningSonarConfig(model="paper", output="complex", **small)


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


FINE = msgspec.structs.replace(LEVELS, bins=4000, range_m=14.0)
"""Bins shorter than half a pulse: each holds the sample of one instant, and not the peak of several."""


def pings(config, shapes, count, facing, seed=0):
    """Bins of pings from places 5 m apart along the bottom: none sees the speckle of another."""
    sonar = built(config, seed=seed)
    for k in range(count):
        sonar.memory = HeadMemory()
        yield np.array(sonar.sense(facing(*shapes, p_NB=(3.0 * k, 4.0 * k, DEEP))).values[3])


@pytest.mark.parametrize("r", [9.0, 11.0, 13.0])
def test_mean_of_noisy_pings_is_the_mean_level(facing, r):
    """10 lg of the mean intensity, with noise taken off."""
    bottom = Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0))
    quiet = row(FINE, facing(bottom)) ** 2
    config = msgspec.structs.replace(FINE, ideal=False)
    noise = 1e-12 * config.build(Pose())._noise
    total = sum(np.square(ping) for ping in pings(config, (bottom,), 100, facing))
    k = int(r / 14.0 * 4000)
    near = slice(k - 100, k + 101)
    assert 10.0 * np.log10((total[near] / 100 - noise).sum() / quiet[near].sum()) == pytest.approx(0.0, abs=0.2)


def test_bins_longer_than_the_pulse_show_the_peak_of_their_looks(facing):
    """Of n independent looks the peak is 1 + 1/2 + ... + 1/n times their mean: here there are 13, and one between each two."""
    bottom = Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0))
    quiet = row(LEVELS, facing(bottom)) ** 2
    config = msgspec.structs.replace(LEVELS, ideal=False, noise_level_db=-100.0)
    total = sum(np.square(ping) for ping in pings(config, (bottom,), 60, facing))
    lifted = (total[100:] / 60).sum() / quiet[100:].sum()
    assert sum(1.0 / n for n in range(1, 14)) < lifted < sum(1.0 / n for n in range(1, 28))


def test_level_does_not_depend_on_the_number_of_rays(facing):
    """Rays x 4: less than 0.2 dB, in every tenth of the range that is seen; on a bottom and on a wall."""
    more = msgspec.structs.replace(LEVELS, rays_horizontal=26, rays_vertical=142)
    # Not at the border of two tenths: what the pulse shows before a wall is a matter of millimetres.
    bottom, wall = Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0)), Plane((21.4, 0.0, 0.0), (-1.0, 0.0, 0.0))
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


# -- thin things ------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bin_m", [0.005, 0.0075, 0.013, 0.04, 0.1, 0.2])
@pytest.mark.parametrize("r", [10.0, 10.03])
def test_a_plate_has_the_level_of_the_sonar_equation_in_bins_of_any_length(scope, bin_m, r):
    """Half a metre square and hard: SL + 10 lg BT - 40 lg r - 2 alpha r + 10 lg mu + 10 lg A, A weighted by the two-way pattern."""
    reach = 60 * 0.2
    config = msgspec.structs.replace(LEVELS, range_m=reach, bins=round(reach / bin_m))
    instant = among(scope, Box((0.05, 0.25, 0.25)), (r + 0.05, 0.0, DEEP))
    seen = np.linspace(-0.25, 0.25, 41) / r
    patterns = [np.mean([one_way(a, rad(width)) ** 2 for a in seen]) for width in (3.0, 30.0)]
    alpha = instant.water.absorption(7e5, DEEP)
    level = 200.0 + 10.0 * math.log10(1e5 * 4e-4) - 40.0 * math.log10(r) - 2.0 * alpha * r
    level += -27.0 + 10.0 * math.log10(0.25 * patterns[0] * patterns[1])
    amplitude = row(config, instant)
    assert 20.0 * math.log10(amplitude.max() * 1e6) == pytest.approx(level, abs=0.5)
    assert (amplitude.argmax() + 0.5) * reach / config.bins == pytest.approx(r, abs=0.5 * bin_m + 0.006)


def among(scope, shape, p, q=(1.0, 0.0, 0.0, 0.0), **state):
    """Before one solid, by the rays of a world."""
    rays = Rays()
    rays.add_static(0, Solid("thing", (Placed(shape, p, q),)))
    instant = scope(**{"p_NB": (0.0, 0.0, DEEP), **state})
    instant.geometry = rays.at(np.zeros((0, 13)))
    return instant


UPRIGHT = quat_from_rpy(0.0, math.pi / 2, 0.0)


@pytest.mark.parametrize("r", [10.0, 20.0, 40.0])
@pytest.mark.parametrize("half_length", [6.0, 20.0])
def test_a_pile_of_5_cm_is_seen_in_every_bearing_at_one_level(scope, r, half_length):
    """Within 1 dB of the mean over bearings from -0.9 to 0.9 degrees, the two-way pattern taken off."""
    sonar = built(msgspec.structs.replace(LEVELS, range_m=60.0, bins=400))
    levels = []
    for bearing in np.arange(-0.9, 0.901, 0.06):
        instant = among(
            scope, Cylinder(0.025, half_length), (r, 0.0, DEEP), UPRIGHT, q_NB=quat_from_rpy(0.0, 0.0, rad(bearing))
        )
        sonar.memory = HeadMemory()
        echo = max(sonar.sense(instant).values[3]) * 1e6
        levels.append(20.0 * math.log10(echo) - 20.0 * math.log10(one_way(rad(bearing), rad(3.0))))
    mean = 10.0 * math.log10(np.mean(10.0 ** (0.1 * np.array(levels))))
    assert np.abs(np.array(levels) - mean).max() < 1.0


def test_a_turn_sees_a_pile_wherever_it_stands(scope):
    """The strongest ping of a turn of 1.8 degrees a step, the pile at any bearing: 3 dB of the pattern lie between two steps."""
    config = msgspec.structs.replace(LEVELS, range_m=30.0, sector_width_deg=7.2, step_deg=1.8)
    peaks = []
    for bearing in np.linspace(-0.9, 0.9, 7):
        sonar, (y, x) = built(config), (20.0 * math.sin(rad(bearing)), 20.0 * math.cos(rad(bearing)))
        instant, strongest = among(scope, Cylinder(0.025, 10.0), (x, y, DEEP), UPRIGHT), 0.0
        for _ in range(5):
            be_ready(sonar)
            strongest = max(strongest, *sonar.sense(instant).values[3])
        peaks.append(20.0 * math.log10(strongest))
    assert max(peaks) - min(peaks) < 3.0


def test_a_still_sonar_hears_the_same_of_a_thin_thing(scope):
    config = msgspec.structs.replace(LEVELS, ideal=False, noise_level_db=-100.0)
    instant = among(scope, Cylinder(0.025, 10.0), (14.0, 0.1, DEEP), UPRIGHT)
    assert row(config, instant).tolist() == row(config, instant).tolist()


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
    """Amplitude over its expected root mean square: Kolmogorov-Smirnov, 20 seeds. Of bins that share no gate."""
    bottom = Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0))
    config = msgspec.structs.replace(FINE, ideal=False)
    expected = np.sqrt(row(FINE, facing(bottom)) ** 2 + 1e-12 * config.build(Pose())._noise)
    p = []
    for seed in range(40, 60):
        amplitudes = [(ping / expected)[::20] for ping in pings(config, (bottom,), 10, facing, seed)]
        p.append(stats.kstest(np.concatenate(amplitudes), stats.rayleigh(scale=math.sqrt(0.5)).cdf).pvalue)
    assert sum(value > 0.05 for value in p) >= 18
    assert min(p) >= 0.001


def test_the_complex_echo_is_normal_and_has_the_amplitude_of_the_real_one(facing):
    """Real and imaginary part of bins that share no gate: normal, each with half of the mean intensity, and independent."""
    bottom = Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0))
    config = msgspec.structs.replace(FINE, ideal=False)
    expected = np.sqrt(row(FINE, facing(bottom)) ** 2 + 1e-12 * config.build(Pose())._noise)[:, None]
    waved = msgspec.structs.replace(config, output="complex")
    found = []
    for seed in range(40):
        sonar = built(waved, seed=seed)
        wave = sonar.sense(facing(bottom)).values[3].array()
        if seed == 0:
            assert np.allclose(np.hypot(wave[:, 0], wave[:, 1]), row(config, facing(bottom)), rtol=1e-5)
        found.append((wave / expected)[::20])
    z = np.concatenate(found)
    z = z[np.isfinite(z).all(axis=1)]
    for part in z.T:
        assert stats.kstest(part, stats.norm(scale=math.sqrt(0.5)).cdf).pvalue > 0.01
    assert abs(np.mean(z[:, 0] * z[:, 1])) < 4.0 * 0.5 / math.sqrt(len(z))


def test_a_still_sonar_sees_the_same_speckle_turn_after_turn_and_a_moving_one_another(facing):
    """Correlation of the levels of a turn with those of the next one."""
    bottom = Plane((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0))
    config = msgspec.structs.replace(LEVELS, ideal=False, step_deg=60.0, bins=1000, noise_level_db=-300.0)
    mean = row(msgspec.structs.replace(config, ideal=True), facing(bottom))[300:]

    def turns(*places):
        sonar = built(config)
        made = []
        for p in places:
            for _ in range(6):
                be_ready(sonar)
                made.append(np.array(sonar.sense(facing(bottom, p_NB=p)).values[3])[300:] / mean)
        return np.array(made).reshape(len(places), -1)

    x, near, far = (0.0, 0.0, DEEP), (0.002, 0.0, DEEP), (0.5, 0.0, DEEP)
    first, second, moved, away, back = turns(x, x, near, far, x)
    assert np.array_equal(first, second)
    assert np.array_equal(first, back)
    assert np.corrcoef(first, moved)[0, 1] > 0.8
    assert abs(np.corrcoef(first, away)[0, 1]) < 0.1
    # Bearings apart have speckle of their own.
    assert abs(np.corrcoef(first[:700], first[700:1400])[0, 1]) < 0.15


def test_noise_is_that_of_the_ping(facing):
    """Also where nothing moves; and the same again in a run that repeats."""
    config = msgspec.structs.replace(FINE, ideal=False)
    sonar, again = built(config), built(config)
    rows = []
    for each in (sonar, sonar, again):
        number = len(rows) % 2
        each.memory = HeadMemory()
        each.begin(number)
        rows.append(each.sense(facing()).values[3])
    assert rows[0] == rows[2]
    assert abs(np.corrcoef(rows[0], rows[1])[0, 1]) < 0.1


def test_noise_alone_has_its_level(facing):
    """NL + 10 lg B - DI with nothing in sight."""
    config = msgspec.structs.replace(FINE, ideal=False)
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
    sonar = built(config)
    found = []
    for _ in range(n):
        be_ready(sonar)
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
        sonar = built(config, mount)
        seen = {}
        for _ in range(4):
            be_ready(sonar)
            reading = sonar.sense(ball)
            seen[round(math.degrees(reading.values[0]))] = any(reading.values[3])
        assert [angle for angle, found in seen.items() if found] == [expected]


def test_each_ping_has_its_own_pose(facing):
    """Smear: a vehicle that turns against the head sees one wall at the same range in every ping."""
    config = msgspec.structs.replace(LEVELS, step_deg=30.0)
    sonar = built(config)
    wall = Plane((21.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    first = []
    for k in range(5):
        be_ready(sonar)
        first.append(int(np.argmax(sonar.sense(facing(wall, q_NB=quat_from_rpy(0.0, 0.0, -k * rad(30.0)))).values[3])))
    assert len(set(first)) == 1


def test_timing(facing):
    """Delivered when the last echo is there; the next ping waits for it and the overhead."""
    config = ScanningSonarConfig(rate_hz=240, range_m=30.0, rays_horizontal=1, rays_vertical=3, bins=8)
    c = facing().water.sound_speed(DEEP)
    sonar = built(config)
    readings = [sonar.sense(facing(t_ns=round(k * 1e9 / 240))) for k in range(240)]
    told = [k for k, reading in enumerate(readings) if reading is not None]
    assert readings[0].delay_ns == round(1e9 * 60.0 / c)
    assert set(np.diff(told)) == {math.ceil((60.0 / c + 0.01) * 240)}


def test_settings_change_picture_and_sector(facing):
    sonar = built(LEVELS)
    wall = facing(Plane((12.0, 0.0, 0.0), (-1.0, 0.0, 0.0)))
    before = int(np.argmax(sonar.sense(wall).values[3]))
    sonar.change({"range": 15.0, "sector_width": 0.5, "sector_center": 0.0, "step": 0.25})
    sonar.memory = HeadMemory(index=1)
    reading = sonar.sense(wall)
    assert reading.values[:2] == [0.0, 15.0]
    assert int(np.argmax(reading.values[3])) == pytest.approx(2 * before, abs=2)


def test_in_the_air_it_sees_nothing(scope):
    reading = built(LEVELS).sense(scope(p_NB=(0.0, 0.0, -0.1)))
    assert not reading.valid
    assert reading.values[3] == (None,) * 300


def test_the_surface_is_seen_from_below(scope):
    """Looking up in open water: the first echo at the depth."""
    sonar = built(LEVELS)
    amplitude = np.array(sonar.sense(scope(p_NB=(0.0, 0.0, 8.0), q_NB=quat_from_rpy(0.0, math.pi / 2, 0.0))).values[3])
    assert int(np.argmax(amplitude > 0.0)) == pytest.approx(79, abs=1)
