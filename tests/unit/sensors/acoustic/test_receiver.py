"""From an instant to what beams hear: ranges, ghosts, second-time-around, volume, and the mean against the random."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.acoustic.imaging import speckle
from uwserver.sensors.acoustic.imaging.fan import Swath
from uwserver.sensors.acoustic.receiver import (
    BOTTOM_LOSS_DB,
    SURFACE_LOSS_DB,
    Echoes,
    Noise,
    Paths,
    Pulse,
    Water,
    gain_over_range,
    hear,
    ranges,
)
from uwserver.testing import FakeGeometry
from uwserver.testing.fake_geometry import Plane, Sphere

DEG = math.pi / 180.0
SWATH = Swath(40 * DEG, 2 * DEG, 20 * DEG, 40, 64)
PULSE = Pulse(200.0, 1e-4, 2e4, 40.0)
RANGES = ranges(20.0, 200, 1500.0, 1.0, PULSE)
WATER = Water(0.1, 0.0, 1000.0, np.array([10**-2.7]))
AHEAD = np.eye(3)
STRAIGHT = Paths()


def energy(*shapes: Plane | Sphere, paths: Paths = STRAIGHT, water: Water = WATER) -> np.ndarray:
    return Echoes(SWATH, 200).energy(FakeGeometry(shapes), water, (0.0, 0.0, 0.0), AHEAD, RANGES, paths)


def test_a_receiver_filters_to_its_bins() -> None:
    fine = ranges(20.0, 200, 1500.0, 1.0, PULSE._replace(bandwidth=1e6))
    assert fine.gates.window == 1.0  # 0.75 mm would fit many times into 10 cm
    assert fine.level == pytest.approx(10**20.0 * 7500.0 * 1e-4 if 7500.0 * 1e-4 > 1.0 else 10**20.0)
    assert fine.noise == pytest.approx(10**4.0 * 7500.0)
    coarse = ranges(2.0, 200, 1500.0, 1.0, PULSE)  # 37.5 mm in bins of 10
    assert coarse.gates.window == pytest.approx(3.75)
    assert coarse.noise * coarse.gates.window == pytest.approx(10**4.0 * 2e4)
    wrong = ranges(20.0, 200, 1500.0, 1.1, PULSE)  # the device believes sound to be faster: a bin is shorter
    assert wrong.gates.per_metre == pytest.approx(11.0)


def test_a_wall_is_at_its_range_and_in_all_columns() -> None:
    found = energy(Plane((12.34, 0.0, 0.0), (-1.0, 0.0, 0.0)))
    middle = SWATH.columns // 2
    assert int(np.flatnonzero(found[middle] > 0.0)[0]) == 123
    assert (found.sum(axis=1)[8:-8] > 0.0).all()


def test_ghosts_are_where_the_mirror_shows_them() -> None:
    """A ball 1 m below a calm surface, seen by a sonar at 2 m: its image is 3 m above the level of the sonar. And of a bottom likewise."""
    ball, water = Sphere((10.0, 0.0, -1.0), 0.5), WATER._replace(height=2.0)
    plain = energy(ball, water=water)
    ghosts = energy(ball, water=water, paths=Paths(surface=True))
    more = (ghosts - plain).sum(axis=0)
    wanted = math.hypot(10.0, 3.0) - 0.5
    assert np.flatnonzero(more > 0.02 * more.max())[0] / 10.0 == pytest.approx(wanted, abs=0.15)
    assert np.array_equal(energy(ball, paths=Paths(surface=True)), energy(ball))  # no surface in sight
    bottom = Plane((0.0, 0.0, 2.0), (0.0, 0.0, -1.0))
    under = Sphere((10.0, 0.0, 1.0), 0.5)
    by_bottom = energy(under, bottom, paths=Paths(bottom=True)) - energy(under, bottom)
    lower = by_bottom.sum(axis=0)
    assert np.flatnonzero(lower > 0.02 * lower.max())[0] / 10.0 == pytest.approx(wanted, abs=0.15)
    # Twice through the mirror costs twice its loss.
    assert by_bottom.sum() / more.sum() == pytest.approx(10 ** (0.2 * (SURFACE_LOSS_DB - BOTTOM_LOSS_DB)), rel=0.2)


def test_what_comes_of_the_ping_before() -> None:
    wall = Plane((35.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    assert energy(wall).sum() == 0.0
    again = energy(wall, paths=Paths(again=25.0))
    assert int(np.flatnonzero(again[SWATH.columns // 2] > 0.0)[0]) in (99, 100)
    near = Plane((35.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    true = Echoes(SWATH, 400).energy(
        FakeGeometry([near]), WATER, (0.0, 0.0, 0.0), AHEAD, ranges(40.0, 400, 1500.0, 1.0, PULSE), Paths()
    )
    assert again.sum() == pytest.approx(true.sum(), rel=0.02)  # as weak as from its true range


def test_water_that_scatters_follows_its_equation() -> None:
    water = WATER._replace(scattering=1e-6, alpha=0.0)
    column = energy(water=water)[SWATH.columns // 2]
    solid = SWATH.grid.cells["emitted"].reshape(64, -1)[:, SWATH.columns // 2].sum()
    r = (np.arange(200) + 0.5) / 10.0
    assert np.allclose(column[:200], RANGES.level * 1e-6 * solid * 0.1 / r**2, rtol=1e-6)


def test_the_mean_of_what_is_heard_is_the_mean() -> None:
    found = energy(Plane((0.0, 0.0, 4.0), (0.0, 0.0, -1.0)))
    mean = hear(SWATH, found, RANGES, None)[0]
    total = np.zeros_like(mean, dtype=float)
    for k in range(60):
        faded, share = speckle.fading((50.0 * k, 30.0 * k, 0.0), np.array((1.0, 0.0, 0.0)), 0.1, 0.1)
        sound = hear(SWATH, found, RANGES._replace(noise=0.0), Noise(7, k, faded, share))
        total += (sound.astype(float) ** 2).sum(axis=0) / 60
    loud = mean > 0.1 * mean.max()
    assert 10.0 * np.log10(total[loud].sum() / mean[loud].sum()) == pytest.approx(0.0, abs=0.15)


def test_gain_over_range() -> None:
    gain = gain_over_range(10.0, 10, 30.0, 0.2, 25.0)
    assert gain[0] == pytest.approx(30.0 * math.log10(0.5) + 0.2)
    assert gain[-1] == 25.0
