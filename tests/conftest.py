"""Worlds that many tests need."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import pytest

from uwserver.modifiers import Delay, WhiteNoise
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario, Server
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import ImuConfig
from uwserver.sensors.truth import Truth
from uwserver.simulation import thread
from uwserver.world import World

# What tests of several folders need.
sys.path.insert(0, str(Path(__file__).parent))

# A shell without job control starts its background commands with SIGINT ignored, and whatever they start inherits that: tests of Ctrl-C
# would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

MARK = "UWSERVER_TEST_RUN"
"""Environment variable of all that a run of the tests starts, and of what these start."""

UNDERTAKER = """
import os, signal, sys, time
sys.stdin.read()  # ends with pytest, however that ends
mark, seen = sys.argv[1].encode(), True
while seen:  # again, as long as one may have started another meanwhile
    seen = False
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/environ", "rb") as file, open(f"/proc/{name}/stat", "rb") as stat:
                theirs = mark in file.read() and b") Z " not in stat.read()
            if theirs and int(name) != os.getpid():
                seen = True
                os.kill(int(name), signal.SIGKILL)
        except OSError:
            pass
    time.sleep(0.05)
"""


def pytest_configure(config: pytest.Config) -> None:
    """Nothing that a test started outlives the run, even where pytest is killed and no fixture ends: a process outside its group sees to it."""
    # Workers of pytest-xdist belong to the run that started them.
    if MARK not in os.environ and Path("/proc/self").is_dir():
        os.environ[MARK] = uuid.uuid4().hex
        command = [sys.executable, "-I", "-S", "-c", UNDERTAKER, f"{MARK}={os.environ[MARK]}"]
        undertaker = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
        config.add_cleanup(lambda: undertaker.communicate() and None)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """What is collected, tests by the thousand and all modules, stays to the end: looking through it for garbage again and again costs seconds."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _no_world_looks_for_garbage() -> Iterator[None]:
    """One that begins to run looks through all that there is, and when it ends all that was frozen counts again: here thousands of tests have
    made it, and a thousand worlds begin."""
    nothing = SimpleNamespace(collect=lambda: 0, freeze=lambda: None, unfreeze=lambda: None)
    with patch.object(thread, "gc", nothing):
        yield


BEGIN = pytest.StashKey[float]()


def processor_s() -> float:
    """Of this process and of all that it has waited for."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    item.stash[BEGIN] = processor_s()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    """What a test took of the processors, with its fixtures, stands in the results (--junitxml): tools/costs_of_tests.py makes a table of it."""
    try:
        return (yield)
    finally:
        item.user_properties.append(("processor_s", f"{processor_s() - item.stash[BEGIN]:.3f}"))


@cache
def small_scenario(rate_hz: float = 240.0, seed: int = 5, vehicles: int = 1) -> Resolved:
    """Deep open water, BlueROV2 Heavies with noisy and delayed sensors and truth, no adapter, no metrics.

    Read once in a process: it is frozen, and reading takes three times as long as building a world of it.
    """
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
