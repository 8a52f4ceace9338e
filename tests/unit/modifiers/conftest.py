"""Modifiers on a bench: a stream of one wide field, whose components are as many independent runs of the same error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uwserver.modifiers import Measurement, Modifier, ModifierConfig, Stream
from uwserver.physics.kernel.random import key_of
from uwserver.ports import Field

Bench = Callable[..., Modifier]


@pytest.fixture
def bench() -> Bench:
    """`bench(config, shape=(3,), dt=0.01, seed=1, path="rov/imu/noise")` builds a modifier of a field `x`, unit m."""

    def build(
        config: ModifierConfig,
        shape: tuple[int, ...] = (3,),
        dt: float = 0.01,
        seed: int = 1,
        path: str = "rov/imu/noise",
    ) -> Modifier:
        fields = (
            Field("before", "m", ""),
            Field("x", "m", "", "S" if shape == (3,) else "", shape=shape),
            Field("ok", "1", "", type="bool"),
        )
        return config.build(Stream(fields, dt, key_of(seed, path)))

    return build


@pytest.fixture
def errors() -> Callable[[Modifier, int], np.ndarray]:
    """`errors(modifier, n)` gives (n, size) errors that it adds to n readings of zero; time goes on from call to call."""
    clocks: dict[Modifier, tuple[int, int]] = {}  # not by id(), which another modifier may get when this one has gone

    def run(modifier: Modifier, n: int) -> np.ndarray:
        size = modifier.stream.fields[1].size
        rows = []
        for _ in range(n):
            t_ns, number = clocks.get(modifier, (0, -1))
            t_ns, number = clocks[modifier] = t_ns + round(modifier.stream.dt * 1e9), number + 1
            reading = Measurement([7.0, (0.0,) * size, True], True, t_ns=t_ns, number=number)
            modifier.apply(reading)
            assert reading.values[0] == 7.0  # the other fields stay as they were
            assert reading.values[2] is True
            assert reading.valid
            rows.append(reading.values[1])
        return np.array(rows)

    return run
