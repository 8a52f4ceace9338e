"""Sound between a device and its beacon: the bottom and the waves on its way, shadow zones, and which arrival a receiver takes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_rig import CUBE, ELEVATION, RANGE, TIME, answers, layered

from uwserver.environment.acoustics.boundaries import SEDIMENTS, Boundaries
from uwserver.environment.acoustics.channel import channel_of
from uwserver.environment.column import TableColumn, ThermoclineColumn, WaterColumn
from uwserver.environment.water import Sea, Water
from uwserver.physics.kernel.layout import PROFILE_SIZE, WAVE_AMPLITUDE, WAVE_SIZE, SeaRows
from uwserver.sensors import LblConfig, UsblConfig
from uwserver.sensors.acoustic.link import Link, boundaries
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.testing import FakeGeometry
from uwserver.testing.fake_geometry import Plane, Sphere

WARM_ABOVE = TableColumn(depth_m=(0.0, 200.0), temperature_degc=(25.0, 10.0), salinity_psu=(35.0, 35.0))
"""All rays bend down: between ends at 10 m none gets farther than 0.8 km without the bottom."""
SHALLOW = (0.0, 0.0, 10.0)


def warm(scope, geometry=None):
    instant = scope(p_NB=SHALLOW)
    instant.water = Water(1025.0, 9.81, 25.0, 101325.0, (0.0, 0.0, 0.0), given=WaterColumn(WARM_ABOVE, 9.81, 1025.0))
    if geometry is not None:
        instant.geometry = geometry
    return instant


def lbl(distance, **keys):
    beacon = {"a": Beacon(position_ned_m=(distance, 0.0, 10.0))}
    return LblConfig(rate_hz=1, beacons=beacon, max_range_m=5000.0, **keys)


def flat(depth):
    return Plane((0.0, 0.0, depth), (0.0, 0.0, -1.0))


@pytest.mark.parametrize("ideal", [False, True])
def test_a_shadow_zone_is_silent(scope, ideal):
    """Where no ray leads there is no answer, however loud; along straight lines there was one."""
    near, far = lbl(600.0, ideal=ideal, source_level_db=250.0), lbl(1200.0, ideal=ideal, source_level_db=250.0)
    assert answers(near, warm(scope), 1)[0].valid
    assert not answers(far, warm(scope), 1)[0].valid
    across = lbl(1200.0, ideal=ideal, source_level_db=250.0, propagation="straight")
    assert answers(across, warm(scope), 1)[0].valid


def test_the_bottom_is_heard_in_the_shadow(scope):
    """By it the answer is late, as the sound went down and up, and comes from below."""
    instant = warm(scope, FakeGeometry([flat(250.0)]))
    path = channel_of(instant.water.column, 26e3).paths(1200.0, 10.0, 10.0, Boundaries(250.0))[0]
    assert (path.surface, path.bottom) == (0, 1)
    (reading,) = answers(lbl(1200.0, source_level_db=220.0), instant, 1)
    assert reading.values[2] == pytest.approx(2.0 * path.time, abs=1e-5)
    assert reading.values[RANGE] > 1260.0
    assert not answers(lbl(1200.0, source_level_db=220.0, reflections=0), instant, 1)[0].valid
    usbl = UsblConfig(
        rate_hz=1,
        beacons={"a": Beacon(position_ned_m=(1200.0, 0.0, 10.0))},
        hydrophones_m=CUBE,
        max_range_m=5000.0,
        source_level_db=240.0,
    )
    assert answers(usbl, instant, 1)[0].values[ELEVATION] == pytest.approx(path.dip_a, abs=1e-3)
    assert path.dip_a > 0.3


def test_a_weak_answer_is_none(scope):
    """The level is that of the ray: beside the edge of the shadow it is far below that of a sphere."""
    instant = layered(scope)
    channel = channel_of(instant.water.column, 26e3)
    path = channel.paths(500.0, 5.0, 150.0)[0]
    noise = 50.0 + 10.0 * math.log10(4e3)
    beacon = {"a": Beacon(position_ned_m=(300.0, 400.0, 150.0))}
    for margin, heard in ((0.1, True), (-0.1, False)):
        level = noise + 10.0 + path.loss + margin
        config = LblConfig(rate_hz=1, beacons=beacon, source_level_db=level)
        assert answers(config, instant, 1)[0].valid is heard


def test_first_above_the_threshold_or_strongest(scope):
    """2.5 km below a thermocline the first rays are weak: a device takes the first that it hears, or the strongest."""
    instant = layered(scope)
    instant.p_NB = (0.0, 0.0, 80.0)
    instant.geometry = FakeGeometry([flat(200.0)])
    paths = channel_of(instant.water.column, 26e3).paths(2500.0, 80.0, 85.0, Boundaries(200.0))
    loudest = min(paths, key=lambda path: path.loss)
    assert paths[0].loss > loudest.loss + 10.0
    beacon = {"a": Beacon(position_ned_m=(2500.0, 0.0, 85.0))}

    def time(**keys):
        (reading,) = answers(
            LblConfig(rate_hz=1, beacons=beacon, max_range_m=5000.0, bandwidth_hz=4e3, **keys), instant, 1
        )
        return 0.5 * reading.values[2]

    loud = {"source_level_db": 250.0}
    assert time(**loud) == pytest.approx(paths[0].time, abs=1e-5)
    assert time(arrival="strongest", **loud) == pytest.approx(loudest.time, abs=1e-5)
    audible = 50.0 + 10.0 * math.log10(4e3) + 10.0 + 0.5 * (paths[0].loss + loudest.loss)
    heard = next(path for path in paths if path.loss <= 0.5 * (paths[0].loss + loudest.loss))
    assert heard.time > paths[0].time
    assert time(source_level_db=audible) == pytest.approx(heard.time, abs=1e-3)


def test_no_answer_comes_before_its_sound(scope):
    """Nearly level over 2.5 km in a thermocline: no path is as quick as the fastest water along the whole way. One arc between the ends is."""
    column = ThermoclineColumn(surface_temperature_degc=18.0, deep_temperature_degc=6.0, depth_m=80.0, thickness_m=40.0)
    instant = scope(p_NB=(0.0, 0.0, 80.0))
    instant.water = Water(1025.0, 9.81, 18.0, 101325.0, (0.0, 0.0, 0.0), given=WaterColumn(column, 9.81, 1025.0))
    beacon = {"a": Beacon(position_ned_m=(2500.0, 0.0, 85.0))}
    config = UsblConfig(rate_hz=1, ideal=True, beacons=beacon, max_range_m=5000.0)
    (reading,) = answers(config, instant, 1)
    fastest = instant.water.column.sound_speed[:200].max()
    assert 2.0 * 2500.0 / fastest < reading.values[TIME] < 1.01 * 2.0 * 2500.0 / fastest


def test_sound_by_the_surface_comes_later_by_its_ray(scope):
    instant = layered(scope)
    a, b = (0.0, 0.0, 5.0), (300.0, 400.0, 150.0)
    for propagation in ("layered", "straight"):
        link = Link(LblConfig(rate_hz=1, beacons={"a": Beacon(position_ned_m=b)}, propagation=propagation))
        path = link.heard(link.paths(instant, a, b), 0.0)
        assert path is not None
        late = link.surface_delay(instant, a, b, path)
        image = (math.hypot(500.0, 155.0) - math.hypot(500.0, 145.0)) / 1490.0
        assert late == pytest.approx(image, rel=0.7 if propagation == "layered" else 0.02)
    grid = channel_of(instant.water.column, 26e3).paths(500.0, 5.0, 150.0)
    link = Link(LblConfig(rate_hz=1, beacons={"a": Beacon(position_ned_m=b)}))
    assert link.surface_delay(instant, a, b, grid[0]) == grid[1].time - grid[0].time
    assert link.surface_delay(instant, a, b, grid[-1]) == 0.0


def test_the_bottom_of_a_way(scope):
    """The middle of three looks down; not what swims below, not above an end, and none where it is deep."""
    instant = scope()
    a, b = (0.0, 0.0, 20.0), (400.0, 0.0, 60.0)
    instant.geometry = FakeGeometry([flat(90.0), Sphere((200.0, 0.0, 60.0), 3.0)], [1, 0])
    instant.sediments = (SEDIMENTS["sediment"], SEDIMENTS["rock"])
    found = boundaries(instant, a, b)
    assert found.bottom == pytest.approx(90.0)
    assert boundaries(instant, a, (400.0, 0.0, 95.0)).bottom == pytest.approx(95.0)
    instant.geometry = FakeGeometry([flat(90.0)], [1])
    assert boundaries(instant, a, b).sediment == SEDIMENTS["rock"]
    instant.geometry = FakeGeometry([flat(90.0)], [7])
    assert boundaries(instant, a, b).sediment == SEDIMENTS["sediment"]
    instant.geometry = FakeGeometry([Sphere((200.0, 0.0, 60.0), 3.0)])
    assert boundaries(instant, a, b) == Boundaries()
    slope = math.sqrt(0.5)
    instant.geometry = FakeGeometry([Plane((0.0, 0.0, 100.0), (slope, 0.0, -slope))])
    assert boundaries(instant, a, b).bottom == pytest.approx(300.0)


def test_waves_make_the_surface_rough(scope):
    """Standard deviation of the elevation: of each wave half the square of its amplitude. Its echo is then lost."""
    waves = np.zeros((2, WAVE_SIZE))
    waves[:, WAVE_AMPLITUDE] = 0.3, 0.4
    instant = layered(scope)
    instant.water.sea = Sea(SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), waves))
    a, b = (0.0, 0.0, 5.0), (300.0, 400.0, 150.0)
    assert boundaries(instant, a, b).roughness == pytest.approx(math.sqrt(0.5 * (0.09 + 0.16)), rel=1e-12)
    link = Link(LblConfig(rate_hz=1, beacons={"a": Beacon(position_ned_m=b)}))
    direct, mirrored = link.paths(instant, a, b)[:2]
    assert (direct.reflection, mirrored.surface) == (0.0, 1)
    assert mirrored.reflection > 100.0
