"""Sines, cosines and exponentials against those of the standard library."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from uwserver.physics.kernel import elementary
from uwserver.physics.kernel.arrays import FloatArray


@pytest.fixture(scope="module")
def kernels() -> Any:
    return elementary.sines_and_cosines.made(), elementary.exponentials.made()


def turned(kernels: Any, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    sin, cos = np.empty_like(angle), np.empty_like(angle)
    kernels[0](angle, sin, cos)
    return sin, cos


@pytest.mark.parametrize("largest", [1.0, 30.0, 1e3, 1e6])
def test_sines_and_cosines_are_those_of_the_library(kernels: Any, largest: float) -> None:
    angle = np.random.default_rng(1).uniform(-largest, largest, 20_000)
    sin, cos = turned(kernels, angle)
    assert np.abs(sin - [math.sin(a) for a in angle]).max() <= 3e-16
    assert np.abs(cos - [math.cos(a) for a in angle]).max() <= 3e-16


def test_quarters_of_turns_are_exact_where_they_can_be(kernels: Any) -> None:
    angle = np.array([k * 0.5 * math.pi for k in range(-9, 10)])
    sin, cos = turned(kernels, angle)
    np.testing.assert_allclose(sin, [math.sin(a) for a in angle], rtol=1e-14, atol=0.0)
    np.testing.assert_allclose(cos, [math.cos(a) for a in angle], rtol=1e-14, atol=0.0)
    assert turned(kernels, np.zeros(1)) == (0.0, 1.0)


def test_of_large_angles_they_are_as_exact_as_these(kernels: Any) -> None:
    angle = np.random.default_rng(2).uniform(1e6, 1e10, 20_000)
    sin, _ = turned(kernels, angle)
    assert (np.abs(sin - [math.sin(a) for a in angle]) <= np.spacing(angle)).all()


def test_what_is_no_number_stays_none(kernels: Any) -> None:
    sin, cos = turned(kernels, np.array([np.nan, np.inf]))
    assert np.isnan(sin).all()
    assert np.isnan(cos).all()


def test_exponentials_are_those_of_the_library(kernels: Any) -> None:
    x = np.concatenate([-np.random.default_rng(3).uniform(0.0, 690.0, 20_000), -np.logspace(-12, 2, 200), [0.0]])
    expected = np.array([math.exp(each) for each in x])
    found = x.copy()
    kernels[1](found, np.empty_like(x))
    assert np.abs(found / expected - 1.0).max() <= 5e-16
    assert found[-1] == 1.0


def test_least_exponents_give_next_to_nothing(kernels: Any) -> None:
    x = np.array([-700.0, -1e4, -np.inf])
    kernels[1](x, np.empty(3))
    assert (x == x[0]).all()
    assert 0.0 < x[0] < 1e-303
