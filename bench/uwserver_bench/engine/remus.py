"""The REMUS 100 compared with that of the Python Vehicle Simulator, if a copy of the simulator is present.

The simulator is not on a package index: clone its repository, and set the environment variable UWSERVER_PVS to its `src` folder.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.simulation.clock import SystemTime
from uwserver_bench.report import Row

VARIABLE = "UWSERVER_PVS"
BAR = 20.0
SPEED_RADPS = 159.0
ITS_SAMPLES = 10_000
"""Number of steps of a run in its main.py."""


class OurRemus:
    """A remus100_pvs with the propeller of the simulator, stepped by `World.advance` and commanded at 10 Hz."""

    def __init__(self) -> None:
        entry = VehicleEntry(model="remus100_pvs", position_ned_m=(0.0, 0.0, 1000.0))
        self._world = build(load(Scenario(schema=1, vehicles={"auv": entry}), adapters={}))
        for path in self._world.sensors:
            self._world.call(f"{path}/deactivate")

    def run(self, steps: int) -> None:
        """Make ticks with their commands: propeller ahead, rudder to both sides."""
        world = self._world
        for tick in range(steps):
            if tick % 24 == 0:
                world.command("auv/propeller", speed_radps=SPEED_RADPS)
                world.command("auv/rudder", angle_rad=0.05 if tick % 48 else -0.05)
            world.advance()


class OurBody(OurRemus):
    """The same with the kernel alone, without clock, commands and watchdogs."""

    def run(self, steps: int) -> None:
        """Make ticks with the present commands."""
        hydro = self._world.hydro
        for _ in range(steps):
            hydro.advance(0.0)


class TheirRemus:
    """`remus100.dynamics` and the step of the attitude, as the main loop of the simulator calls them; and this loop itself."""

    def __init__(self, source: Path) -> None:
        sys.path.insert(0, str(source))
        try:
            vehicles: Any = importlib.import_module("python_vehicle_simulator.vehicles.remus100")
            gnc: Any = importlib.import_module("python_vehicle_simulator.lib.gnc")
            self._loop: Any = importlib.import_module("python_vehicle_simulator.lib.mainLoop").simulate
        finally:
            sys.path.remove(str(source))
        self._vehicle, self._attitude = vehicles.remus100(), gnc.attitudeEuler
        self._eta, self._nu, self._u = np.zeros(6), self._vehicle.nu, self._vehicle.u_actual

    def run(self, steps: int) -> None:
        """Make steps of 1/240 s."""
        dt = 1.0 / 240.0
        for k in range(steps):
            command = self._vehicle.stepInput(k * dt)
            self._nu, self._u = self._vehicle.dynamics(self._eta, self._nu, self._u, command, dt)
            self._eta = self._attitude(self._eta, self._nu, dt)

    def loop(self, steps: int) -> None:
        """Run its main loop. It also stores all results, so that the cost of a step grows with their number."""
        self._loop(steps, 1.0 / 240.0, self._vehicle)


def bench_remus(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return our steps per second over theirs.

    Args:
        quick: two short repeats.
        say: gets a line of progress.
    """
    whole, bare, mixed = (
        "a step of PythonVehicleSimulator's remus100, main loop / ours, World.advance with commands",
        "the same, dynamics and attitude alone / ours, kernel alone",
        "the same, dynamics and attitude alone / ours, World.advance with commands",
    )
    source = os.environ.get(VARIABLE, "")
    if not source:
        return [Row("physics", whole, "ratio", (), BAR, note=f"not measured: {VARIABLE} does not name its src folder")]
    try:
        theirs = TheirRemus(Path(source))
    except ImportError as error:
        return [Row("physics", whole, "ratio", (), BAR, note=f"not measured: {source}: {error}")]
    say("physics: REMUS 100 against the Python Vehicle Simulator")
    ours, body, repeats = OurRemus(), OurBody(), 2 if quick else 7
    ours.run(100)
    rates, loops, bares, mixes = list[float](), list[float](), list[float](), list[float]()
    for _ in range(repeats):
        own = _seconds_a_step(ours.run, 1000 if quick else 20_000)
        kernel = _seconds_a_step(body.run, 1000 if quick else 20_000)
        other = _seconds_a_step(theirs.run, 100 if quick else 2000)
        loop = _seconds_a_step(theirs.loop, 100 if quick else ITS_SAMPLES)
        rates.append(1.0 / own)
        loops.append(loop / own)
        bares.append(other / kernel)
        mixes.append(other / own)
    return [
        Row("physics", "REMUS 100, one vehicle with fins and propeller", "steps/s", tuple(rates)),
        Row("physics", whole, "ratio", tuple(loops), BAR),
        Row("physics", bare, "ratio", tuple(bares), BAR),
        Row("physics", mixed, "ratio", tuple(mixes)),
    ]


def _seconds_a_step(run: Callable[[int], None], steps: int) -> float:
    clock = SystemTime()
    start = clock.now_ns()
    run(steps)
    return (clock.now_ns() - start) * 1e-9 / steps
