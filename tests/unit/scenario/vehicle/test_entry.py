"""A vehicle's table in a scenario: what may be left out, and what it refuses."""

# ruff: noqa: E501 - one case a line
from __future__ import annotations

from typing import Any

import pytest
from msgspec import UNSET

from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import Copies, VehicleEntry


@pytest.fixture
def entry(tree_of, report):
    """The entry of a raw table, and what is told of it."""

    def make(**keys: Any) -> tuple[VehicleEntry | None, list[str]]:
        report.lines.clear()
        tree = tree_of({"schema": 1, "vehicles": {"rov": {"model": "x", **keys}}}, Scenario)
        value: VehicleEntry | None = tree.at("vehicles", "rov").value
        return value, report.lines

    return make


def test_a_model_is_enough(entry) -> None:
    found, told = entry()
    assert told == []
    assert found == VehicleEntry(model="x")
    assert (found.position_ned_m, found.attitude_rpy_deg, found.present) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True)
    assert found.copies is found.truth is found.autopilot is UNSET
    assert found.sensors == found.override == {}


def test_whole_numbers_become_numbers(entry) -> None:
    found, _ = entry(position_ned_m=[1, 2, 3])
    assert found.position_ned_m == (1.0, 2.0, 3.0)
    assert all(type(x) is float for x in found.position_ned_m)


def test_what_is_overridden_is_not_looked_at_here(entry) -> None:
    found, told = entry(override={"anything": {"at": ["all"]}})
    assert told == []
    assert found.override == {"anything": {"at": ["all"]}}


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"model": ""}, "vehicles.rov.model: expected a string that is not empty, found the string \"\""),
        ({"model": 3}, "vehicles.rov.model: expected a string that is not empty, found 3"),
        ({"position_ned_m": [0, 0]}, "vehicles.rov.position_ned_m: expected an array of 3 (a number each), found an array of 2"),
        ({"position_ned_m": [0, 0, "deep"]}, 'vehicles.rov.position_ned_m[2]: expected a number, found the string "deep"'),
        ({"present": 1}, "vehicles.rov.present: expected true or false, found 1"),
        ({"poition_ned_m": [0, 0, 0]}, 'vehicles.rov [vehicles.rov.poition_ned_m]: unknown key "poition_ned_m" (did you mean "position_ned_m"?)'),
        ({"copies": {"count": 0}}, "vehicles.rov.copies.count: expected a whole number from 1 to 1000, found 0"),
        ({"copies": {"count": 1001}}, "vehicles.rov.copies.count: expected a whole number from 1 to 1000, found 1001"),
        ({"copies": {}}, 'vehicles.rov.copies: missing key "count"'),
        ({"copies": {"count": 2, "spacing_m": [0, 1]}}, "vehicles.rov.copies.spacing_m[0]: expected a number greater than 0, found 0"),
        ({"copies": {"count": 2, "columns": 0}}, "vehicles.rov.copies.columns: expected a whole number of at least 1, found 0"),
        ({"truth": {"rate_hz": 0}}, "vehicles.rov.truth.rate_hz: expected a number greater than 0, found 0"),
        ({"sensors": {"1": {"kind": "imu", "rate_hz": 1}}}, 'vehicles.rov.sensors.1: "1" cannot be a name: begin with a letter or _, then use letters, digits, _ and - (it is part of a path)'),
        ({"sensors": {"s": {"kind": "imu"}}}, 'vehicles.rov.sensors.s: missing key "rate_hz"'),
        ({"autopilot": {"mode": "dance"}}, "vehicles.rov.autopilot.mode: expected one of"),
    ],
)  # fmt: skip
def test_what_it_refuses(keys: dict[str, Any], line: str, entry) -> None:
    found, told = entry(**keys)
    assert found is None
    (only,) = told
    assert only.startswith(line)


def test_copies_stand_five_metres_apart_by_default() -> None:
    assert Copies(count=3) == Copies(count=3, columns=UNSET, spacing_m=(5.0, 5.0))
