"""Rates that fall on ticks, an epoch that is an instant, and a clock whose keys fit its mode."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from uwserver.scenario.world.checks import check_rate, check_time
from uwserver.scenario.world.tables import WorldTable

PATH = ("sensors", "imu", "rate_hz")


def world(**keys: Any) -> WorldTable:
    return msgspec.convert(keys, WorldTable)


@pytest.mark.parametrize(
    ("rate", "physics"),
    [
        (240.0, 240.0),
        (120.0, 240.0),
        (1.0, 240.0),
        (0.1, 240.0),
        (240.0 / 7.0, 240.0),
        (34.285714285714285, 240.0),
        (1e-6, 240.0),
        (33.3, 333.0),
        (0.3, 0.9),
    ],
)
def test_a_rate_that_divides_passes(rate: float, physics: float, report) -> None:
    check_rate(rate, physics, PATH, report)
    assert report.lines == []


@pytest.mark.parametrize(
    ("rate", "physics", "text"),
    [
        (241.0, 240.0, "241 Hz is above the physics rate of 240 Hz: use at most 240"),
        (1e9, 240.0, "1e+09 Hz is above the physics rate of 240 Hz"),
        (7.0, 240.0, "7 Hz does not divide the physics rate of 240 Hz: the nearest rates that do are 6 and 8"),
        (100.0, 240.0, "the nearest rates that do are 80 and 120"),
        (239.0, 240.0, "the nearest rates that do are 120 and 240"),
        (120.001, 240.0, "does not divide"),
        (1e-320, 240.0, "Hz is far too low"),
    ],
)  # fmt: skip
def test_a_rate_that_does_not_divide_is_told_with_its_neighbours(
    rate: float, physics: float, text: str, report
) -> None:
    check_rate(rate, physics, PATH, report)
    (line,) = report.lines
    assert line.startswith("sensors.imu.rate_hz: ")
    assert text in line


def test_the_neighbours_that_are_named_divide(report) -> None:
    for rate in (7.0, 11.3, 99.0, 0.7):
        report.lines.clear()
        check_rate(rate, 240.0, PATH, report)
        (line,) = report.lines
        low, high = (float(word) for word in line.rsplit(" are ", 1)[1].split(" and "))
        assert low < rate < high
        report.lines.clear()
        for neighbour in (low, high):
            check_rate(neighbour, 240.0, PATH, report)
        assert report.lines == []


def test_time_as_it_is_by_default_passes(report) -> None:
    check_time(WorldTable(), report)
    check_time(world(clock={"mode": "lockstep", "lockstep_clients": ["a", "b"], "max_speed": 2.0}), report)
    check_time(world(clock={"mode": "freerun"}), report)
    assert report.lines == []


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"epoch_utc": "today"}, 'world.epoch_utc: "today" is not an instant: write it as "2026-01-01T00:00:00Z"'),
        ({"epoch_utc": "2026-02-30T00:00:00Z"}, 'world.epoch_utc: "2026-02-30T00:00:00Z" is not an instant: day is out of range for month'),
        ({"clock": {"mode": "lockstep"}}, 'world.clock: mode "lockstep" needs lockstep_clients: name the clients that grant each tick'),
        ({"clock": {"max_speed": 2.0}}, 'world.clock.max_speed: max_speed is for mode "lockstep": remove it, or use speed in mode "realtime"'),
        (
            {"clock": {"mode": "freerun", "max_speed": 2.0}},
            'world.clock.max_speed: max_speed is for mode "lockstep": remove it, or use speed in mode "realtime"',
        ),
        ({"clock": {"mode": "lockstep", "lockstep_clients": ["a", "b", "a"]}}, "world.clock.lockstep_clients: a client is named twice: remove one"),
    ],
)  # fmt: skip
def test_faults_of_time_are_told_at_their_key(keys: dict[str, Any], line: str, report) -> None:
    check_time(world(**keys), report)
    assert report.lines == [line]


def test_all_faults_of_time_are_told(report) -> None:
    clock = {"mode": "realtime", "max_speed": 2.0, "lockstep_clients": ["a", "a"]}
    check_time(world(epoch_utc="x", clock=clock), report)
    assert len(report.lines) == 3
