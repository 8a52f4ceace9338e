"""The channel of a water column: the case that showed it wrong, who is heard first and loudest, losses on the way, and its layers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ray_rig import channel, shoot, thermocline

from uwserver.environment.acoustics.boundaries import SEDIMENTS, Boundaries, bottom_loss
from uwserver.environment.acoustics.channel import Channel, channel_of, first, strongest
from uwserver.environment.column import ThermoclineColumn, WaterColumn

COLUMN = WaterColumn(
    ThermoclineColumn(surface_temperature_degc=18.0, deep_temperature_degc=6.0, depth_m=40.0, thickness_m=20.0),
    9.81,
    1025.0,
)


def test_no_sound_comes_earlier_than_any_path():
    """2.5 km between 80 and 85 m within a thermocline: the arc of the gradient between the ends would be there 0.3 s too early, where no water is
    quick enough. Rays go over it, as integrated ones tell."""

    def deep(z):
        return thermocline(z - 40.0)

    paths = channel(deep, 200.0, 0.05).paths(2500.0, 80.0, 85.0, Boundaries(200.0))
    shots = shoot(deep, 200.0, 2500.0, 80.0, 85.0, 1, 0.3, 1600, 5.0)
    assert [path.time for path in paths if path.surface + path.bottom < 2] == pytest.approx(
        [shot.time for shot in shots], abs=1e-6
    )
    assert paths[0].time > 2500.0 / float(deep(np.arange(0.0, 200.0, 0.1))[0].max())


def test_fewer_layers_are_as_good():
    """Those of a column against all points of its table: to a microsecond at a kilometre."""
    few, all_points = channel_of(COLUMN, 26e3), channel_of(COLUMN, 26e3, 0.0)
    for x, a, b in ((500.0, 5.0, 150.0), (1000.0, 20.0, 60.0), (300.0, 60.0, 62.0)):
        sides = Boundaries(200.0)
        ours, theirs = few.paths(x, a, b, sides), all_points.paths(x, a, b, sides)
        assert len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            assert one.time == pytest.approx(other.time, abs=1e-6)
            assert one.dip_b == pytest.approx(other.dip_b, abs=math.pi / 180.0 / 100.0)


def test_straight_lines_take_longer_than_rays_but_for_lines_through_still_water():
    sea = channel_of(COLUMN, 26e3)
    assert sea.paths(600.0, 5.0, 150.0)[0].time < sea.straight(600.0, 5.0, 150.0).time
    still = Channel(np.array([0.0, 100.0]), np.array([1500.0, 1500.0]), 26e3, np.array([0.01, 0.01]))
    line, ray = still.straight(300.0, 10.0, 50.0), still.paths(300.0, 10.0, 50.0)[0]
    assert tuple(line)[:5] == pytest.approx(tuple(ray)[:5], rel=1e-9)
    assert still.straight(200.0, 30.0, 30.0).time == pytest.approx(200.0 / 1500.0, rel=1e-14)


def test_losses_add_up():
    """Absorption along the way; the bottom's coefficient at the grazing angle; a rough surface's; once for each reflection."""
    still = Channel(np.array([0.0, 100.0]), np.array([1500.0, 1500.0]), 26e3, np.array([0.004, 0.004]))
    sides = Boundaries(100.0, SEDIMENTS["sand"], 0.005)
    k = 2.0 * math.pi * 26e3 / 1500.0
    for path in still.paths(400.0, 20.0, 60.0, sides, 3):
        length = path.time * 1500.0
        angle = math.acos(400.0 / length)
        surface = 20.0 * math.log10(math.e) * 2.0 * (k * 0.005 * math.sin(angle)) ** 2
        expected = path.surface * surface + path.bottom * bottom_loss(angle, SEDIMENTS["sand"])
        assert path.reflection == pytest.approx(expected, abs=1e-6)
        assert path.loss == pytest.approx(20.0 * math.log10(length) + 0.004 * length + expected, abs=1e-4)


def test_absorption_of_layers_is_that_on_the_way():
    """Straight down through water that absorbs more and more: its mean times the depth."""
    sea = Channel(np.array([0.0, 100.0, 200.0]), np.full(3, 1500.0), 26e3, np.array([0.0, 0.01, 0.03]))
    assert sea.paths(0.0, 0.0, 200.0, order=0)[0].absorption == pytest.approx(0.5 * 1.0 + 2.0, rel=1e-9)
    assert sea.paths(0.0, 50.0, 100.0, order=0)[0].absorption == pytest.approx(0.375, rel=1e-9)


def test_first_and_strongest():
    paths = channel_of(COLUMN, 26e3).paths(2500.0, 80.0, 85.0, Boundaries(200.0))
    earliest, loudest = first(paths), strongest(paths)
    assert earliest is paths[0]
    assert loudest is not None
    assert loudest.loss == min(path.loss for path in paths) < paths[0].loss
    later = first(paths, paths[0].loss - 1.0)
    assert later is not None
    assert later.time > paths[0].time
    assert first(paths, 20.0) is None
    assert strongest(paths, 20.0) is None
    assert strongest((), math.inf) is None
