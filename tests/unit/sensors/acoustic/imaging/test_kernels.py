"""Kernels of pictures are compiled with the others, under the names that they have in the cache."""

from __future__ import annotations

from uwserver.sensors.acoustic.imaging import kernels
from uwserver.world.stepping import kernel_stages


def test_all_that_python_calls_is_compiled_ahead() -> None:
    kernel_stages.load("pictures")
    assert all(kernel.made().signatures for kernel in kernels.KERNELS)
    assert len(set(kernel_stages.kernels_of("pictures"))) == len(kernels.KERNELS)
