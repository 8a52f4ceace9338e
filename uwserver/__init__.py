"""uwserver: a headless co-simulation server for underwater robots.

In-process use, without a server or a socket::

    import uwserver

    world = uwserver.load("bluerov2_pool")
    world.command("bluerov2/thrusters", u=[0, 0, 0, 0, 0.3, 0.3, 0.3, 0.3])
    samples = world.step(240)
    print(world.vehicles["bluerov2"], world.read("bluerov2/depth").depth)
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from uwserver.copies.batch import Batch
    from uwserver.scenario.load.tables import Scenario
    from uwserver.world.world import World

__all__ = ["__version__", "batch", "load"]


def load(scenario: str | Path | Scenario, *, seed: int | None = None) -> World:
    """A world at t = 0, to be stepped in this process.

    Args:
        scenario: name of a shipped scenario (``uwserver list``), path of a file, or a `Scenario` (see `uwserver.scenario.builder`).
        seed: instead of the scenario's.

    Raises:
        ScenarioError: every fault of the files, with its place.
    """
    # Imported here so that `import uwserver` stays quick.
    from uwserver.adapter import installed_adapters
    from uwserver.scenario.build.world import build
    from uwserver.scenario.load.scenario import load as load_scenario

    return build(load_scenario(scenario, adapters=installed_adapters()), seed)


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
        seeds: one a copy, or that of the first, from which the others count on; default: the scenario's.
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
