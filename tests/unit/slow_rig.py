"""A world with sensors that take time, whose jobs a test holds back as long as it wants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.world import World

KIND = '''
import threading
from typing import Any

import numpy as np

from uwserver.modifiers.base import Measurement, Memory
from uwserver.ports import Buffer, Field
from uwserver.ports.buffer import Layout
from uwserver.sensors import SensorTable
from uwserver.sensors.base import Sensor
from uwserver.sensors.job import PendingMeasurement, Job


class SlowConfig(SensorTable, tag="slow", kw_only=True, frozen=True):
    """A picture of random numbers."""

    delay_s: float = 0.02
    fails: bool = False
    metered: bool = False
    ideal: bool = False

    def build(self, mount):
        return Slow(self)


class Shot(Job):
    def __init__(self, seed, depth, level, fails):
        self.seed, self.depth, self.level, self.fails = seed, depth, level, fails

    def run(self):
        assert Slow.gate.wait(120.0)
        Slow.runs.append((self.seed, threading.current_thread().name))
        if self.fails:
            raise RuntimeError("the film is torn")
        picture = np.random.Generator(np.random.Philox(key=self.seed)).standard_normal(4) + self.depth + self.level
        return (Buffer.of(picture),)


class Metered(Memory):
    level: float = 0.0


class Slow(Sensor):
    doc = "A picture."
    fields = (Field("depth", "m", "at the begin"), Field("image", "1", "it", type="buffer", buffer=Layout("float64", (4,))))
    takes_time = True
    memory: Any
    gate = threading.Event()
    gate.set()
    runs: list = []

    def __init__(self, config):
        self.config, self.learns = config, config.metered
        super().__init__()

    def turn_on(self):
        return Metered()

    def learn(self, values):
        self.memory.level = round(float(values[0].array().sum()), 6)

    def sense(self, scope):
        z = scope.p_NB[2]
        seed = int(self.rng.integers(1 << 62))
        job = Shot(seed, z, self.memory.level, self.config.fails)
        return PendingMeasurement([z, None], True, delay_ns=round(1e9 * self.config.delay_s), job=job)


SENSORS = [SlowConfig]
'''

SCENARIO = """schema = 1
seed = 3
extensions = ["slow.py"]

[world]
rate_hz = 240

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]

[vehicles.rov.sensors.slow]
kind = "slow"
rate_hz = 24
{keys}
[vehicles.rov.sensors.slow.streams.late]
[vehicles.rov.sensors.slow.streams.late.modifiers.link]
kind = "delay"
latency_s = 0.008
"""


def slow_resolved(folder: Path, keys: str = "") -> Resolved:
    """A ROV with a sensor whose readings begin every 10 ticks and are due 5 later, and two more after that beside it."""
    (folder / "slow.py").write_text(KIND, encoding="utf-8")
    scenario = folder / "slow.toml"
    scenario.write_text(SCENARIO.format(keys=keys), encoding="utf-8")
    return load(scenario, adapters={})


def kind_of(world: World) -> Any:
    """The class of the slow sensor, with its gate and runs."""
    return type(world.sensors["rov/slow"].sensor)
