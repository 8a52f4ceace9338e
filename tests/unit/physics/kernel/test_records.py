"""Rows end to end."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.layout import SERVO, THRUSTER
from uwserver.physics.kernel.records import joined


def rows(n: int, seed: int) -> np.ndarray:
    made = np.zeros(n, THRUSTER)
    made.view(np.float64)[:] = np.random.default_rng(seed).normal(size=made.view(np.float64).shape)
    return made


def test_rows_stand_one_after_the_other_bit_for_bit() -> None:
    a, b = rows(2, 1), rows(3, 2)
    together = joined([a, b[:0], b], THRUSTER)
    assert together.dtype == THRUSTER
    assert together.tobytes() == a.tobytes() + b.tobytes()


def test_they_are_new_and_can_be_written() -> None:
    a = rows(2, 1)
    before = a.tobytes()
    together = joined([a], THRUSTER)
    together["command"] = 0.5
    assert a.tobytes() == before


def test_nothing_is_an_empty_array() -> None:
    assert joined([], SERVO).dtype == SERVO
    assert len(joined([], SERVO)) == 0
