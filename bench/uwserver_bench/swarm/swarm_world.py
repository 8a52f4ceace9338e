"""A world of `uwserver bench swarm`, in a process of its own: ``python -m uwserver_bench.swarm.swarm_world``. Thus
memory and time are those of the world alone.

Tasks and results are lines on stdin and stdout, as of `uwserver_bench.load`.
"""

from __future__ import annotations

import gc
import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

import uwserver
from uwserver.copies.batch import Batch
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.straight import straight
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.sensors.compiled import CompiledSensor, loops_of
from uwserver.simulation.clock import SystemTime, processor_ns
from uwserver.step import delivery
from uwserver.units import NANOSECONDS
from uwserver.world.world import World
from uwserver_bench.engine.physics import OpenWater
from uwserver_bench.processes import carry_out, resident_mb, scenario_file
from uwserver_bench.swarm.swarm_scenario import RATE_HZ, Kind, mission, names, scenario

SETTLE_TICKS = 2 * RATE_HZ
"""Time until the AHRS has found north."""
_TICKS = 24
_THRUSTERS = f"{names(1)[0]}/thrusters"
_clock = SystemTime()


def fly(task: Mapping[str, Any]) -> dict[str, object]:
    """Load a swarm of `vehicles` of a `kind`, start the missions of those with an autopilot, and step it in free-run, without a reader.

    Returns:
        Processor time of loading, s; simulated over processor time and over wall time, one value for each of `repeats` of `seconds` of
        processor time; memory in use at the end, MB.
    """
    begin = processor_ns()
    world = loaded(task["kind"], task["vehicles"], task["one_core"])
    load_s = (processor_ns() - begin) * 1e-9
    world.subscribe(())
    ticks(world, SETTLE_TICKS if task["kind"] == "navigation" else _TICKS)
    if task["kind"] == "navigation":
        set_out(world, task["vehicles"])
        ticks(world, _TICKS)
    # A server does the same before it runs.
    gc.collect()
    gc.freeze()
    found = [pace(lambda: ticks(world, _TICKS), _TICKS, task["seconds"]) for _ in range(task["repeats"])]
    return {"load_s": load_s, "resident_mb": resident_mb(os.getpid()), **_rates(found)}


def unread(task: Mapping[str, Any]) -> dict[str, object]:
    """Step a world of `vehicles` of a `kind` in two ways in turn: as `load` returns it, without reading its samples, and as in a server without
    clients, which makes no samples.

    Returns:
        The first rate over the second, of processor time, one value for each of `repeats` of twice `seconds` of processor time.
    """
    world = loaded(task["kind"], task["vehicles"], True)
    ticks(world, _TICKS)
    gc.collect()
    gc.freeze()
    found = []
    for _ in range(task["repeats"]):
        rates = []
        for wanted in (None, ()):
            world.subscribe(wanted)
            rates.append(pace(lambda: ticks(world, _TICKS), _TICKS, task["seconds"])[0])
        found.append(rates[0] / rates[1])
    return {"ratio": found}


def thrust(task: Mapping[str, Any]) -> dict[str, object]:
    """Step `vehicles` without sensors, commanded ten times per second: physics and thrusters alone.

    Returns:
        Rates as of `fly`, and the number of threads that step the world; by then it has found out whether more are faster.
    """
    contender = OpenWater(task["vehicles"], threads=1 if task["one_core"] else "auto")
    contender.prepare()
    contender.run(_TICKS)
    threads = contender.world.threads
    while threads.trial is not None:
        contender.run(_TICKS)
    found = [pace(lambda: contender.run(_TICKS), _TICKS, task["seconds"]) for _ in range(task["repeats"])]
    return {"threads": threads.count, **_rates(found)}


def read(task: Mapping[str, Any]) -> dict[str, object]:
    """Measure the readings of the IMUs of `vehicles`.

    Returns:
        Processor time of a sample with all errors, from reading to delivery, us; and what white noise on the specific force adds to an exact sample.
    """
    world = loaded("inertial", task["vehicles"], True)
    world.subscribe(())
    ticks(world, _TICKS)
    due = {kind: _heads(world, task["vehicles"], kind) for kind in ("inertial", "exact", "noisy")}
    sensor = world.sensors[f"{names(1)[0]}/inertial"].sensor
    assert isinstance(sensor, CompiledSensor)
    here, kernel, count, now = world.sensor_arrays, sensor.kernel, task["vehicles"], world.t_ns
    # Time goes on, so that samples in flight arrive as in a world, although no vehicle moves.
    times = itertools.count(now, NANOSECONDS // RATE_HZ)

    compiled_deliver, (*_, run) = straight(delivery.deliver), loops_of(kernel)
    measured = (
        straight(run),
        here.heads.rows,
        here.rows_of(kernel).rows,
        here.numbers.rows,
        due["inertial"],
        here.surroundings,
    )

    def deliver(kind: str) -> None:
        here.take_over()
        here.make_room(count)
        table, values, delivered_values = here.to_deliver()
        compiled_deliver(table, due[kind], next(times), True, values, delivered_values)

    def sample() -> None:
        measured[0](*measured[1:], now / NANOSECONDS)
        deliver("inertial")

    samples, noises = [], []
    for _ in range(task["repeats"]):
        samples.append(_us_each(sample, count, task["seconds"]))
        exact, noisy = (_us_each(partial(deliver, kind), count, task["seconds"]) for kind in ("exact", "noisy"))
        noises.append(noisy - exact)
    return {"sample_us": samples, "noise_us": noises}


def copy(task: Mapping[str, Any]) -> dict[str, object]:
    """Make a batch of `copies` of a BlueROV2 Heavy with these `sensors`, in the water of a `kind`, and step it, commanded ten times per second.

    Returns:
        Processor time of loading with compiled kernels, s; vehicle-steps per second of wall time, one value for each of `repeats` of `seconds` of
        processor time.
    """
    copied(1, task["sensors"], task["kind"])
    begin = processor_ns()
    batch = copied(task["copies"], task["sensors"], task["kind"])
    load_s = (processor_ns() - begin) * 1e-9
    u = np.random.default_rng(1).uniform(-0.5, 0.5, (batch.n, *batch.commands[_THRUSTERS].fields[0].shape))

    def run() -> None:
        batch.command(_THRUSTERS, u=u)
        batch.step(_TICKS)

    run()
    gc.collect()
    gc.freeze()
    found = [pace(run, _TICKS, task["seconds"]) for _ in range(task["repeats"])]
    return {"load_s": load_s, "steps_per_s": [batch.n * RATE_HZ * of_wall_time for _, of_wall_time in found]}


def copied(copies: int, sensors: Sequence[str], kind: Kind) -> Batch:
    """Return a batch at t = 0."""
    with scenario_file(scenario(kind, 1, True)) as file:
        return uwserver.batch(file, copies, sensors=[f"{names(1)[0]}/{name}" for name in sensors])


def loaded(kind: Kind, vehicles: int, one_core: bool) -> World:
    """Return a swarm at t = 0."""
    with scenario_file(scenario(kind, vehicles, one_core)) as file:
        return build(load(file, adapters={}))


def ticks(world: World, count: int) -> None:
    """Step a world as a program does, and drop its output."""
    world.step(count)


def set_out(world: World, vehicles: int) -> None:
    """Start the missions of all vehicles."""
    for k, name in enumerate(names(vehicles)):
        world.call(f"{name}/autopilot/set_mission", items=mission(k))
        world.call(f"{name}/autopilot/arm")
        world.call(f"{name}/autopilot/start_mission")


def pace(run: Callable[[], None], steps: int, seconds: float) -> tuple[float, float]:
    """Return simulated over processor time and over wall time, of so many seconds of processor time. `run` makes some steps."""
    begin, wall, done = processor_ns(), _clock.now_ns(), 0
    while (spent := processor_ns() - begin) < seconds * NANOSECONDS or not done:
        run()
        done += steps
    simulated = done / RATE_HZ * NANOSECONDS
    return simulated / spent, simulated / (_clock.now_ns() - wall)


def _rates(found: Sequence[tuple[float, float]]) -> dict[str, object]:
    return {"of_processor_time": [each for each, _ in found], "of_wall_time": [each for _, each in found]}


def _heads(world: World, vehicles: int, sensor: str) -> IntArray:
    return np.array([world.sensors[f"{name}/{sensor}"].head for name in names(vehicles)])


def _us_each(run: Callable[[], None], count: int, seconds: float) -> float:
    """Return the processor time of each of the `count` steps of a run, us."""
    begin, done = processor_ns(), 0
    while (spent := processor_ns() - begin) < seconds * NANOSECONDS or not done:
        for _ in range(_TICKS):
            run()
        done += _TICKS
    return spent * 1e-3 / (done * count)


_TASKS: Mapping[str, Callable[[Mapping[str, Any]], dict[str, object]]] = {
    "fly": fly, "unread": unread, "thrust": thrust, "read": read, "copy": copy,
}  # fmt: skip


if __name__ == "__main__":
    carry_out(_TASKS, "swarm", (ScenarioError, Refused, ImportError))
