"""How sonars sound to each other, as rows: found by who listens in compiled code as by who listens in Python, and as the world changes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uwserver
from uwserver.sensors.voices import (
    END,
    FIRST,
    INTENSITY,
    MOST,
    VOICE,
    WHOSE,
    add_bursts,
    find_bursts,
    find_bursts_at_once,
    period,
)
from uwserver.world.state import snapshot

HZ = 240
VEHICLE = """
schema = 1
seed = 3
[world]
rate_hz = 240
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 50.0]
[vehicles.rov.sensors]
"""
ABOARD = """
# Named so that one reads before the listener and one after it.
ahead = { kind = "OTHER", rate_hz = 24, range_m = 5, frequency_hz = 455e3, position_frd_m = [0.0, 0.0, 1.0], enabled = FIRST }
listener = { kind = "scanning_sonar", rate_hz = 4, range_m = 50, bins = 500, output = "pressure", frequency_hz = 450e3, KEYS }
then = { kind = "OTHER", rate_hz = 24, range_m = 5, frequency_hz = 455e3, position_frd_m = [0.0, 0.0, 1.0], enabled = SECOND }
"""


def world_of(folder: Path, other: str, first: bool, second: bool) -> Any:
    text = (
        (VEHICLE + ABOARD)
        .replace("OTHER", other)
        .replace("KEYS", "noise_level_db = -50, cross_talk_db = -40")
        .replace("FIRST", str(first).lower())
        .replace("SECOND", str(second).lower())
    )
    file = folder / f"{other}{first}{second}.toml"
    file.write_text(text)
    return uwserver.load(file).core


def heard_in(world: Any, ticks: int = HZ) -> np.ndarray:
    """Ranges (m) of the bins of the last ping that are louder than any noise of this receiver."""
    rows = [s.value[3] for s in world.step(ticks) if s.port == "rov/listener" and s.valid]
    return np.flatnonzero(1e6 * np.array(rows[-1]) > 1e4) * 0.1


def count_of(found: np.ndarray) -> int:
    """How many bursts, with silence between them."""
    return int(1 + (np.diff(found) > 2.0).sum()) if len(found) else 0


@pytest.mark.parametrize("other", ["side_scan", "scanning_sonar", "profiler"])
@pytest.mark.parametrize("is_first", [True, False])
def test_whoever_pings_is_heard_and_whoever_reads_first(tmp_path: Path, other: str, is_first: bool) -> None:
    """A ping of 67 ms begins when the other does, which pings again after 41.7 ms: a burst at the start, and another one."""
    world = world_of(tmp_path, other, is_first, not is_first)
    found = heard_in(world)
    assert found[0] < 2.5
    assert count_of(found) == 2
    name = "ahead" if is_first else "then"
    world.call(f"rov/{name}/set", range=32.0)
    assert count_of(heard_in(world)) == 1, "of 42.7 ms, and so in every other of its turns"
    world.call(f"rov/{name}/deactivate")
    assert not len(heard_in(world))
    world.call(f"rov/{name}/activate")
    assert len(heard_in(world))
    world.sensors[f"rov/{name}"].fault = "silent"
    assert not len(heard_in(world))


def test_those_of_another_vehicle_are_not_heard(tmp_path: Path) -> None:
    world = world_of(tmp_path, "scanning_sonar", False, True)
    world.call("world/spawn", name="other", like="rov", p_NB=[0.0, 3.0, 50.0])
    assert len(heard_in(world))
    world.call("rov/then/deactivate")
    assert not len(heard_in(world))


def test_a_state_that_comes_back_brings_the_pace_of_all(tmp_path: Path) -> None:
    """A restored world hears what the first one heard, though meanwhile the others pinged at other times."""
    world = world_of(tmp_path, "scanning_sonar", True, False)
    world.step(50)
    state = snapshot.take(world)
    expected = [(s.port, s.seq, s.value) for s in world.step(HZ)]
    world.step(77)
    snapshot.restore(world, state)
    assert [(s.port, s.seq, s.value) for s in world.step(HZ)] == expected


LINES = (
    'listener = { kind = "scanning_sonar", rate_hz = 4, range_m = 50, bins = 500, output = "pressure", frequency_hz = 450e3, cross_talk_db = -40 }',
    'one = { kind = "scanning_sonar", rate_hz = 24, range_m = 5, frequency_hz = 455e3 }',
    'two = { kind = "scanning_sonar", rate_hz = 24, range_m = 5, frequency_hz = 455e3, position_frd_m = [0.0, 0.0, 1.0] }',
)


def told_by(world: Any) -> list[Any]:
    return [(s.seq, s.value) for s in world.step(HZ) if s.port == "rov/listener"]


def test_what_is_heard_does_not_depend_on_who_stands_first_nor_on_who_came_and_went(tmp_path: Path) -> None:
    worlds = []
    for order in (LINES, LINES[::-1]):
        file = tmp_path / f"{order[0][:3]}.toml"
        file.write_text(VEHICLE + "\n".join(order))
        worlds.append(uwserver.load(file).core)
    one, other = worlds
    assert told_by(one) == told_by(other)
    state = snapshot.take(one)
    expected = told_by(one)
    one.call("world/remove", name="rov")
    snapshot.restore(one, state)
    assert told_by(one) == expected, "its voices lie in other rows now"


def voices(*changes: dict[str, float]) -> np.ndarray:
    """The listener, and others that are as it is but for these numbers."""
    made = np.zeros(1 + len(changes), VOICE)
    made["works"], made["frequency"], made["bandwidth"], made["level"] = 1, 450e3, 4e4, 200.0
    made["length"], made["range"], made["dt"] = 1e-3, 30.0, 0.1
    for voice, change in zip(made[1:], changes, strict=True):
        for name, value in change.items():
            voice[name] = value
    return made


def bursts(
    *changes: dict[str, float], kernel: Any = find_bursts_at_once, heard: tuple[bool, ...] = (True, True)
) -> np.ndarray:
    made, out = voices(*changes), np.empty((2 * MOST, 4))
    count = kernel(made, 0, np.array(heard), 1500.0, -40.0, 0.0, 10.0, 1.0, 500, out)
    return out[:count].copy()


def test_a_burst_lasts_as_long_as_the_pulse_and_fills_the_band() -> None:
    """1 ms of 7500 gates a second, 1 m away; the listener's bins resolve 7.5 of 40 kHz."""
    ((first, end, intensity, _),) = bursts({"p": (1.0, 0.0, 0.0)})
    assert (first, end) == (5.0, 13.0)
    assert 10.0 * np.log10(intensity) == pytest.approx(160.0 + 10.0 * np.log10(7.5 / 40.0))
    near = bursts({"p": (1e-3, 0.0, 0.0)})[0]
    assert near[INTENSITY] == pytest.approx(100.0 * intensity), "a tenth of a metre at least"
    assert near[FIRST] == 0.0
    assert near[END] == 8.0


def test_both_kernels_find_the_same_and_nothing_of_whom_nobody_hears() -> None:
    others = {"p": (0.3, 0.4, 0.0), "ready": 0.02, "dt": 0.01}, {"frequency": 460e3, "overhead": 0.01}
    every = (True, True, True)
    assert np.array_equal(bursts(*others, heard=every), bursts(*others, kernel=find_bursts, heard=every))
    assert len(bursts(*others, heard=every)) == 3
    assert len(bursts(*others, heard=(True, False, True))) == 1


def test_bursts_are_those_of_their_sonars_in_whatever_order_these_lie() -> None:
    near, far = {"p": (0.3, 0.4, 0.0), "key": 7e18, "ready": 0.02, "dt": 0.01}, {"p": (2.0, 0.0, 0.0), "key": 3e18}
    every = (True, True, True)
    found = bursts(near, far, heard=every)
    np.testing.assert_array_equal(found, bursts(far, near, heard=every))
    assert len(found) == len(np.unique(found[:, WHOSE])) == 3
    alone = bursts(near, heard=every)
    assert set(alone[:, WHOSE]) < set(found[:, WHOSE])
    assert (found[:, WHOSE] == np.floor(found[:, WHOSE])).all()
    assert found[:, WHOSE].max() < 2.0**52


def test_the_period_is_that_of_the_sound_speed_that_the_device_believes() -> None:
    assert period(1500.0, 30.0, 0.0, 0.01) == pytest.approx(0.05)
    assert period(1500.0, 30.0, 1200.0, 0.0) == pytest.approx(0.05)


def test_bursts_are_independent_and_end_with_the_ping() -> None:
    key = np.uint64(4)
    sound, later = np.zeros((2, 50, 200)), np.zeros((2, 50, 200))
    two = np.array([[0.0, 100.0, 2.0, 5.0], [100.0, 900.0, 2.0, 6.0]])
    add_bursts(two, key, np.uint64(0), 1.0, sound)
    add_bursts(two[1:], key, np.uint64(0), 1.0, later)
    assert np.square(sound).mean() == pytest.approx(1.0, rel=0.05)
    halves = sound.reshape(2, 50, 2, 100)
    for a, b in ((halves[:, :, 0], halves[:, :, 1]), (sound[0], sound[1]), (sound[:, 1:], sound[:, :-1])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.05
    np.testing.assert_array_equal(later[..., 100:], sound[..., 100:], "whoever else is heard")
    again, other = np.zeros((2, 50, 200)), np.zeros((2, 50, 200))
    next_ping = two[:1].copy()
    next_ping[0, WHOSE] += 1.0
    add_bursts(next_ping, key, np.uint64(0), 1.0, again)
    add_bursts(two[:1], key, np.uint64(1), 1.0, other)
    for a in (again, other):
        assert abs(np.corrcoef(a[..., :100].ravel(), sound[..., :100].ravel())[0, 1]) < 0.05
