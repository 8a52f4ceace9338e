"""Makes a batch from a resolved scenario."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any

from uwserver.copies.admission import check
from uwserver.copies.batch import Batch
from uwserver.copies.ranges import threads_for
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.world.builds import prepare, progress


def begin(
    resolved: Resolved,
    n: int,
    seeds: int | Sequence[int] | None,
    sensors: Collection[str] | None,
    parameters: Mapping[str, Any],
    threads: int | None = None,
) -> Batch:
    """Return the batch, after compiling what it needs.

    Args:
        resolved: a loaded and checked scenario.
        n, seeds, sensors, parameters, threads: as for `uwserver.batch`.

    Raises:
        Refused: less than one copy, another number of seeds, refused by `admission.check`, no such sensor or parameter, or a wrong number
            of threads.
    """
    if n < 1:
        raise Refused("out_of_range", f"a batch has 1 copy or more, not {n}", "n")
    first = resolved.scenario.seed if seeds is None else seeds
    numbers = [first + k for k in range(n)] if isinstance(first, int) else [int(seed) for seed in first]
    if len(numbers) != n:
        raise Refused("bad_shape", f"{len(numbers)} seeds for {n} copies", "seeds")
    count = threads_for(n, threads)
    world = build(resolved, numbers[0])
    check(resolved, world)
    prepare({"copies"}, progress())
    return Batch(partial(build, resolved, like=world), numbers, sensors, parameters, count)
