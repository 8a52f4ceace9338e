"""The profiling sonar: ranges of walls and bottoms, the steps of its head, the first echo and the strongest."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from uwserver.frames import quat_from_rpy
from uwserver.sensors import Pose, ProfilerConfig
from uwserver.testing import FakeGeometry, check_sensor
from uwserver.testing.fake_geometry import Plane, Sphere
from uwserver.testing.sensors import scopes
from uwserver.units import rad

DEEP = 1000.0
NOISY = ProfilerConfig(rate_hz=20)
IDEAL = structs.replace(NOISY, ideal=True)
BIN = NOISY.range_m / NOISY.bins
DOWN = quat_from_rpy(0.0, -0.5 * math.pi, 0.0)


@pytest.fixture
def facing(scope: Any) -> Any:
    """`facing(shape, ..., **state)`: deep below the surface."""

    def build(*shapes: Any, **state: Any) -> Any:
        made = scope(**{"p_NB": (0.0, 0.0, DEEP), **state})
        made.geometry = FakeGeometry(shapes)
        return made

    return build


def wall(away: float) -> Plane:
    return Plane((away, 0.0, 0.0), (-1.0, 0.0, 0.0))


def ping(sonar: Any, instant: Any) -> dict[str, Any]:
    _, values = sonar.measure(instant)
    return {field.name: value for field, value in zip(sonar.fields, values, strict=True)}


def built(config: ProfilerConfig, mount: Pose | None = None) -> Any:
    sonar = config.build(mount or Pose())
    sonar.start(0)
    return sonar


def test_contract() -> None:
    deep = [s for s in scopes() if s.p_NB[2] > 1.0][:6]
    walls = FakeGeometry([Plane((x, 0.0, 0.0), (-x, 0.0, 0.0)) for x in (-8.0, 8.0)])
    near = [replace(s, geometry=walls) for s in deep]
    check_sensor(ProfilerConfig(rate_hz=10, bins=64, sector_width_deg=30.0), instants=near)


@pytest.mark.parametrize("away", [1.0, 3.0, 7.0, 13.0, 19.0])
@pytest.mark.parametrize("config", [IDEAL, NOISY])
def test_a_wall_ahead_is_found_within_the_resolution(facing: Any, config: ProfilerConfig, away: float) -> None:
    resolution = facing().water.sound_speed(DEEP) / (2.0 * config.bandwidth_hz)
    found = ping(built(config), facing(wall(away)))
    assert found["range"] == pytest.approx(away, abs=resolution)
    assert found["quality"] > 0.99


def test_the_level_is_that_of_the_sonar_equation(facing: Any) -> None:
    """A bottom under a slant beam that is longer than the resolution: mean level over the window, of a beam that lies over it."""
    away = 10.0
    alpha, c = facing().water.absorption(IDEAL.frequency_hz, DEEP), facing().water.sound_speed(DEEP)
    config = structs.replace(IDEAL, bandwidth_hz=c / (2.0 * 4.0), pulse_s=1e-3)  # 4 m: all of the beam at once
    found = ping(built(config), facing(wall(away)))
    width = rad(config.beam_width_deg)
    x = np.linspace(-width, width, 4001)
    across = float(np.sum(np.sinc(0.885892 * x / width) ** 4) * (x[1] - x[0]))
    gain = 10.0 * math.log10(max(1.0, config.bandwidth_hz * config.pulse_s))
    area = 10.0 * math.log10((across * away) ** 2)
    expected = config.source_level_db + gain - 40.0 * math.log10(away) - 2.0 * alpha * away - 27.0 + area
    assert found["level"] == pytest.approx(expected, abs=1.0)


def test_the_head_steps_over_its_sector_to_and_fro_and_stands_without_one(facing: Any) -> None:
    sonar = built(structs.replace(NOISY, step_deg=10.0, sector_width_deg=40.0, sector_center_deg=5.0))
    angles = [math.degrees(ping(sonar, facing(wall(5.0), t_ns=k * 10**9))["head_angle"]) for k in range(10)]
    assert angles == pytest.approx([-15.0, -5.0, 5.0, 15.0, 25.0, 15.0, 5.0, -5.0, -15.0, -5.0])
    still = built(NOISY)
    assert {ping(still, facing(wall(5.0), t_ns=k * 10**9))["head_angle"] for k in range(4)} == {0.0}
    around = built(structs.replace(NOISY, step_deg=30.0, sector_width_deg=360.0))
    assert len({round(ping(around, facing(t_ns=k * 10**9))["head_angle"], 6) for k in range(24)}) == 12


def test_a_sector_across_the_way_draws_the_profile_of_the_bottom(facing: Any) -> None:
    bottom = Plane((0.0, 0.0, DEEP + 8.0), (0.0, 0.0, -1.0))
    sonar = built(structs.replace(NOISY, step_deg=5.0, sector_width_deg=100.0), Pose((0.0, 0.0, 0.0), DOWN))
    for k in range(21):
        found = ping(sonar, facing(bottom, t_ns=k * 10**9, p_NB=(5.0 * k, 0.0, DEEP)))
        assert found["range"] * math.cos(found["head_angle"]) == pytest.approx(8.0, rel=0.02)


def test_to_starboard_is_a_positive_angle(facing: Any) -> None:
    starboard = Plane((0.0, 6.0, 0.0), (0.0, -1.0, 0.0))
    sonar = built(structs.replace(IDEAL, sector_center_deg=90.0), Pose((0.0, 0.0, 0.0), DOWN))
    assert ping(sonar, facing(starboard))["range"] == pytest.approx(6.0, abs=2.0 * BIN)


def test_the_first_echo_or_the_strongest(facing: Any) -> None:
    """A ball at the edge of the beam before a wall."""
    things = Sphere((6.0, 0.08, DEEP), 0.02), wall(12.0)
    fine = structs.replace(IDEAL, rays=24)
    assert ping(built(fine), facing(*things))["range"] == pytest.approx(12.0, abs=2.0 * BIN)
    first = structs.replace(fine, detection="first")
    assert ping(built(first), facing(*things))["range"] == pytest.approx(6.0, abs=3.0 * BIN)


def test_without_an_echo_range_and_level_are_missing(facing: Any) -> None:
    for instant in (facing(), facing(wall(30.0)), facing(p_NB=(0.0, 0.0, -2.0))):
        valid, values = built(NOISY).measure(instant)
        assert not valid
        assert values[5:] == [None, None, 0.0]
    near = built(structs.replace(NOISY, min_range_m=3.0))
    assert not near.measure(facing(wall(2.0)))[0]


def test_a_ping_waits_for_the_last_one_and_is_delivered_when_it_is_over(facing: Any) -> None:
    sonar = built(structs.replace(NOISY, overhead_s=0.005))
    reading = sonar.sense(facing(wall(5.0)))
    duration = 2.0 * NOISY.range_m / facing().water.sound_speed(DEEP)
    assert reading.delay_ns == round(duration * 1e9)
    assert sonar.sense(facing(wall(5.0), t_ns=round(duration * 1e9))) is None
    assert sonar.sense(facing(wall(5.0), t_ns=round((duration + 0.006) * 1e9))) is not None


def test_steps_and_sectors_have_limits(facing: Any) -> None:
    sonar = built(NOISY)
    sonar.change({"sector_width": 0.0, "step": 0.1, "range": 5.0})
    assert sonar.properties()["sector_width"] == 0.0
    limits = {argument.name: (argument.minimum, argument.maximum) for argument in sonar.arguments}
    assert limits["sector_width"] == (0.0, 2.0 * math.pi + 1e-9)
    assert limits["range"] == (0.4, 40.0)
    with pytest.raises(ValueError, match="more than a full turn"):
        ProfilerConfig(rate_hz=1, sector_width_deg=361.0)
