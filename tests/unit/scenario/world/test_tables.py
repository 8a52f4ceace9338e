"""Tables of the world itself: limits and defaults."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import UNSET

from uwserver.scenario.world.tables import Clock, WorldTable


def test_defaults() -> None:
    world = WorldTable()
    assert (world.rate_hz, world.epoch_utc, world.origin_lat_deg) == (240.0, "2026-01-01T00:00:00Z", UNSET)
    assert world.clock == Clock(mode="realtime", speed=1.0, lockstep_timeout_s=10.0, on_loss="wait")
    assert (world.clock.max_speed, world.clock.paused, world.clock.lockstep_clients) == (UNSET, False, ())


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"rate_hz": 0.5}, "rate_hz: expected a number from 1 to 10000, found 0.5"),
        ({"rate_hz": 10001}, "rate_hz: expected a number from 1 to 10000, found 10001"),
        ({"origin_lat_deg": 90}, "origin_lat_deg: expected a number from -89.9 to 89.9, found 90"),
        ({"epoch_utc": 2026}, "epoch_utc: expected a string, found 2026"),
        ({"clock": {"mode": "fast"}}, 'clock.mode: expected one of "freerun", "lockstep", "realtime", found the string "fast"'),
        ({"clock": {"speed": 0}}, "clock.speed: expected a number greater than 0, found 0"),
        ({"clock": {"lockstep_timeout_s": -1}}, "clock.lockstep_timeout_s: expected a number of at least 0, found -1"),
        ({"clock": {"lockstep_clients": [""]}}, 'clock.lockstep_clients[0]: expected a string that is not empty, found the string ""'),
        ({"clock": {"on_loss": "panic"}}, 'clock.on_loss: expected one of "continue", "pause", "wait", found the string "panic"'),
    ],
)  # fmt: skip
def test_limits(keys: dict[str, Any], line: str, tree_of, report) -> None:
    assert tree_of(keys, WorldTable).value is None
    assert report.lines == [line]
