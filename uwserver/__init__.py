"""uwserver: a headless co-simulation server for underwater robots.

In-process use, without a server or a socket::

    import uwserver

    with uwserver.load("bluerov2_pool") as world:
        dive = world.record("bluerov2/*")
        for _ in range(50):
            world.command("bluerov2/thrusters", u=[0, 0, 0, 0, 0.3, 0.3, 0.3, 0.3])
            world.step(seconds=0.1)
        print(world.vehicles["bluerov2"].p_NB, world.read("bluerov2/depth").depth)
    print(dive["bluerov2/depth"].to_frame())

`World` has what such a program needs; ``world.describe()`` lists the ports and services of a world. Wrong requests raise `Refused`, and
scenarios that cannot run raise `ScenarioError`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uwserver.version import __version__

if TYPE_CHECKING:
    from uwserver.copies.batch import Batch
    from uwserver.in_process import Pose, Serving, Trace, Traces, Vehicle, Velocity, World
    from uwserver.ports import Refused
    from uwserver.scenario.builder import ScenarioBuilder
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.tables import Scenario
    from uwserver.world import Diverged
    from uwserver.world.sensing.reading import Reading

__all__ = [
    "Batch", "Diverged", "Pose", "Reading", "Refused", "Scenario", "ScenarioBuilder", "ScenarioError", "Serving", "Trace", "Traces", "Vehicle",
    "Velocity", "World", "__version__", "batch", "load",
]  # fmt: skip

_HOMES = {
    "Batch": "copies.batch", "Diverged": "world", "Pose": "in_process", "Reading": "world.sensing.reading", "Refused": "ports",
    "Scenario": "scenario.load.tables", "ScenarioBuilder": "scenario.builder", "ScenarioError": "scenario.files.errors",
    "Serving": "in_process", "Trace": "in_process", "Traces": "in_process", "Vehicle": "in_process", "Velocity": "in_process", "World": "in_process",
}  # fmt: skip
"""The module of each public class. They are imported when they are first needed, so that `import uwserver` stays quick."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)


def load(scenario: str | Path | Scenario, *, seed: int | None = None) -> World:
    """Return a world at t = 0, to be stepped in this process.

    Args:
        scenario: name of a shipped scenario (``uwserver list``), path of a file, or a `Scenario` (see `ScenarioBuilder`).
        seed: seed of all random numbers, instead of the scenario's: a whole number, 0 or more.

    Raises:
        ScenarioError: the files have faults; the text has all of them, each with its place.
        Refused: the seed is something else.
        TypeError: `scenario` is something else.
    """
    # Imported here so that `import uwserver` stays quick.
    from uwserver.adapter import installed_adapters
    from uwserver.in_process import World
    from uwserver.scenario.load.scenario import load as load_scenario

    return World(load_scenario(scenario, adapters=installed_adapters()), seed)


def batch(
    scenario: str | Path | Scenario,
    n: int,
    *,
    seeds: int | Sequence[int] | None = None,
    sensors: Collection[str] | None = None,
    threads: int | None = None,
    **parameters: Any,
) -> Batch:
    """n copies of a world at t = 0, to be stepped in one call, with arrays in and out. They know nothing of each other.

    Args:
        scenario: as for `load`. Adapters that only let clients in are left out, as there.
        n: how many, 1 or more.
        seeds: one a copy, or that of the first, from which the others count on: whole numbers, 0 or more; default: the scenario's.
        sensors: paths of those that measure, and of what they need; default: all but ``<vehicle>/autopilot/state``.
        threads: how many step the copies, that of the caller included; default: one a core, up to four, from 128 copies on, else one. They change
            no number, and end with the batch, or with its `close`.
        parameters: by name, for all copies or one value each; see `uwserver.copies.batch.Batch.reset`.

    Raises:
        ScenarioError: every fault of the files, with its place.
        Refused: pictures, modems, other adapters, or extensions, by name; no such sensor or parameter; so many threads.
    """
    from uwserver.adapter import installed_adapters
    from uwserver.copies.start import begin
    from uwserver.scenario.load.scenario import load as load_scenario

    return begin(load_scenario(scenario, adapters=installed_adapters()), n, seeds, sensors, parameters, threads)
