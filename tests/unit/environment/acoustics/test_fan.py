"""The fan of a profile: its ways and delays against rays followed layer by layer, and searches with it against searches without."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ray_rig import channel, duct, munk, thermocline

from uwserver.environment.acoustics import fan
from uwserver.environment.acoustics.boundaries import Boundaries
from uwserver.environment.acoustics.channel import Channel
from uwserver.environment.acoustics.layers import leg, medium


def test_ways_and_delays_are_sums_of_layers():
    depth = np.array([0.0, 10.0, 40.0, 100.0, 250.0])
    speed = np.array([1500.0, 1500.0, 1482.0, 1479.0, 1490.0])
    turning, row, way, delay = fan.make_fan(depth, speed)
    assert turning[row] == pytest.approx(speed, abs=0.0)
    m = medium(depth, speed, np.zeros(5), 40.0, 100.0, math.inf)
    checked = 0
    for c, ways, late in zip(turning, way, delay, strict=True):
        if c <= speed.max() or c > 1e9:
            continue
        p, theta = 1.0 / c, math.acos(m.fastest / c)
        for begin, end in ((0, 4), (1, 3), (2, 3)):
            whole = leg(m, p, math.sin(theta) ** 2, begin, end)
            assert ways[end] - ways[begin] == pytest.approx(whole.x, rel=1e-9)
            assert late[end] - late[begin] == pytest.approx(whole.time - p * whole.x, rel=1e-9)
            checked += 1
    assert checked > 30


def test_neighbours_are_near():
    """Wherever between nodes the ends lie, rays that turn are at most WIDEST apart there."""
    turning = fan.make_fan(np.array([0.0, 100.0, 300.0]), np.array([1450.0, 1520.0, 1490.0]))[0]
    slow = turning[turning <= 1520.0]
    assert np.all(np.arccos(slow[:-1] / slow[1:]) <= fan.WIDEST * (1.0 + 1e-9))
    assert np.all(np.diff(turning) > 0.0)


def _seas(rng):
    for speed in (munk, duct, thermocline):
        yield channel(speed, 200.0, 1.0)
    for k in range(60):
        n = int(rng.integers(3, 60))
        depth = np.concatenate(((0.0,), np.sort(rng.uniform(0.5, 400.0, n - 1))))
        speed = 1500.0 + (np.cumsum(rng.normal(0.0, 1.5, n)) if k % 2 else np.round(rng.normal(0.0, 3.0, n)))
        yield Channel(depth, speed, 26e3)


def test_the_same_rays_with_and_without_it(monkeypatch):
    """756 searches in 63 seas: all rays and the first alone, from the fan's table and from layers that are added up anew, in which no bound of a
    time drops a ray."""
    rng, found, silent = np.random.default_rng(3), 0, 0
    for sea in _seas(rng):
        plain = Channel(sea._depth, sea._speed, 26e3)
        with monkeypatch.context() as patched:
            turning, row, *_ = sea._fan
            none = np.zeros((0, 0))
            patched.setattr(plain, "_fan", (turning, row, none, none))
            for k in range(12):
                x, a, b = rng.uniform(1.0, 4000.0), *rng.uniform(0.0, 180.0, 2)
                sides, order = Boundaries(math.inf if k % 3 == 0 else rng.uniform(180.0, 390.0)), k % 4
                b = a if k == 5 else b
                ours, theirs = sea.paths(x, a, b, sides, order), plain.paths(x, a, b, sides, order)
                assert len(ours) == len(theirs)
                for one, other in zip(ours, theirs, strict=True):
                    assert one.time == pytest.approx(other.time, abs=1e-12)
                    assert (one.surface, one.bottom, one.turns) == (other.surface, other.bottom, other.turns)
                assert sea.earliest(x, a, b, sides, order) == (ours[0] if ours else None)
                found, silent = found + len(ours), silent + (not ours)
    assert found > 1500
    assert silent < 150


def test_a_profile_too_fine_for_a_table_is_searched_all_the_same():
    fine = channel(duct, 150.0, 0.1)
    assert fine._fan[2].size == 0
    (ours, theirs) = (sea.earliest(1500.0, 50.0, 75.0, Boundaries(150.0)) for sea in (fine, channel(duct, 150.0, 0.5)))
    assert ours.time == pytest.approx(theirs.time, abs=1e-6)
