"""What sensors in compiled code see fits what the world's arrays are, and needs no numba to be told.

A scope in plain Python becomes the arrays that a sensor in compiled code sees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sensor_rig import CAST, EARTH, at, world_with

from uwserver.environment.column import SALINITY, TEMPERATURE, WaterColumn
from uwserver.environment.water import Sea, Water
from uwserver.frames import quat_from_rpy
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.layout import PROFILE_SIZE, WAVE_SIZE, SeaRows
from uwserver.sensors.surroundings import FORMS, ScopeArrays, place_row, water_arrays

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


Q = quat_from_rpy(0.1, -0.2, 1.3)


def test_the_body_is_that_of_the_scope(scope):
    changes = {"nu_dot": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), "tau": (6.0, 5.0, 4.0, 3.0, 2.0, 1.0), "q_NB": Q}
    arrays = ScopeArrays(scope(v_NB_B=(1.0, -2.0, 3.0), w_NB_B=(0.1, 0.2, -0.3), **changes)).arrays
    assert arrays["state"].tolist() == [[1.0, 2.0, 5.0, *Q, 1.0, -2.0, 3.0, 0.1, 0.2, -0.3]]
    assert arrays["nu_dot"].tolist() == [list(changes["nu_dot"])]
    assert arrays["tau"].tolist() == [list(changes["tau"])]
    assert len(arrays["bodies"]) == 1
    assert len(arrays["thrusters"]) == len(arrays["electrics"]) == 0


def test_the_place_is_that_of_earth_and_water(scope, water):
    place = ScopeArrays(at(scope, 2.5)).arrays["place"][0]
    assert (place["gravity"], place["density"], place["atmosphere"]) == (9.81, 1025.0, 101_325.0)
    assert place["current"].tolist() == [0.3, 0.0, 0.0]
    assert place["moves"] == 0
    assert (place["latitude"], place["longitude"], place["epoch_ns"]) == (
        EARTH.latitude,
        EARTH.longitude,
        EARTH.epoch_ns,
    )
    assert place["declination"] == EARTH.declination
    assert place["magnetic"].tolist() == [list(row) for row in EARTH.magnetic]
    assert place["t_ns"] == 2_500_000_000
    assert place["ph"] == water.column.ph


def test_layers_and_a_sea_that_moves_are_seen(scope, water):
    rows = SeaRows(np.arange(7.0), np.zeros((1, PROFILE_SIZE)), np.zeros((2, WAVE_SIZE)))
    layers = WaterColumn(CAST, 9.81, 1025.0)
    arrays = ScopeArrays(scope(water=replace(water, sea=Sea(rows), given=layers))).arrays
    assert arrays["place"]["moves"].tolist() == [1]
    assert arrays["uniform"] is rows.uniform
    assert (len(arrays["profiles"]), len(arrays["waves"])) == (1, 2)
    assert arrays["column"][0, [TEMPERATURE, SALINITY]].tolist() == pytest.approx([18.0, 30.0], abs=1e-9)


def test_the_inside_of_its_vehicle_is_seen_as_it_is_now(scope):
    world = world_with()
    wiring = world.sensors["rov/imu"].wiring
    there = ScopeArrays(scope(wiring=wiring))
    assert there.arrays["electrics"]["wired"].tolist() == [1] * 8
    assert there.arrays["thrusters"] is world.hydro.thrusters
    assert there.arrays["bodies"]["thruster_count"].tolist() == [8]
    assert there.arrays["electrics"]["power"][0].tolist() == list(wiring.electrics["t1"].power)


def test_the_table_has_the_addresses_of_arrays_that_outlive_it(scope):
    there = ScopeArrays(scope())
    for (name, _), (address, length) in zip(FORMS.items(), there.table.tolist(), strict=True):
        assert address == there.arrays[name].ctypes.data, name
        assert length == len(there.arrays[name]), name
