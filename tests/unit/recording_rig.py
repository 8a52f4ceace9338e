"""Small recordings made in the test's own process: a world is stepped, and what a recorder would write is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from uwserver.ports import Call, Command
from uwserver.recording.format import Request
from uwserver.recording.transcript import Transcript
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved

SEED = 5
TIMING = {"mode": "freerun"}


def recorded(
    path: Path,
    resolved: Resolved,
    ticks: int,
    requests: Mapping[int, Sequence[Command | Call]] = {},
    *,
    finished: bool = True,
    seed: int = SEED,
) -> Path:
    """A recording of so many ticks, with these requests at the starts of ticks; not `finished`: as of a server that was killed."""
    world = build(resolved, seed)
    with path.open("xb") as file:
        transcript = Transcript(file, world, resolved, TIMING, {})
        for tick in range(ticks):
            items = requests.get(tick, ())
            if items:
                transcript.requested([Request.of(item, 0, 0, tick) for item in items])
            for item in items:
                world.submit(item)
            transcript.ticked(world.advance())
        if finished:
            transcript.finish()
    return path
