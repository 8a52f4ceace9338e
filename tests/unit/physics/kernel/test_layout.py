"""Tables of addresses: what they hold, and what they refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.layout import BODY, WORLD, Fitted, Forms, Model, addresses, columns
from uwserver.physics.kernel.places import SIZE

FORMS: Forms = {"rows": BODY, "points": columns(np.float64, 3), "flags": columns(np.bool_)}


def arrays(n: int = 4) -> dict[str, Any]:
    return {"rows": np.zeros(n, BODY), "points": np.zeros((n, 3)), "flags": np.zeros(n, np.bool_)}


def test_a_table_has_address_and_length_of_each_array_in_the_order_of_the_list() -> None:
    given = arrays(4)
    given["points"] = np.zeros((7, 3))
    table = addresses(FORMS, given)
    assert table.dtype == np.int64
    assert table.tolist() == [[given[name].ctypes.data, len(given[name])] for name in FORMS]


def test_others_than_those_of_the_list_are_not_looked_at() -> None:
    given = arrays()
    assert np.array_equal(addresses(FORMS, {"aside": "no array", **given}), addresses(FORMS, given))


def test_arrays_without_rows_are_listed_too() -> None:
    assert addresses(FORMS, arrays(0))[:, 1].tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("rows", np.zeros(4)),
        ("points", np.zeros((4, 3), np.float32)),
        ("points", np.zeros((4, 2))),
        ("points", np.zeros(4)),
        ("points", np.zeros((3, 4)).T),
        ("points", np.zeros((8, 3))[::2]),
        ("flags", np.zeros(4, np.int64)),
    ],
)  # fmt: skip
def test_an_array_of_another_form_is_refused_by_name(name: str, wrong: Any) -> None:
    """A kernel would lay its rows over other numbers without a word."""
    with pytest.raises(TypeError, match=f"^{name}: "):
        addresses(FORMS, arrays() | {name: wrong})


def test_a_missing_array_is_a_mistake_of_the_caller() -> None:
    given = arrays()
    del given["flags"]
    with pytest.raises(KeyError, match="flags"):
        addresses(FORMS, given)


def test_the_list_of_a_world_names_what_kernels_and_hydrodynamics_have() -> None:
    assert {*Model._fields, *Fitted._fields, "state", "flows", "scratch", "team"} == set(WORLD)
    hydro = Hydrodynamics((), 0.01)
    for name, form in WORLD.items():
        array = getattr(hydro, name)
        assert array.dtype == form.base, name
        assert array.shape == ({"scratch": 1, "team": SIZE}.get(name, 0), *form.shape), name
