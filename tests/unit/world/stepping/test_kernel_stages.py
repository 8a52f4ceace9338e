"""The kernels of sensors and autopilots, by stages: all are there, each once, under the names by which the cache finds them."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import uwserver.sensors
from uwserver.physics.kernel.deferred import Deferred
from uwserver.world.stepping import kernel_stages


def test_every_loop_of_a_sensor_belongs_to_a_stage() -> None:
    """A kind that is added and forgotten here would be compiled within a tick."""
    loops = set()
    for module in pkgutil.walk_packages(uwserver.sensors.__path__, "uwserver.sensors."):
        made: list[Deferred] = []
        for name, value in vars(importlib.import_module(module.name)).items():
            if isinstance(value, Deferred) and value._form == "entry" and name.startswith(("aim", "refine")):
                made.append(value)
            elif isinstance(value, type) and value.__module__ == module.name and "kernel" in vars(value):
                kernel = vars(value)["kernel"]
                made += [kernel.run, *kernel.aims]
        loops |= {f"{module.name.rpartition('.')[2]}.{kernel.py_func.__qualname__}" for kernel in made}
    kernels = {
        name.partition("+")[0]
        for stage in ("sensors", "soundings", "sonars")
        for name in kernel_stages.kernels_of(stage)
    }
    assert loops
    assert kernels == loops | {
        "delivery.deliver",
        "tick.step",
        "chain.disturb_alone",
        "choosing.choose_samples",
    }


@pytest.mark.parametrize("stage", kernel_stages.STAGES)
def test_a_stage_loads_the_kernels_that_it_names(stage: str) -> None:
    kernel_stages.load(stage)
    kernels = list(kernel_stages.STAGES[stage]()[1])
    assert len(kernels) == len(kernel_stages.kernels_of(stage)) > 0
    assert all(kernel.signatures for kernel in kernels)
