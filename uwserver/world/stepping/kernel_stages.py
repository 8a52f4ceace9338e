"""The kernels of sensors, autopilots and steps, in the stages in which they are compiled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from typing import Any

import numpy as np

from uwserver.environment.acoustics import channel
from uwserver.modifiers import choosing
from uwserver.physics.kernel.random import draw_normals
from uwserver.physics.kernel.store import kernel_name
from uwserver.sensors import compiled, truth
from uwserver.sensors.acoustic.cross_talk import CompiledSonar
from uwserver.sensors.compiled import CompiledSensor, SensorKernel

Stage = tuple[Callable[[], None], Iterable[Any]]
"""A function that loads the kernels of a stage, and these kernels."""


def _kinds(base: type[CompiledSensor]) -> Iterator[type[CompiledSensor]]:
    for kind in base.__subclasses__():
        if kind.__module__.startswith("uwserver."):
            yield kind
            yield from _kinds(kind)


def _stage_of(kind: type[CompiledSensor]) -> str:
    if issubclass(kind, CompiledSonar):
        return "sonars"
    return "soundings" if kind.kernel.aims else "sensors"


def _sensor_kernels(stage: str) -> Iterable[SensorKernel]:
    """Return the kernels of all sensor kinds of a stage: `sonars`, other kinds that cast rays (`soundings`), or kinds that cast none (`sensors`)."""
    assert truth  # No table names its kinds, so nothing else imports them.
    kinds = [kind for kind in _kinds(CompiledSensor) if "kernel" in vars(kind)]
    return {id(kind.kernel): kind.kernel for kind in kinds if _stage_of(kind) == stage}.values()


def _sensor_stage(stage: str) -> Stage:
    kernels = _sensor_kernels(stage)

    def load() -> None:
        for each in kernels:
            compiled.load(each)

    return load, [loop for each in kernels for loop in compiled.loops_of(each)]


# These functions import their kernels themselves: a world needs few stages, and imports take time.
def _sensors() -> Stage:
    from uwserver.modifiers import chain
    from uwserver.step import delivery, tick

    load_sensors, kernels = _sensor_stage("sensors")

    def load() -> None:
        delivery.load()
        tick.load()
        choosing.load()
        chain.load()
        draw_normals(0, 1)
        load_sensors()

    return load, [delivery.deliver, tick.step, chain.disturb_alone.made(), choosing.choose_samples.made(), *kernels]


def _sound() -> Stage:
    return channel.load_kernels, channel.kernels()


def _pictures() -> Stage:
    from uwserver.sensors.acoustic.imaging import kernels

    return kernels.load, [kernel.made() for kernel in kernels.KERNELS]


def _cameras() -> Stage:
    from uwserver.sensors.optical.camera import kernels

    return kernels.load, [kernel.made() for kernel in kernels.KERNELS]


def _autopilots() -> Stage:
    from uwserver.autopilot import entries
    from uwserver.step.streams import ENTRY

    return partial(entries.load, np.zeros(0, ENTRY)), entries.ENTRIES


def _copies() -> Stage:
    from uwserver.step import many

    return many.load, many.KERNELS


STAGES: dict[str, Callable[[], Stage]] = {
    "sensors": _sensors,
    "soundings": partial(_sensor_stage, "soundings"),
    "sonars": partial(_sensor_stage, "sonars"),
    "sound": _sound,
    "pictures": _pictures,
    "autopilots": _autopilots,
    "cameras": _cameras,
    "copies": _copies,
}
"""Gives the kernels of each stage."""


def load(stage: str) -> None:
    """Compile the kernels of a stage, or load them from the cache."""
    STAGES[stage]()[0]()


@cache
def kernels_of(stage: str) -> tuple[str, ...]:
    """Return the names of the kernels of a stage, as the cache has them."""
    return tuple(kernel_name(kernel.py_func) for kernel in STAGES[stage]()[1])
