"""uwserver: a headless co-simulation server for underwater robots.

In-process use, without a server or a socket::

    import uwserver

    world = uwserver.load("bluerov2_pool")
    world.command("bluerov2/thrusters", u=[0, 0, 0, 0, 0.3, 0.3, 0.3, 0.3])
    samples = world.step(240)
    print(world.vehicles["bluerov2"], world.read("bluerov2/depth").depth)
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from uwserver.scenario.load.tables import Scenario
    from uwserver.world.world import World

__all__ = ["__version__", "load"]


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
