"""Kernels of sensors, autopilots and steps, by the stages in which they are compiled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

import numpy as np

from uwserver.environment.acoustics import channel
from uwserver.modifiers import choosing
from uwserver.physics.kernel.fingerprint import kernel_name
from uwserver.physics.kernel.random import draw_normals
from uwserver.sensors import bank, truth
from uwserver.sensors.acoustic.cross_talk import BankSonar
from uwserver.sensors.bank import Bank, BankSensor


def _kinds(base: type[BankSensor]) -> Iterator[type[BankSensor]]:
    for kind in base.__subclasses__():
        if kind.__module__.startswith("uwserver."):
            yield kind
            yield from _kinds(kind)


def banks_of_all(stage: str) -> dict[int, Bank]:
    """The banks of all kinds of sensors of a stage: `sonars`, others that cast rays (`soundings`), or those that do not (`sensors`)."""
    assert truth  # whose kinds no table names
    kinds = [kind for kind in _kinds(BankSensor) if "bank" in vars(kind)]
    return {id(kind.bank): kind.bank for kind in kinds if _stage_of(kind) == stage}


def _stage_of(kind: type[BankSensor]) -> str:
    if issubclass(kind, BankSonar):
        return "sonars"
    return "soundings" if kind.bank.aims else "sensors"


def _loader_of(stage: str) -> Callable[[], None]:
    def load_all() -> None:
        for each in banks_of_all(stage).values():
            bank.load(each)

    return load_all


def _kernels_of_banks(stage: str) -> Callable[[], Iterable[Any]]:
    return lambda: [kernel for each in banks_of_all(stage).values() for kernel in bank.kernels(each)]


def _sensors() -> Iterable[Any]:
    from uwserver.modifiers.chain import disturb_alone
    from uwserver.step.delivery import deliver
    from uwserver.step.tick import step

    yield from (deliver, step, disturb_alone.made(), choosing.choose_samples.made())
    yield from _kernels_of_banks("sensors")()


def _load_sensors() -> None:
    from uwserver.modifiers import chain
    from uwserver.step import delivery, tick

    delivery.load()
    tick.load()
    choosing.load()
    chain.load()
    draw_normals(0, 1)
    _loader_of("sensors")()


def _load_pictures() -> None:
    from uwserver.sensors.acoustic.imaging.kernels import load

    load()


def _pictures() -> Iterable[Any]:
    from uwserver.sensors.acoustic.imaging.kernels import KERNELS

    return [kernel.made() for kernel in KERNELS]


def _load_cameras() -> None:
    from uwserver.sensors.optical.camera.kernels import load

    load()


def _cameras() -> Iterable[Any]:
    from uwserver.sensors.optical.camera.kernels import KERNELS

    return [kernel.made() for kernel in KERNELS]


def _autopilots() -> Iterable[Any]:
    from uwserver.autopilot.entries import ENTRIES

    return ENTRIES


def load_autopilots() -> None:
    """Have those of autopilots ready, compiled or from the cache."""
    from uwserver.autopilot import entries
    from uwserver.step.streams import ENTRY

    entries.load(np.zeros(0, ENTRY))


def _load_copies() -> None:
    from uwserver.step import many

    many.load()


def _copies() -> Iterable[Any]:
    from uwserver.step.many import KERNELS

    return KERNELS


COMPILE: dict[str, Callable[[], None]] = {
    "sensors": _load_sensors, "soundings": _loader_of("soundings"), "sonars": _loader_of("sonars"), "sound": channel.load_kernels,
    "pictures": _load_pictures,
    "autopilots": load_autopilots, "cameras": _load_cameras, "copies": _load_copies,
}  # fmt: skip
"""What compiles the kernels of a stage, and no others."""

_KERNELS: dict[str, Callable[[], Iterable[Any]]] = {
    "sensors": _sensors,
    "soundings": _kernels_of_banks("soundings"),
    "sonars": _kernels_of_banks("sonars"),
    "sound": channel.kernels,
    "pictures": _pictures,
    "autopilots": _autopilots,
    "cameras": _cameras,
    "copies": _copies,
}


@cache
def kernels_of(stage: str) -> tuple[str, ...]:
    """Names of the kernels of a stage, in the cache."""
    return tuple(kernel_name(kernel.py_func) for kernel in _KERNELS[stage]())
