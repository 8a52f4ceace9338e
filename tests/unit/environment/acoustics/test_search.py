"""All rays of a layered sea against rays that are shot: the same number, and each with its time, its angles and its level."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ray_rig import channel, duct, munk, shoot, still, thermocline

from uwserver.environment.acoustics import search
from uwserver.environment.acoustics.boundaries import Boundaries
from uwserver.environment.acoustics.channel import Channel

MICROSECOND, CENTIDEGREE = 1e-6, math.pi / 180.0 / 100.0


@pytest.mark.parametrize(
    ("speed", "bottom", "x", "a", "b", "order", "widest", "rays", "step", "spacing"),
    [
        (still, 100.0, 1000.0, 20.0, 60.0, 2, 0.5, 200, 25.0, 50.0),
        pytest.param(munk, 5000.0, 60e3, 1000.0, 800.0, 2, 0.3, 600, 75.0, 2.0, marks=pytest.mark.slow),
        (duct, 150.0, 1500.0, 50.0, 75.0, 1, 0.25, 1000, 5.0, 0.05),
        (duct, 150.0, 1200.0, 55.0, 55.0, 0, 0.2, 800, 5.0, 0.05),
        (thermocline, 200.0, 2500.0, 80.0, 85.0, 1, 0.3, 1200, 5.0, 0.05),
        (thermocline, math.inf, 900.0, 60.0, 5.0, 2, 0.5, 500, 5.0, 0.05),
    ],
)
def test_against_a_fan_of_integrated_rays(speed, bottom, x, a, b, order, widest, rays, step, spacing):
    shots = shoot(speed, bottom, x, a, b, order, widest, rays, step)
    paths = [
        path
        for path in channel(speed, min(bottom, 400.0 if bottom > 1e4 else bottom), spacing).paths(
            x, a, b, Boundaries(bottom), order
        )
        if abs(path.dip_a) < widest
    ]
    assert len(paths) == len(shots) > 0
    for path, shot in zip(paths, shots, strict=True):
        assert path.time == pytest.approx(shot.time, abs=MICROSECOND)
        assert (path.dip_a, path.dip_b) == pytest.approx((shot.dip_a, shot.dip_b), abs=CENTIDEGREE)
        assert (path.surface, path.bottom) == (shot.surface, shot.bottom)
        assert path.spreading == pytest.approx(10.0 * math.log10(shot.area), abs=0.01)


@pytest.mark.parametrize("gradient", [0.017, -0.05, 0.3])
@pytest.mark.parametrize(
    ("x", "a", "b"), [(300.0, 210.0, 610.0), (2000.0, 900.0, 400.0), (1500.0, 500.0, 500.0), (2000.0, 500.0, 530.0)]
)
def test_constant_gradient_in_closed_form(gradient, x, a, b):
    """t = 2 asinh(g d / (2 sqrt(c_a c_b))) / g, the arc of a circle; also where it turns. Its tube has the area c_a c_b sinh^2(g t) / g^2, as
    of hyperbolic geometry."""
    grid = np.arange(0.0, 2001.0, 5.0)
    c_a, c_b = 1500.0 + gradient * a, 1500.0 + gradient * b
    path = Channel(grid, 1500.0 + gradient * grid, 26e3).paths(x, a, b, order=0)[0]
    g = abs(gradient)
    expected = 2.0 * math.asinh(g * math.sqrt((x * x + (b - a) ** 2) / (c_a * c_b)) / 2.0) / g
    assert path.time == pytest.approx(expected, rel=1e-11)
    assert math.cos(path.dip_a) / c_a == pytest.approx(math.cos(path.dip_b) / c_b, rel=1e-9)
    area = c_a * c_b * (math.sinh(g * expected) / g) ** 2
    assert path.spreading == pytest.approx(10.0 * math.log10(area), abs=1e-6)


@pytest.mark.parametrize(
    ("x", "a", "b"),
    [
        (1000.0, 20.0, 60.0),
        (1000.0, 40.0, 40.0),
        (5e3, 50.0, 50.001),
        (3.0, 5.0, 95.0),
        (0.0, 20.0, 60.0),
        (1e-6, 20.0, 60.0),
    ],
)
def test_images_in_water_of_one_speed(x, a, b):
    """Straight lines to the images in surface and bottom; spherical spreading."""
    depth, speed = np.array([0.0, 30.0, 5000.0]), np.full(3, 1500.0)
    paths = Channel(depth, speed, 26e3).paths(x, a, b, Boundaries(100.0), 3)
    drops = {(0, 0): b - a, (1, 0): -a - b, (0, 1): 200.0 - a - b, (2, 1): -200.0 - a - b, (1, 2): 400.0 - a - b}
    both = {200.0 + b - a, a - b - 200.0 + 2.0 * (b - a)}
    found = {}
    for path in paths:
        found.setdefault((path.surface, path.bottom), []).append(path)
    assert sorted(map(len, found.values())) == [1, 1, 1, 1, 1, 2]
    for kind, drop in drops.items():
        (path,) = found[kind]
        assert path.time == pytest.approx(math.hypot(x, drop) / 1500.0, rel=1e-13)
        assert path.dip_a == pytest.approx(math.atan2(drop, x), abs=1e-9)
        assert path.spreading == pytest.approx(20.0 * math.log10(math.hypot(x, drop)), abs=1e-5)
    assert sorted(path.time for path in found[(1, 1)]) == pytest.approx(
        sorted(math.hypot(x, drop) / 1500.0 for drop in both)
    )


def test_the_ray_that_turns_just_at_an_end():
    """It is found once, and so is each beside it, as of the kind that turns and of the kind that does not."""
    grid = np.array([0.0, 50.0, 100.0, 400.0])
    sea = Channel(grid, 1500.0 + np.array([0.0, 5.0, 10.0, 40.0]), 26e3)
    # A ray that leaves 50 m so that it turns at 100 m: half of the chord of a circle of radius c / g.
    x = math.sqrt((1510.0 / 0.1) ** 2 - (1505.0 / 0.1) ** 2)
    level = 10.0 * math.log10(1505.0 * 1510.0 * (x / 1505.0) ** 2)
    turned = []
    for distance in (x - 1.0, x * (1.0 - 1e-12), x, x * (1.0 + 1e-12), x + 1.0):
        (path,) = sea.paths(distance, 50.0, 100.0, order=0)
        assert path.dip_b == pytest.approx(0.0, abs=1e-2 if abs(distance - x) > 0.5 else 1e-6)
        assert path.spreading == pytest.approx(level, abs=0.01)
        turned.append(path.turns)
    assert (turned[0], turned[-1]) == (0, 1)


@pytest.mark.parametrize("z", [0.0, 30.0, 60.0, 100.0])
def test_ends_at_one_depth_in_still_water(z):
    """The level ray is there, also on a boundary, where the ray and its reflection are one."""
    paths = Channel(np.array([0.0, 60.0, 200.0]), np.array([1500.0, 1500.0, 1500.0]), 26e3).paths(
        700.0, z, z, Boundaries(100.0), 1
    )
    assert paths[0].time == pytest.approx(700.0 / 1500.0, rel=1e-13)
    assert (paths[0].dip_a, paths[0].dip_b, paths[0].surface, paths[0].bottom) == (0.0, 0.0, 0, 0)
    expected = {0.0: 2, 30.0: 3, 60.0: 3, 100.0: 2}[z]
    assert len(paths) == expected
    assert len({round(path.time, 12) for path in paths}) == expected


def test_nothing_between_a_point_and_itself():
    (path,) = Channel(np.array([0.0, 100.0]), np.array([1500.0, 1490.0]), 26e3).paths(0.0, 40.0, 40.0, order=0)
    assert (path.time, path.spreading) == (0.0, 0.0)


def test_ends_beyond_the_profile():
    """Below its last point the sound speed stays; above the surface counts as at it."""
    sea = Channel(np.array([0.0, 100.0]), np.array([1500.0, 1500.0]), 26e3)
    assert sea.paths(300.0, 50.0, 450.0, order=0)[0].time == pytest.approx(500.0 / 1500.0, rel=1e-12)
    assert sea.paths(300.0, -1.0, 400.0, order=0)[0].time == pytest.approx(500.0 / 1500.0, rel=1e-12)
    assert len(sea.paths(300.0, 50.0, 450.0, Boundaries(500.0), 1)) == 3


@pytest.mark.parametrize(("a", "b"), [(0.0, 70.0), (70.0, 150.0), (0.0, 150.0)])
def test_ends_on_surface_and_bottom(a, b):
    """Continuous with ends close to them, whose pairs of rays, before and after the reflection, become one."""
    sea = channel(thermocline, 150.0, 0.5)
    at = sea.paths(600.0, a, b, Boundaries(150.0), 2)
    near = sea.paths(600.0, min(max(a, 1e-4), 150.0 - 1e-4), min(max(b, 1e-4), 150.0 - 1e-4), Boundaries(150.0), 4)
    assert at
    for path in at:
        assert min(abs(path.time - other.time) for other in near) < 1e-6


def test_no_ray_reaches_a_shadow():
    """Sound speed that falls with depth bends all rays down: near the surface nothing is heard beyond the ray that grazes it."""
    grid = np.array([0.0, 1000.0])
    sea = Channel(grid, 1500.0 - 0.1 * grid, 26e3)
    radius_0 = 1500.0 / 0.1
    edge = sum(math.sqrt(radius_0**2 - (radius_0 - z) ** 2) for z in (10.0, 10.0))
    assert len(sea.paths(edge - 1.0, 10.0, 10.0)) >= 1
    assert sea.paths(edge + 1.0, 10.0, 10.0) == ()
    # From the bottom it is heard there.
    assert sea.paths(edge + 1.0, 10.0, 10.0, Boundaries(500.0), 1)[0].bottom == 1


@pytest.mark.parametrize("speed", [still, munk, duct, thermocline])
@pytest.mark.parametrize(
    ("x", "a", "b"), [(800.0, 20.0, 90.0), (2500.0, 80.0, 85.0), (1200.0, 60.0, 60.0), (40.0, 140.0, 3.0)]
)
def test_reciprocity(speed, x, a, b):
    """There and back: the same times and levels, and the angles swapped."""
    sea, sides = channel(speed, 150.0, 0.5), Boundaries(150.0)
    there, back = sea.paths(x, a, b, sides), sea.paths(x, b, a, sides)
    swapped = sorted((path.time, -path.dip_b, -path.dip_a, path.spreading, path.surface, path.bottom) for path in back)
    given = sorted((path.time, path.dip_a, path.dip_b, path.spreading, path.surface, path.bottom) for path in there)
    assert len(given) == len(swapped) > 0
    for one, other in zip(given, swapped, strict=True):
        assert one == pytest.approx(other, rel=1e-12, abs=1e-12)


def test_a_caustic_is_bounded():
    """Two rays meet and vanish; there the level is that of a wave, which grows with the third root of the frequency."""
    few, many = 1000.0, 1500.0
    sea = channel(duct, 150.0, 0.05)
    count = len(sea.paths(few, 50.0, 75.0, order=0))
    assert count < len(sea.paths(many, 50.0, 75.0, order=0))
    while many - few > 1e-9:
        middle = 0.5 * (few + many)
        if len(sea.paths(middle, 50.0, 75.0, order=0)) > count:
            many = middle
        else:
            few = middle
    levels = {}
    for frequency in (10e3, 80e3):
        paths = channel(duct, 150.0, 0.05, frequency).paths(many, 50.0, 75.0, order=0)
        levels[frequency] = [path.spreading for path in paths if path.caustic]
        assert len(levels[frequency]) >= 2
        assert all(20.0 < level < 20.0 * math.log10(many) for level in levels[frequency])
    assert np.subtract(levels[10e3][:2], levels[80e3][:2]) == pytest.approx(
        [10.0 / 3.0 * math.log10(8.0)] * 2, abs=0.05
    )
    assert levels[10e3][0] == pytest.approx(levels[10e3][1], abs=0.5)


def test_more_rays_than_there_is_room_for_keeps_the_earliest():
    sea, sides = channel(duct, 150.0, 1.0), Boundaries(150.0)
    some, most = (sea.paths(3000.0, 50.0, 75.0, sides, order) for order in (1, 40))
    assert len(most) == search.MOST > len(some) > 0
    assert list(most) == sorted(most)
    assert all(path in most for path in some if path.time < most[-1].time)


@pytest.mark.parametrize("speed", [still, munk, duct, thermocline])
@pytest.mark.parametrize("order", [0, 2])
def test_the_earliest_alone_is_the_earliest_of_all(speed, order):
    sea, rng = channel(speed, 150.0, 1.0), np.random.default_rng(5)
    silent = 0
    for bottom in (150.0, math.inf):
        for _ in range(40):
            x, a, b = rng.uniform(0.0, 4000.0), *rng.uniform(0.0, 150.0, 2)
            every = sea.paths(x, a, b, Boundaries(bottom), order)
            assert sea.earliest(x, a, b, Boundaries(bottom), order) == (every[0] if every else None)
            silent += not every
    assert silent < 60
