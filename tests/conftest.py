"""Worlds that many tests need."""

from __future__ import annotations

import signal
from collections.abc import Callable

import pytest

from uwserver.modifiers import Delay, WhiteNoise
from uwserver.scenario.build import build
from uwserver.scenario.load import load
from uwserver.scenario.resolved import Resolved
from uwserver.scenario.schema import Scenario, Server, Truth, VehicleEntry, WorldTable
from uwserver.sensors import ImuConfig
from uwserver.world import World

# A shell without job control starts its background commands with SIGINT ignored, and whatever they start inherits that: tests of Ctrl-C
# would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def small_scenario(rate_hz: float = 240.0, seed: int = 5, vehicles: int = 1) -> Resolved:
    """Deep open water, BlueROV2 Heavies with noisy and delayed sensors and truth, no adapter, no metrics."""
    late = ImuConfig(
        rate_hz=rate_hz / 4,
        modifiers={"noise": WhiteNoise(field="f_S", sigma=0.1), "link": Delay(latency_s=0.02, jitter_s=0.005)},
    )
    entries = {
        f"rov{k}" if k else "rov": VehicleEntry(
            model="bluerov2_heavy",
            position_ned_m=(3.0 * k, 0.0, 10.0),
            truth=Truth(rate_hz=rate_hz / 10),
            sensors={"late_imu": late},
        )
        for k in range(vehicles)
    }
    table = WorldTable(rate_hz=rate_hz)
    return load(Scenario(schema=1, seed=seed, world=table, vehicles=entries, server=Server(metrics=False)), adapters={})


@pytest.fixture
def resolved() -> Resolved:
    return small_scenario()


@pytest.fixture
def world(resolved: Resolved) -> World:
    return build(resolved)


@pytest.fixture
def make_world() -> Callable[..., World]:
    return lambda **options: build(small_scenario(**options))
