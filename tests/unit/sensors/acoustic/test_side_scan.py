"""The side-scan sonar: levels against the sonar equation, equal sides, shadows, the water column, and what it is asked."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy import integrate, stats

from uwserver.frames import quat_from_rpy
from uwserver.sensors import Pose, SideScanConfig
from uwserver.sensors.acoustic.imaging.fan import Sides, cost, two_way
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.testing.sensors import scopes
from uwserver.units import rad

DEEP, HEIGHT, BIN = 1000.0, 6.0, 0.1
BOTTOM = Plane((0.0, 0.0, DEEP + HEIGHT), (0.0, 0.0, -1.0))
LEVELS = SideScanConfig(rate_hz=5, ideal=True, output="pressure", bins=500, range_m=50.0, bandwidth_hz=7.5e3)
NOISY = msgspec.structs.replace(LEVELS, ideal=False, noise_level_db=-100.0)


@pytest.fixture
def facing(scope: Any) -> Any:
    """`facing(shape, ..., **state)`: deep below the surface, over some shapes."""

    def build(*shapes: Any, **state: Any) -> Any:
        made = scope(**{"p_NB": (0.0, 0.0, DEEP), **state})
        made.geometry = FakeGeometry(shapes)
        return made

    return build


def rows(config: SideScanConfig, instant: Any, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Port and starboard."""
    sonar = config.build(Pose())
    sonar.start(seed)
    valid, values = sonar.measure(instant)
    assert valid
    return values[-2].array(), values[-1].array()


def test_contract() -> None:
    deep = [s for s in scopes() if s.p_NB[2] > 1.0][:6]
    for output in ("counts", "pressure", "complex"):
        check_sensor(SideScanConfig(output=output, rate_hz=10, bins=16, rays_vertical=16), instants=deep)


@pytest.mark.parametrize("r", [8.0, 12.0, 18.0, 28.0, 42.0])
def test_a_flat_bottom_has_the_level_of_the_sonar_equation(facing: Any, r: float) -> None:
    instant = facing(BOTTOM)
    k = round(r / BIN)
    r = (k + 0.5) * BIN
    alpha, c = instant.water.absorption(LEVELS.frequency_hz, DEEP), instant.water.sound_speed(DEEP)
    width, height, grazing = rad(1.0), rad(50.0), math.asin(HEIGHT / r)
    along = integrate.quad(lambda a: two_way(np.array(a), width), -width, width)[0]
    cell = c / (2.0 * LEVELS.bandwidth_hz)
    area = along * r * cell / math.cos(grazing)
    strength = -27.0 + 20.0 * math.log10(math.sin(grazing)) + 10.0 * math.log10(area)
    pattern = 10.0 * math.log10(two_way(np.array(grazing - rad(20.0)), height))
    gain = 10.0 * math.log10(max(1.0, LEVELS.bandwidth_hz * LEVELS.pulse_s))
    level = LEVELS.source_level_db + gain - 40.0 * math.log10(r) - 2.0 * alpha * r + strength + pattern
    for side in rows(LEVELS, instant):
        assert 20.0 * math.log10(1e6 * side[k]) == pytest.approx(level, abs=0.5)


def test_both_sides_of_a_flat_bottom_are_equal(facing: Any) -> None:
    """In the mean of pings far from each other: neither side depends on what the other one hears."""
    sonar = NOISY.build(Pose())
    sonar.start(1)
    energy, mean = np.zeros(2), rows(LEVELS, facing(BOTTOM))[0][70:]
    for ping in range(60):
        sonar.begin(ping)
        _, values = sonar.measure(facing(BOTTOM, t_ns=ping * 10**9, p_NB=(5.0 * ping, 0.0, DEEP)))
        energy += [np.mean((value.array()[70:] / mean) ** 2) for value in values[-2:]]
    assert 10.0 * np.log10(energy[0] / energy[1]) == pytest.approx(0.0, abs=0.1)
    assert energy[0] / 60 == pytest.approx(1.0, abs=0.02)


def test_one_side_does_not_hear_the_other(facing: Any) -> None:
    wall = Plane((0.0, 20.0, 0.0), (0.0, -1.0, 0.0))
    port, starboard = rows(LEVELS, facing(wall))
    assert not port.any()
    assert int(starboard.argmax()) == pytest.approx(200, abs=2)
    turned = replace(facing(wall), q_NB=quat_from_rpy(0.0, 0.0, math.pi))
    assert rows(LEVELS, turned)[0] == pytest.approx(starboard, rel=1e-5, abs=1e-12)


def test_energy_does_not_depend_on_the_number_of_rays(facing: Any) -> None:
    totals = [
        10.0 * np.log10((rows(msgspec.structs.replace(LEVELS, rays_vertical=n), facing(BOTTOM))[0] ** 2.0).sum())
        for n in (192, 384, 2000)
    ]
    assert totals == pytest.approx([totals[-1]] * 3, abs=0.1)


def test_the_water_column_is_dark_up_to_the_bottom(facing: Any) -> None:
    port, _ = rows(NOISY, facing(BOTTOM))
    begin = round(HEIGHT / BIN)
    assert port[: begin - 2].max() < 1e-3 * port[begin : begin + 60].max()


def test_a_ball_throws_a_shadow_of_its_length(facing: Any) -> None:
    """Of a ball that lies on the bottom: behind it up to where the ray over its top meets the bottom, within a bin."""
    radius, away = 0.8, 15.0
    ball = Sphere((0.0, away, DEEP + HEIGHT - radius), radius)
    fine = msgspec.structs.replace(LEVELS, rays_vertical=2000, beam_width_horizontal_deg=0.5)
    lit, shaded = rows(fine, facing(BOTTOM))[1], rows(fine, facing(BOTTOM, ball))[1]
    to_centre = math.hypot(away, HEIGHT - radius)
    steep = math.atan2(HEIGHT - radius, away) - math.asin(radius / to_centre)
    begin = int((to_centre + 2.0 * radius) / BIN)
    dark = shaded[begin:] < 0.5 * lit[begin:]
    assert dark[0]
    assert (begin + int(np.flatnonzero(~dark)[0])) * BIN == pytest.approx(HEIGHT / math.sin(steep), abs=BIN)


def test_speckle_is_exponential_and_frozen_while_nothing_moves(facing: Any) -> None:
    sonar = NOISY.build(Pose())
    sonar.start(3)
    mean = rows(LEVELS, facing(BOTTOM))[0][70:]
    seen = []
    for ping, x in enumerate((0.0, 0.0, *(4.0 * k for k in range(1, 30)))):
        sonar.begin(ping)
        seen.append(sonar.measure(facing(BOTTOM, t_ns=ping * 10**9, p_NB=(x, 0.0, DEEP)))[1][-2].array()[70:] / mean)
    assert np.allclose(seen[0], seen[1], rtol=1e-3)
    assert abs(np.corrcoef(seen[1], seen[2])[0, 1]) < 0.2
    intensity = np.array(seen[1:])[:, ::7] ** 2.0
    assert stats.kstest(intensity.ravel(), "expon").pvalue > 0.01


def test_the_complex_echo_is_normal_and_has_the_amplitude_of_the_real_one(facing: Any) -> None:
    """Real and imaginary part of both sides: normal, each with half of the mean intensity, and independent."""
    config = msgspec.structs.replace(NOISY, output="complex")
    waves, amplitudes = rows(config, facing(BOTTOM), 3), rows(NOISY, facing(BOTTOM), 3)
    for wave, amplitude in zip(waves, amplitudes, strict=True):
        assert np.allclose(np.hypot(wave[:, 0], wave[:, 1]), amplitude, rtol=1e-4)
    mean = rows(LEVELS, facing(BOTTOM))[0][70:, None]
    sonar = config.build(Pose())
    sonar.start(5)
    parts = []
    for ping in range(30):
        sonar.begin(ping)
        values = sonar.measure(facing(BOTTOM, t_ns=ping * 10**9, p_NB=(4.0 * ping, 0.0, DEEP)))[1]
        parts += [value.array()[70:] / mean for value in values[-2:]]
    z = np.array(parts)[:, ::7]  # of bins that share no gate
    for part in (z[..., 0].ravel(), z[..., 1].ravel()):
        assert stats.kstest(part, stats.norm(scale=math.sqrt(0.5)).cdf).pvalue > 0.01
    assert abs(np.mean(z[..., 0] * z[..., 1])) < 4.0 * 0.5 / math.sqrt(z[..., 0].size)
    ideal = rows(msgspec.structs.replace(LEVELS, output="complex"), facing(BOTTOM))[0]
    assert np.allclose(ideal[70:, :1], mean, rtol=1e-5)
    assert not ideal[:, 1].any()


def test_counts_are_the_level_after_gain(facing: Any) -> None:
    instant = facing(BOTTOM)
    counted = msgspec.structs.replace(NOISY, output="counts", gain_db=3.0)
    pressure, counts = rows(NOISY, instant)[0], rows(counted, instant)[0]
    k = 200
    r = (k + 0.5) * BIN
    alpha = instant.water.absorption(NOISY.frequency_hz, DEEP)
    level = 20.0 * math.log10(1e6 * pressure[k]) + 30.0 * math.log10(r) + 2.0 * alpha * r + 3.0 - counted.floor_db
    assert counts.dtype == np.uint8
    assert counts[k] == pytest.approx(np.clip(level * 255.0 / 60.0, 0, 255), abs=1.0)


def test_water_that_scatters_fills_the_water_column(facing: Any) -> None:
    murky = msgspec.structs.replace(LEVELS, volume_backscatter_db=-60.0)
    clear, filled = rows(LEVELS, facing(BOTTOM))[0], rows(murky, facing(BOTTOM))[0]
    assert not clear[:50].any()
    assert filled[5:50].min() > 0.0


def test_a_ping_waits_for_the_last_one_and_comes_when_it_is_over(facing: Any) -> None:
    sonar = LEVELS.build(Pose())
    first = sonar.sense(facing(BOTTOM))
    assert first is not None
    c = facing().water.sound_speed(DEEP)
    assert first.delay_ns == round((100.0 / c + 0.02) * 1e9)
    assert sonar.sense(facing(BOTTOM, t_ns=round(100.0 / c * 1e9))) is None
    assert sonar.begins(100.0 / c + 0.005)


def test_a_sonar_that_turns_in_a_ping_smears_what_is_far(facing: Any) -> None:
    """What it sees at once abeam, it has turned away from when the echo of far things is back."""
    balls = Sphere((0.0, 8.0, DEEP + 2.0), 0.1), Sphere((0.0, 45.0, DEEP), 0.3)
    narrow = msgspec.structs.replace(LEVELS, rays_vertical=2000)
    still = rows(narrow, facing(*balls))[1]
    smeared = rows(narrow, facing(*balls, w_NB_B=(0.0, 0.0, 1.0)))[1]
    assert smeared[78:88].max() > 0.85 * still[78:88].max() > 0.0
    assert smeared[440:455].max() < 0.5 * still[440:455].max()
    assert still[440:455].max() > 1e-6 * still[78:88].max()  # it is seen, and not in the shadow of the near one


def test_a_wrong_sound_speed_stretches_ranges(facing: Any) -> None:
    wall = Plane((0.0, -20.0, 0.0), (0.0, 1.0, 0.0))
    c = facing().water.sound_speed(DEEP)
    port, _ = rows(msgspec.structs.replace(NOISY, assumed_sound_speed_mps=1.1 * c, bandwidth_hz=4e4), facing(wall))
    assert BIN * (int(port.argmax()) + 0.5) == pytest.approx(22.0, abs=0.25)


def test_in_air_it_hears_nothing_and_absurd_ranges_do_no_harm(facing: Any) -> None:
    valid, values = LEVELS.build(Pose()).measure(facing(p_NB=(0.0, 0.0, -1.0)))
    assert not valid
    assert values[-2:] == [None, None]
    wide = msgspec.structs.replace(LEVELS, min_range_m=1e-3, max_range_m=1e6)
    for range_m in (1e-3, 1e6):
        for side in rows(msgspec.structs.replace(wide, range_m=range_m), facing(BOTTOM)):
            assert np.isfinite(side).all()
    with pytest.raises(ValueError, match=r"range_m is .*, the (sonar|altimeter) takes"):
        SideScanConfig(rate_hz=1, range_m=1000.0)


def test_its_cost_is_counted_by_the_rays_that_it_casts() -> None:
    """What check tells: all rays, above the horizon too."""
    config = SideScanConfig(rate_hz=10, rays_vertical=100)
    sides = Sides(0.02, 0.8, 0.3, 100)
    assert config.computing_s == cost(sides.columns, sides.rows, 2, config.bins)
    assert len(sides.grid.direction) == sides.columns * sides.rows
