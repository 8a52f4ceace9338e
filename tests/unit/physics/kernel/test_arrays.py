"""The names of arrays mean the types that the kernels' arrays have."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records
from uwserver.physics.kernel.layout import WORLD, addresses


def scalar(array: Any) -> Any:
    """The type of an element of ``NDArray[...]``."""
    (element,) = get_args(get_args(array)[1])
    return element


@pytest.mark.parametrize(("array", "element"), [(FloatArray, np.float64), (IntArray, np.int64), (Records, np.void)])
def test_each_name_is_of_one_element(array: Any, element: type[np.generic]) -> None:
    assert scalar(array) is element


def test_arrays_of_a_world_are_numbers_or_records() -> None:
    hydro = Hydrodynamics((), 0.01)
    assert addresses(WORLD, vars(hydro)).dtype == scalar(IntArray)
    for name in WORLD:
        array = getattr(hydro, name)
        kind = IntArray if name == "team" else Records if array.dtype.names else FloatArray
        assert array.dtype.type is scalar(kind), name
