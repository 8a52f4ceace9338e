"""What sensors in compiled code see fits what the world's arrays are, and needs no numba to be told."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_rig import EARTH, world_with

from uwserver.environment.water import Water
from uwserver.physics.kernel import layout
from uwserver.sensors.surroundings import FORMS, place_row, water_arrays

STILL = Water(1025.0, 9.81, 12.0, 101_325.0, (0.3, -0.1, 0.05))


def test_all_arrays_of_a_world_are_of_these_forms():
    hydro = world_with().hydro
    for name, array in (
        ("state", hydro.state), ("bodies", hydro.bodies), ("thrusters", hydro.thrusters), ("lags", hydro.lags),
    ):  # fmt: skip
        form = FORMS[name]
        assert (array.dtype, array.shape[1:]) == (form.base, form.shape), name


def test_water_that_stands_still_has_no_profiles_and_no_waves():
    arrays = water_arrays(STILL)
    assert set(arrays) == {"column", "uniform", "profiles", "waves"}
    assert arrays["column"] is STILL.column.table
    assert (len(arrays["profiles"]), len(arrays["waves"])) == (0, 0)
    for name, array in arrays.items():
        assert (array.dtype, array.shape[1:]) == (FORMS[name].base, FORMS[name].shape), name


def test_another_array_than_that_of_its_form_is_refused():
    """A kernel would read something else."""
    arrays = {name: np.zeros((1, *form.shape), form.base) for name, form in FORMS.items()}
    assert len(layout.addresses(FORMS, arrays)) == len(FORMS)
    with pytest.raises(TypeError, match="state: C-contiguous rows"):
        layout.addresses(FORMS, {**arrays, "state": np.zeros((1, 12))})


def test_the_place_has_the_current_as_it_is():
    """`world/set_current` writes into it."""
    place = place_row(STILL, EARTH)
    assert place.shape == (1,)
    assert place["current"].tolist() == [[0.3, -0.1, 0.05]]
