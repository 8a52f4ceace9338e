"""Compiles the loops over copies, so that no step has to; ``python -m uwserver.copies.warm`` (all of them, in this process)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np

from uwserver.copies.clocks import clocks_of
from uwserver.copies.rounds import is_fitted
from uwserver.physics.rays.raycast import no_hits
from uwserver.sensors.bank import BankSensor
from uwserver.world.banks import banks_of_all
from uwserver.world.builds import Work
from uwserver.world.piloting import Piloting
from uwserver.world.warm import compile_for_parent
from uwserver.world.world import World

SECONDS = {
    "copies": 5.0, "free copies": 8.0, "fitted copies": 8.0, "sea of copies": 2.0, "sensors of copies": 9.0,
    "soundings of copies": 4.0, "autopilots of copies": 8.0,
}  # fmt: skip
"""Stages as `builds.STAGES`, each for what copies may have."""

Like = Iterator[tuple[Any, tuple[Any, ...]]]
"""Kernels, each with arguments of the types that it gets."""


def stages_of(world: World) -> frozenset[str]:
    """What copies of a world need."""
    sensors = [slot.sensor for slot in world.sensors.values() if isinstance(slot.sensor, BankSensor)]
    needs = {
        "copies": True,
        "fitted copies" if is_fitted(world.hydro) else "free copies": True,
        "sea of copies": world.hydro.sea is not None,
        "sensors of copies": bool(sensors),
        "soundings of copies": any(sensor.bank.aims for sensor in sensors),
        "autopilots of copies": any(isinstance(part, Piloting) for part in world.parts.values()),
    }
    return frozenset(stage for stage, is_needed in needs.items() if is_needed)


def _numbers(dimensions: int) -> Any:
    return np.zeros((0,) * dimensions, np.int64)


def _floats(dimensions: int) -> Any:
    return np.zeros((0,) * dimensions)


_which = _times_ns = _ticks = _numbers(1)
_tables = _numbers(3)
_ts = _floats(1)
_clocks = clocks_of(0)


def _copies() -> Like:
    from uwserver.copies import kernels

    due, values, told = _numbers(1), _floats(3), _numbers(2)
    yield kernels.tick, (_which, _clocks, 1, 1)
    yield kernels.find_due, (_which, _clocks, _numbers(1), told, _tables, _numbers(1), _numbers(1))
    yield kernels.deliver, (_which, _tables, due, _times_ns, True, values, values, told)
    yield kernels.command_thrusters, (_which, _tables, _numbers(1), _floats(2), 0)
    yield kernels.command_servos, (_which, _tables, _numbers(1), _floats(2))
    yield kernels.command_wrench, (_which, _tables, 0, _floats(2))
    yield kernels.copy_states, (_tables, 0, _floats(2))
    yield kernels.copy_newest, (_tables, 0, _floats(2), _numbers(2))


def _free() -> Like:
    from uwserver.copies import kernels

    yield kernels.advance, (_which, _tables, _ts, 0.0, _numbers(1), 0)
    yield kernels.look, (_which, _tables, _tables, _ts, 0)


def _fitted() -> Like:
    from uwserver.copies import kernels

    yield kernels.advance_fitted, (_which, _tables, _ts, 0.0, _numbers(1), 0)
    yield kernels.look_fitted, (_which, _tables, _tables, _ts, 0)


def _sea() -> Like:
    from uwserver.copies import kernels

    yield kernels.fill_flows, (_which, _tables, _tables, _ts, 0.0)
    yield kernels.move_sea, (_which, _tables, _ticks, _ts, _numbers(4), _numbers(1), _floats(2), 0.0)


def _sensors() -> Like:
    from uwserver.copies import loops

    for bank in banks_of_all(False).values():
        yield loops.loop_of(bank), (_which, _tables, _tables, _tables, _ts, _numbers(1))


def _soundings() -> Like:
    from uwserver.copies import loops

    for bank in banks_of_all(True).values():
        more = _floats(3), _numbers(1), no_hits(0)
        yield loops.loop_of(bank), (_which, _tables, _tables, _tables, _ts, _numbers(1), *more)


def _autopilots() -> Like:
    from uwserver.copies import kernels

    yield kernels.hear, (_which, _tables, _tables, _floats(3), _numbers(2), _times_ns)
    yield kernels.fly, (_which, _tables, _tables, _ticks, _times_ns, _numbers(1))


KERNELS: dict[str, Callable[[], Like]] = {
    "copies": _copies, "free copies": _free, "fitted copies": _fitted, "sea of copies": _sea, "sensors of copies": _sensors,
    "soundings of copies": _soundings, "autopilots of copies": _autopilots,
}  # fmt: skip
"""By stage."""


@cache
def _kernels_of(stage: str) -> tuple[str, ...]:
    # It needs numba.
    from uwserver.physics.kernel.caches import kernel_name

    return tuple(kernel_name(kernel.py_func) for kernel, _ in KERNELS[stage]())


def load(stage: str) -> None:
    """Have the kernels of a stage ready, compiled or from the cache."""
    for kernel, like in KERNELS[stage]():
        kernel.load(*like)


OF_COPIES = Work(SECONDS, _kernels_of, "uwserver.copies.warm")
"""For `builds.prepare`."""


def _main() -> None:
    from functools import partial

    stages = {stage: partial(load, stage) for stage in KERNELS}
    compile_for_parent(sys.argv[1:] or ["--nice", "0", *stages], stages)


if __name__ == "__main__":
    _main()
