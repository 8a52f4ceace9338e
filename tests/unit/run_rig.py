"""The whole life of a server without peers, in the test's own process: what `uwserver run --mode freerun --record` does, without its start."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from uwserver.scenario.load.scenario import load
from uwserver.server.life_cycle import Options, Server
from uwserver.server.process import run
from uwserver.simulation.clock import Timing

PATIENCE_S = 120.0


def recorded_run(scenario: Path, record: Path, until_s: float, **options: Any) -> Path:
    """Serve a scenario until a simulation time, as fast as it goes, and record it.

    Args:
        scenario: a file; nothing of it listens.
        record: file to write.
        until_s: as of the command line.
        options: others of `Options`.
    """
    resolved = load(scenario, adapters={})
    silent = msgspec.structs.replace(resolved.scenario.server, metrics=False)
    alone = replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters={}, server=silent))

    async def serve() -> int:
        given = Options(timing=Timing("freerun"), record=record, until_s=until_s, **options)
        return await asyncio.wait_for(Server(alone, given).run(), PATIENCE_S)

    assert run(serve()) == 0
    return record
