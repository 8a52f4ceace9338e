"""Sonars of one vehicle that hear each other: in which bins, how loud, and only where their bands overlap and the table asks for it."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec import UNSET, structs

import uwserver
from uwserver.sensors import (
    BathymetryConfig,
    MultibeamConfig,
    Pose,
    ProfilerConfig,
    ScanningSonarConfig,
    SideScanConfig,
)
from uwserver.sensors.voices import INTENSITY, MOST, add_bursts, pings
from uwserver.testing import FakeGeometry

DEEP, RELATIVE = 1000.0, -40.0
LOUD = SideScanConfig(
    rate_hz=10, frequency_hz=450e3, bandwidth_hz=4e4, pulse_s=4e-4, source_level_db=205.0, range_m=20.0
)
SIDES = structs.replace(
    LOUD, output="pressure", bins=500, range_m=50.0, bandwidth_hz=7.5e3, noise_level_db=-50.0, cross_talk_db=RELATIVE
)
PLACE = Pose((1.0, 0.0, 0.0))


@pytest.fixture
def open_water(scope: Any) -> Any:
    """`open_water(t)`: deep below the surface, nothing about."""

    def build(t: float = 0.0, **state: Any) -> Any:
        made = scope(**{"p_NB": (0.0, 0.0, DEEP), "t_ns": round(t * 1e9), **state})
        made.geometry = FakeGeometry(())
        return made

    return build


def aboard(listener: Any, *others: Any, mount: Pose = PLACE) -> tuple[Any, ...]:
    """The sonars of one vehicle, the listener in its origin, that know each other."""
    sonars = (listener.build(Pose()), *(other.build(mount) for other in others))
    slots = {str(k): SimpleNamespace(sensor=sonar, works=True) for k, sonar in enumerate(sonars)}
    for k, sonar in enumerate(sonars):
        sonar.start(k)
        sonar.dt = 0.1
        sonar.join(slots)
    return sonars


def row(sonar: Any, instant: Any) -> np.ndarray:
    """What port hears, uPa."""
    valid, values = sonar.measure(instant)
    assert valid
    return 1e6 * values[-2].array()


def heard(pressure: np.ndarray) -> np.ndarray:
    """Numbers of the bins that are louder than any noise of this receiver."""
    return np.flatnonzero(pressure > 1e4)


def test_a_ping_at_the_same_time_is_heard_at_once_at_the_level_of_its_direct_sound(open_water: Any) -> None:
    """205 dB - 40 dB, a metre away; of its 40 kHz the listener hears 7.5. Its 0.4 ms are three bins."""
    listener, _ = aboard(SIDES, LOUD)
    power = []
    for k in range(400):
        listener.start(k)
        loud = row(listener, open_water())
        assert set(heard(loud)) <= set(range(4, 10))
        power.append(np.mean(loud[6:8] ** 2))
    share = 10.0 * math.log10(7.5e3 / 4e4)
    assert 10.0 * math.log10(np.mean(power)) == pytest.approx(205.0 + RELATIVE + share, abs=0.5)


def test_off_by_default(open_water: Any) -> None:
    silent = structs.replace(SIDES, cross_talk_db=UNSET)
    assert SideScanConfig(rate_hz=1).cross_talk_db is UNSET
    alone, beside = (aboard(*sonars)[0] for sonars in ((silent,), (silent, LOUD)))
    assert np.array_equal(row(alone, open_water()), row(beside, open_water()))
    assert not len(heard(row(alone, open_water(5.0))))


def test_a_ping_that_comes_later_is_heard_in_the_bins_of_its_time(open_water: Any) -> None:
    """The other one pinged 30 ms before and takes 31.7 ms: at the next multiple of its 50 ms it pings again, 20 ms after this one."""
    listener, other = aboard(SIDES, LOUD)
    other.dt = 0.05
    c = open_water().water.sound_speed(DEEP)
    assert other.measure(open_water(0.95))[0]
    found = heard(row(listener, open_water(0.98)))
    expected = 0.5 * c * (0.02 + 1.0 / c) / 0.1
    assert found[0] == pytest.approx(expected, abs=2.0)
    assert found[-1] == pytest.approx(expected + 0.5 * c * 4e-4 / 0.1, abs=2.0)


def test_who_read_first_in_a_tick_makes_no_difference(open_water: Any) -> None:
    before, after = aboard(SIDES, LOUD), aboard(SIDES, LOUD)
    assert after[1].measure(open_water())[0]
    assert np.array_equal(row(before[0], open_water()), row(after[0], open_water()))


def test_several_pings_in_one_of_a_longer_range(open_water: Any) -> None:
    """67 ms of listening; the other one is ready after 31.7 ms, and pings at multiples of 10 ms: now, at 40 ms, and no more."""
    listener, other = aboard(SIDES, LOUD)
    other.dt = 0.01
    found = heard(row(listener, open_water()))
    c = open_water().water.sound_speed(DEEP)
    assert set(found) <= {*range(4, 10), *range(int(200 * c / 1000) - 2, int(200 * c / 1000) + 15)}
    assert (found > 200).any()


@pytest.mark.parametrize(
    "change", [{"frequency_hz": 500e3}, {"frequency_hz": 400e3}], ids=["a higher band", "a lower one"]
)
def test_bands_that_do_not_overlap_do_not_disturb(open_water: Any, change: dict[str, float]) -> None:
    listener, _ = aboard(SIDES, structs.replace(LOUD, **change))
    assert not len(heard(row(listener, open_water())))


def test_half_a_band_is_half_the_power_and_twice_as_far_a_quarter(open_water: Any) -> None:
    wide = structs.replace(SIDES, bins=4000, bandwidth_hz=6e4)
    instant = open_water()
    gates = SimpleNamespace(per_metre=80.0, window=1.0, total=4000)
    levels = []
    for other, mount in ((450e3, PLACE), (450e3 + 3e4, PLACE), (450e3, Pose((2.0, 0.0, 0.0)))):
        listener, _ = aboard(wide, structs.replace(LOUD, frequency_hz=other), mount=mount)
        (burst,) = listener.overhear(instant, gates, 1500.0, RELATIVE)
        levels.append(burst[INTENSITY])
    assert levels[0] == pytest.approx(10.0**16.5)
    assert levels[1] == pytest.approx(0.5 * levels[0])
    assert levels[2] == pytest.approx(0.25 * levels[0])


def test_who_does_not_work_is_not_heard(open_water: Any) -> None:
    listener, other = aboard(SIDES, LOUD)
    listener.join({"other": SimpleNamespace(sensor=other, works=False)})
    assert not len(heard(row(listener, open_water())))
    listener.join({"no sonar": SimpleNamespace(sensor=object(), works=True)})
    assert not len(heard(row(listener, open_water(1.0))))


def test_a_sonar_in_the_air_is_not_heard(open_water: Any) -> None:
    instant = open_water(p_NB=(0.0, 0.0, 1.0))
    for height, some in ((0.0, True), (-3.0, False)):
        listener, _ = aboard(structs.replace(SIDES, range_m=1.0), LOUD, mount=Pose((1.0, 0.0, height)))
        assert (
            len(listener.overhear(instant, SimpleNamespace(per_metre=1.0, window=1.0, total=50), 1500.0, 0.0)) > 0
        ) is some


@pytest.mark.parametrize(
    "table",
    [
        MultibeamConfig(
            rate_hz=5, frequency_hz=450e3, output="pressure", beams=16, rays_vertical=8, range_m=10.0, bins=100
        ),
        BathymetryConfig(rate_hz=5, frequency_hz=450e3, beams=16, rays_along=4, range_m=10.0, min_range_m=0.5),
        ProfilerConfig(rate_hz=5, frequency_hz=450e3, range_m=10.0),
        ScanningSonarConfig(rate_hz=5, frequency_hz=450e3, output="pressure", range_m=10.0, bins=100),
    ],
    ids=lambda table: table.__struct_config__.tag,
)
def test_all_kinds_hear_and_are_heard(open_water: Any, table: Any) -> None:
    """A listener in empty water reads nothing but what the other brings; and the other way round."""
    keys = {"cross_talk_db": 0.0, "noise_level_db": -50.0}
    listens = structs.replace(table, **keys)
    beside, alone = aboard(listens, LOUD)[0].measure(open_water()), aboard(listens)[0].measure(open_water())
    assert beside != alone
    assert aboard(table, LOUD)[0].measure(open_water()) == aboard(table)[0].measure(open_water())
    listener, _ = aboard(SIDES, table)
    assert len(heard(row(listener, open_water())))


ABOARD = """
schema = 1
seed = 3
[world]
rate_hz = 240
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 50.0]
[vehicles.rov.sensors]
# Named so that one reads before the listener and one after it; they ping when they can.
ahead = { kind = "side_scan", rate_hz = 24, range_m = 5, frequency_hz = 440e3, enabled = FIRST }
listener = { kind = "side_scan", rate_hz = 4, output = "pressure", noise_level_db = -50, cross_talk_db = -40 }
then = { kind = "scanning_sonar", rate_hz = 24, range_m = 5, frequency_hz = 460e3, enabled = SECOND, position_frd_m = [0.0, 0.0, 1.0] }
"""


def world_of(folder: Path, first: bool, second: bool) -> Any:
    file = folder / f"{first}{second}.toml"
    file.write_text(ABOARD.replace("FIRST", str(first).lower()).replace("SECOND", str(second).lower()))
    return uwserver.load(file).core


def ping_of(world: Any, ticks: int = 120) -> np.ndarray:
    """Port of the last ping, uPa."""
    rows = [s.value[-2].array() for s in world.step(ticks) if s.port == "rov/listener" and s.valid]
    return 1e6 * rows[-1].astype(float)


def test_in_a_world_they_hear_each_other_whoever_reads_first_and_fall_silent_with_a_fault(tmp_path: Path) -> None:
    """A ping of 67 ms begins when the others do, which ping again after 41.7 ms: bursts at the start and at 31 m."""
    for first, second in ((True, False), (False, True)):
        world = world_of(tmp_path, first, second)
        row = ping_of(world)
        bins = heard(row) * 0.05
        assert len(bins)
        assert ((bins < 2.0) | (np.abs(bins - 31.0) < 2.0)).all()
        assert (bins > 29.0).any()
    world.sensors["rov/then"].fault = "silent"
    assert not len(heard(ping_of(world, 240)))
    assert not len(heard(ping_of(world_of(tmp_path, False, False))))


def test_bursts_add_their_power_where_they_are_and_are_drawn_once() -> None:
    sound, bursts = np.zeros((2, 300, 40), np.float32), np.array([[10.0, 20.0, 8.0]])
    key, number, later = np.array((1, 2, 3), np.uint64)
    add_bursts(bursts, key, number, 2.0, sound)
    assert not sound[:, :, :10].any()
    assert not sound[:, :, 20:].any()
    assert np.mean(np.sum(sound[:, :, 10:20].astype(float) ** 2, axis=0)) == pytest.approx(4.0, rel=0.05)
    again, other = np.zeros_like(sound), np.zeros_like(sound)
    add_bursts(bursts, key, number, 2.0, again)
    add_bursts(bursts, key, later, 2.0, other)
    assert np.array_equal(sound, again)
    assert not np.array_equal(sound, other)


def test_pings_follow_the_pace_and_are_never_endless() -> None:
    def told(since: float, until: float, ready: float = 0.0, busy: float = 0.25, dt: float = 0.1) -> list[float]:
        times = np.empty(MOST)
        return times[: pings(ready, busy, dt, since, 5.0, until, times)].tolist()

    assert told(4.9, 6.0) == pytest.approx([5.0, 5.3, 5.6, 5.9])
    assert told(4.8, 5.5, ready=5.15) == pytest.approx([4.9, 5.2])
    assert told(4.95, 5.5, ready=5.15) == pytest.approx([5.2])
    assert len(told(0.0, 1e9, busy=0.0, dt=1e-6)) == 100
