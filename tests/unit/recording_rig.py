"""Small recordings made in the test's own process: a world is stepped, and what a recorder would write is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from uwserver.ports import Call, Command
from uwserver.recording.recorder import Recorder
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.simulation.clock import Timing

SEED = 5


def recorded(
    path: Path,
    resolved: Resolved,
    ticks: int,
    requests: Mapping[int, Sequence[Command | Call]] = {},
    *,
    seed: int = SEED,
) -> Path:
    """A recording of so many ticks, with these requests at the starts of ticks."""
    world = build(resolved, seed)
    recorder = Recorder(path, world, resolved)
    with recorder.stepped(Timing("freerun")):
        for tick in range(ticks):
            items = requests.get(tick, ())
            for item in items:
                recorder.requested(item, tick, sorted(requests).index(tick))
                world.submit(item)
            output = world.advance()
            recorder.ticked(world)
            for event in output.events:
                recorder.put_event(event)
            recorder.put_samples(output.samples)
            recorder.drain()
    return path
