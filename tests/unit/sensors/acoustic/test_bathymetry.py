"""The bathymetric multibeam echosounder: ranges of level and sloping bottoms, what it says without an echo, and what it is asked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from uwserver.frames import quat_from_rpy
from uwserver.sensors import BathymetryConfig, Pose
from uwserver.sensors.acoustic.imaging.fan import Swath, cost
from uwserver.sensors.acoustic.imaging.soundings import HEARD, bands
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.testing.sensors import scopes
from uwserver.units import rad

DEEP = 1000.0
FIELDS = ("angle", "range", "quality", "hits", "level", "method")
NOISY = BathymetryConfig(rate_hz=5, beams=128, max_range_m=200.0)
IDEAL = structs.replace(NOISY, ideal=True)


@pytest.fixture
def over(scope: Any) -> Any:
    """`over(shape, ..., **state)`: deep below the surface, over some shapes."""

    def build(*shapes: Any, **state: Any) -> Any:
        made = scope(**{"p_NB": (0.0, 0.0, DEEP), **state})
        made.geometry = FakeGeometry(shapes)
        return made

    return build


def level(depth: float, slope: float = 0.0) -> Plane:
    """A bottom so far below, that falls (rad) to starboard."""
    return Plane((0.0, 0.0, DEEP + depth), (0.0, math.sin(slope), -math.cos(slope)))


def swath(config: BathymetryConfig, instant: Any, sonar: Any = None) -> dict[str, np.ndarray]:
    """A ping."""
    if sonar is None:
        sonar = config.build(Pose())
        sonar.start(0)
    valid, values = sonar.measure(instant)
    assert valid
    return {name: value.array().astype(float) for name, value in zip(FIELDS, values[4:], strict=True)}


def pings(config: BathymetryConfig, over: Any, *shapes: Any, count: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Angles (beams) and ranges (pings, beams), of places far from each other."""
    sonar = config.build(Pose())
    sonar.start(0)
    found = []
    for k in range(count):
        sonar.begin(k)
        found.append(swath(config, over(*shapes, t_ns=k * 10**9, p_NB=(20.0 * k, 0.0, DEEP)), sonar))
    return found[0]["angle"], np.array([ping["range"] for ping in found])


def test_contract() -> None:
    deep = [s for s in scopes() if s.p_NB[2] > 1.0][:6]
    check_sensor(BathymetryConfig(rate_hz=10, bins=32, beams=8, rays_along=4), instants=deep)


@pytest.mark.parametrize("depth", [4.0, 8.0, 15.0, 25.0, 40.0])
def test_a_level_bottom_is_found_within_the_resolution(over: Any, depth: float) -> None:
    """Of the mean echo: in all beams to 64 degrees, where one lies over 13 % of its range."""
    config = structs.replace(IDEAL, range_m=3.6 * depth)
    found = swath(config, over(level(depth)))
    error = found["range"] - depth / np.cos(found["angle"])
    resolution = config.range_m / config.bins
    assert np.abs(error[np.abs(found["angle"]) < rad(64.0)]).max() < resolution
    assert np.abs(error).max() < 0.02 * config.range_m
    assert found["quality"].min() > 0.99


def test_the_mean_of_noisy_pings_is_the_bottom_also_in_outer_beams(over: Any) -> None:
    """Amplitude alone: what a beam lies over is told within a part of its length, and right in the mean of twelve pings."""
    depth, config = 15.0, structs.replace(NOISY, range_m=54.0, detection="amplitude")
    angle, ranges = pings(config, over, level(depth))
    true = depth / np.cos(angle)
    resolution = config.range_m / config.bins
    inner, outer = np.abs(angle) < rad(45.0), np.abs(np.abs(angle) - rad(60.0)) < rad(4.0)
    assert np.abs(ranges.mean(axis=0) - true)[inner].max() < resolution
    assert np.abs(np.mean((ranges - true)[:, outer])) < resolution
    # Of r tan(angle) times the width of the beam, which is 1 / cos wider there.
    lies_over = (true * np.tan(np.abs(angle)) * rad(1.0) / np.cos(angle))[outer]
    assert np.all(ranges.std(axis=0)[outer] < 0.35 * lies_over)


@pytest.mark.parametrize("taper", ["hamming", "cosine", "none"])
def test_phases_tell_the_outer_beams_of_a_level_bottom_better(over: Any, taper: Any) -> None:
    """At 60 degrees within a quarter of the error of amplitudes, with no bias above half a bin; no beam gets worse, and no error is an outlier."""
    depth, config = 15.0, structs.replace(NOISY, range_m=54.0, taper=taper)
    bin_m = config.range_m / config.bins
    errors, methods = {}, {}
    for detection in ("amplitude", "phase"):
        sonar = structs.replace(config, detection=detection).build(Pose())
        sonar.start(0)
        found = []
        for k in range(12):
            sonar.begin(k)
            found.append(swath(config, over(level(depth), t_ns=k * 10**9, p_NB=(20.0 * k, 0.0, DEEP)), sonar))
        errors[detection] = np.array([ping["range"] for ping in found]) - depth / np.cos(found[0]["angle"])
        methods[detection] = np.array([ping["method"] for ping in found])
    angle = np.abs(found[0]["angle"])
    outer, inner = np.abs(angle - rad(60.0)) < rad(4.0), angle < rad(20.0)
    spread = {detection: float(np.std(error[:, outer])) for detection, error in errors.items()}
    assert spread["phase"] < 0.25 * spread["amplitude"]
    assert abs(errors["phase"][:, outer].mean()) < 0.5 * bin_m
    assert np.abs(errors["phase"][:, outer]).max() < 0.5 * np.abs(errors["amplitude"][:, outer]).max()
    assert np.std(errors["phase"][:, inner]) < 1.05 * np.std(errors["amplitude"][:, inner])
    assert set(np.unique(methods["amplitude"])) == {1.0}
    assert np.mean(methods["phase"][:, outer] == 2) > 0.97
    assert np.mean(methods["phase"][:, inner] == 1) > 0.97


def test_phases_tell_the_outer_beams_over_a_slope(over: Any) -> None:
    slope, depth = rad(12.0), 12.0
    sonar = structs.replace(NOISY, range_m=54.0).build(Pose())
    sonar.start(0)
    errors = []
    for k in range(12):
        sonar.begin(k)
        found = swath(NOISY, over(level(depth, slope), t_ns=k * 10**9, p_NB=(20.0 * k, 0.0, DEEP)), sonar)
        errors.append(found["range"] - depth * math.cos(slope) / np.cos(found["angle"] + slope))
    outer = np.abs(found["angle"] + rad(60.0)) < rad(4.0)
    downhill = np.abs(found["angle"] - rad(45.0)) < rad(4.0)
    for beams in (outer, downhill):
        assert np.abs(np.mean(np.array(errors)[:, beams])) < 0.5 * 54.0 / 512
        assert np.std(np.array(errors)[:, beams]) < 0.1


def test_a_slope_is_found(over: Any) -> None:
    slope, depth = rad(12.0), 15.0
    found = swath(structs.replace(IDEAL, range_m=60.0), over(level(depth, slope)))
    true = depth * math.cos(slope) / np.cos(found["angle"] + slope)
    near = true < 45.0
    assert near.sum() > 100
    assert np.abs(found["range"] - true)[near].max() < 2.0 * 60.0 / 512
    # At right angles to a slope the level is highest.
    assert found["angle"][np.nanargmax(found["level"])] == pytest.approx(-slope, abs=rad(8.0))


def test_beams_are_of_the_sensor_not_of_the_world(over: Any) -> None:
    rolled = swath(structs.replace(IDEAL, range_m=60.0), over(level(15.0), q_NB=quat_from_rpy(rad(10.0), 0.0, 0.0)))
    near = np.abs(rolled["angle"]) < rad(40.0)
    # Starboard down: what points at an angle to starboard points 10 degrees less from the vertical.
    assert rolled["range"][near] == pytest.approx(15.0 / np.cos(rolled["angle"][near] - rad(10.0)), abs=0.2)


def test_a_ball_on_the_bottom_is_seen_by_the_beams_that_meet_it(over: Any) -> None:
    ball = Sphere((0.0, 4.0, DEEP + 14.0), 1.0)
    config = structs.replace(IDEAL, range_m=40.0)
    plain, with_ball = (swath(config, over(*shapes))["range"] for shapes in ((level(15.0),), (level(15.0), ball)))
    nearer = plain - with_ball
    meets = np.abs(swath(config, over(level(15.0)))["angle"] - math.atan2(4.0, 14.0)) < rad(2.0)
    assert nearer[meets].min() > 0.5
    assert np.abs(nearer[:50]).max() < 1e-3


def test_where_nothing_is_there_is_no_echo(over: Any) -> None:
    for config in (IDEAL, NOISY):
        found = swath(config, over())
        assert np.isnan(found["range"]).all()
        assert np.isnan(found["level"]).all()
        assert not found["hits"].any()
        assert not found["quality"].any()
        assert not found["method"].any()


def test_a_bottom_that_noise_hides_is_of_less_quality(over: Any) -> None:
    loud = structs.replace(NOISY, range_m=54.0, noise_level_db=102.0, threshold_db=10.0)
    quiet, hidden = (swath(config, over(level(15.0))) for config in (structs.replace(NOISY, range_m=54.0), loud))
    assert quiet["quality"].min() > 0.99
    assert np.nanmean(hidden["quality"][:20]) < 0.98
    deaf = swath(structs.replace(loud, noise_level_db=130.0), over(level(15.0)))
    assert (deaf["hits"] == 0).mean() > 0.9


def test_what_is_nearer_than_it_listens_is_not_heard(over: Any) -> None:
    found = swath(structs.replace(IDEAL, min_range_m=10.0, range_m=40.0), over(level(6.0)))
    steep = np.abs(found["angle"]) < rad(50.0)
    assert not found["hits"][steep].any()


def test_a_lower_gain_needs_stronger_echoes(over: Any) -> None:
    sonar = structs.replace(NOISY, range_m=54.0, noise_level_db=90.0).build(Pose())
    sonar.start(0)
    before = swath(NOISY, over(level(15.0)), sonar)["hits"]
    sonar.change({"gain": -40.0})
    after = swath(NOISY, over(level(15.0), t_ns=10**9), sonar)["hits"]
    assert (after > 0).sum() < 0.5 * (before > 0).sum()


def test_a_wrong_sound_speed_stretches_ranges(over: Any) -> None:
    c = over().water.sound_speed(DEEP)
    found = swath(structs.replace(NOISY, assumed_sound_speed_mps=1.1 * c, range_m=54.0), over(level(15.0)))
    middle = np.abs(found["angle"]) < rad(20.0)
    assert found["range"][middle] == pytest.approx(16.5 / np.cos(found["angle"][middle]), abs=0.4)


def test_in_air_it_hears_nothing_and_absurd_ranges_do_no_harm(over: Any) -> None:
    valid, values = NOISY.build(Pose()).measure(over(p_NB=(0.0, 0.0, -1.0)))
    assert not valid
    assert values[4:] == [None] * 6
    for range_m in (1e-3, 1e6):
        wide = structs.replace(NOISY, min_range_m=1e-3, max_range_m=1e6, range_m=range_m)
        assert not np.isinf(swath(wide, over(level(15.0)))["range"]).any()
    with pytest.raises(ValueError, match=r"range_m is .*, the (sonar|altimeter) takes"):
        BathymetryConfig(rate_hz=1, range_m=1000.0)
    with pytest.raises(ValueError, match="rays a ping are more than"):
        BathymetryConfig(rate_hz=1, beam_width_across_deg=0.1, rays_along=256)


def test_its_cost_is_counted_by_the_columns_that_its_beams_hear() -> None:
    config = BathymetryConfig(rate_hz=10)
    swath = Swath(rad(config.field_deg), rad(config.beam_width_across_deg), 0.02, config.beams, config.rays_along)
    heard = np.diff(bands(swath.pattern)).mean()
    assert heard == pytest.approx(HEARD, rel=0.05)
    by_amplitude = structs.replace(config, detection="amplitude")
    assert by_amplitude.computing_s == cost(swath.columns, swath.rows, config.beams, config.bins, HEARD)
    assert config.computing_s == cost(swath.columns, swath.rows, 2 * config.beams, config.bins, HEARD)
