"""Entries called straight give the same."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.compiled import entry
from uwserver.physics.kernel.straight import straight


def test_an_entry_with_one_version_is_called_without_numbas_search() -> None:
    def add(a: np.ndarray, b: float) -> float:
        return float(a[0] + b)

    kernel = entry(add)
    assert straight(kernel) is kernel, "it is not loaded"
    kernel.load(np.zeros(1), 0.0)
    run = straight(kernel)
    assert run is not kernel
    assert run(np.array([2.0]), 0.5) == kernel(np.array([2.0]), 0.5) == 2.5
    assert run(np.array([2.0]), 1) == 3.0, "plain numbers become those of its types"
    kernel.load(np.zeros(1, np.int64), 0.0)
    assert straight(kernel) is kernel, "which version is meant is numba's to find"
