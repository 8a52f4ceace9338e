"""Arrays that a kernel finds through a table of addresses: the right ones, whatever the order of the list, and without a copy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from uwserver.physics.kernel.compiled import entry
from uwserver.physics.kernel.handles import array_at, arrays_at
from uwserver.physics.kernel.layout import SERVO, Forms, addresses, columns


class Pair(NamedTuple):
    """What the kernels below work on."""

    rows: Any
    points: Any


FORMS: Forms = {"points": columns(np.float64, 3), "flags": columns(np.int64), "rows": SERVO}


@pytest.mark.parametrize("order", [("points", "flags", "rows"), ("flags", "rows", "points")])
def test_a_reordered_list_gives_the_same_arrays(order: tuple[str, ...]) -> None:
    """Who writes a table and who reads it have their order from one list."""
    forms = {name: FORMS[name] for name in order}
    pair_at, flags_at = arrays_at(Pair, forms), array_at(forms, "flags")

    @entry
    def total(table: Any) -> tuple[float, float, int]:
        pair, flags = pair_at(table), flags_at(table)
        return pair.rows[2].tau, pair.points[1, 2], flags[3]

    given = {"rows": np.zeros(3, SERVO), "points": np.arange(6.0).reshape(2, 3), "flags": np.arange(4)}
    given["rows"]["tau"] = 0.1, 0.2, 0.3
    assert total(addresses(forms, given)) == (0.3, 5.0, 3)


def test_what_a_kernel_writes_is_in_the_array() -> None:
    points_at, rows_at = array_at(FORMS, "points"), array_at(FORMS, "rows")

    @entry
    def write(table: Any) -> int:
        points_at(table)[1, 0] = 7.0
        rows_at(table)[0].value = 8.0
        return len(points_at(table))

    given = {"rows": np.zeros(1, SERVO), "points": np.zeros((2, 3)), "flags": np.zeros(0, np.int64)}
    assert write(addresses(FORMS, given)) == 2
    assert given["points"][1, 0] == 7.0
    assert given["rows"]["value"][0] == 8.0


def test_rows_of_matrices() -> None:
    forms: Forms = {"R": columns(np.float64, 3, 3)}
    at = array_at(forms, "R")

    @entry
    def element(table: Any) -> float:
        return float(at(table)[1, 2, 0])

    R = np.arange(18.0).reshape(2, 3, 3)  # a table does not keep it alive
    assert element(addresses(forms, {"R": R})) == 15.0


def test_a_name_that_is_not_in_the_list() -> None:
    with pytest.raises(ValueError, match="nothing"):
        array_at(FORMS, "nothing")
