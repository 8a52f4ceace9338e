"""Makes a batch from a resolved scenario.

It decides which scenarios can be copied. What a batch cannot do is refused by its name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from uwserver.copies.batch import Batch, seeds_of
from uwserver.copies.steps import threads_for
from uwserver.ports import Refused
from uwserver.ports.checks import checked_whole
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import DEFAULT_ADAPTER
from uwserver.sensors.modem import Modem
from uwserver.world.builds import prepare, progress
from uwserver.world.world import World


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
        Refused: less than one copy, another number of seeds, a wrong seed, a scenario that `check` refuses, no such sensor or parameter, or
            a wrong number of threads.
    """
    n = checked_whole("n", n, 1, "a batch has a whole number of copies, 1 or more")
    numbers = seeds_of(resolved.scenario.seed if seeds is None else seeds, range(n))
    count = threads_for(n, threads)
    world = build(resolved, numbers[0])
    check(resolved, world)
    prepare({"copies"}, progress())
    return Batch(partial(build, resolved, like=world), numbers, sensors, parameters, count)


def check(resolved: Resolved, world: World) -> None:
    """Refuse a scenario whose copies would not act as its world does.

    Args:
        resolved: the scenario.
        world: a world that was built from it.

    Raises:
        Refused: it has pictures, modems, extensions, or adapters that do more than let clients in; the text names all of them.
    """
    faults = [
        (what, names)
        for what, names in (
            ("pictures, which take time", [path for path, slot in world.sensors.items() if slot.sensor.takes_time]),
            (
                "modems, whose messages cannot be read",
                [p for p, s in world.sensors.items() if isinstance(s.sensor, Modem)],
            ),
            ("adapters, which a batch does not run", list(_adapters(resolved))),
            ("extensions, which act in a single world only", list(_extensions(world))),
        )
        if names
    ]
    if faults:
        text = "; ".join(f"{what}: {', '.join(names)}" for what, names in faults)
        raise Refused("denied", f"{resolved.name} cannot be copied: it has {text}. Take them out of the scenario.")


def _adapters(resolved: Resolved) -> Iterator[str]:
    """Yield all adapters except the kinds that a scenario gets by default. Those only let clients in, and no client can reach this process."""
    for name, config in resolved.scenario.adapters.items():
        kind = config.__struct_config__.tag
        if kind not in (DEFAULT_ADAPTER, "web"):
            yield f"adapters.{name} ({kind})"


def _extensions(world: World) -> Iterator[str]:
    for path, slot in world.sensors.items():
        if _is_foreign(slot.sensor):
            yield f"{path} ({slot.port.kind})"
        for stream in slot.streams:
            if any(_is_foreign(modifier) for modifier in stream.modifiers):
                yield f"{stream.port.path} (a modifier)"
    for path, actuator in world.actuators.items():
        if _is_foreign(actuator.actuator):
            yield f"{path} ({actuator.port.kind})"
    for part in world.parts.values():
        if _is_foreign(part):
            yield part.path


def _is_foreign(thing: object) -> bool:
    return not type(thing).__module__.startswith("uwserver.")
