"""The tables of vehicle and device files: numbers need a source, limits hold, and defaults are what the docs say."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec import UNSET

from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.vehicle.tables import (
    AddedMass,
    Buoyancy,
    RigidBody,
    Thruster,
    ThrusterDevice,
    VehicleFile,
)

SOURCE = {"source": "x", "status": "guess"}
HERE = [0.0, 0.0, 0.0]
GOOD: dict[Any, dict[str, Any]] = {
    RigidBody: {"mass_kg": 10.0},
    Buoyancy: {"volume_m3": 0.01},
    AddedMass: {},
    Thruster: {"device": "t200", "position_frd_m": HERE, "axis_frd": HERE},
}


@pytest.mark.parametrize("table", GOOD, ids=lambda table: table.__name__)
def test_every_table_of_numbers_needs_source_and_status(table: Any, tree_of, report) -> None:
    assert tree_of({**SOURCE, **GOOD[table]}, table).value is not None
    assert report.lines == []
    assert tree_of(GOOD[table], table).value is None
    assert report.lines == [': missing key "source"', ': missing key "status"']


@pytest.mark.parametrize("status", ["measured", "paper", "datasheet", "derived", "guess"])
def test_how_far_a_number_is_to_be_trusted(status: str) -> None:
    assert msgspec.convert({"source": "x", "status": status, "mass_kg": 1.0}, RigidBody).status == status


@pytest.mark.parametrize("source", [{"source": "", "status": "guess"}, {"source": "x", "status": "sure"}])
def test_no_source_and_no_such_status(source: dict[str, str], tree_of) -> None:
    assert tree_of({**source, "mass_kg": 1.0}, RigidBody).value is None


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        (RigidBody, {"mass_kg": 0}),
        (RigidBody, {"inertia_about": "nose"}),
        (RigidBody, {"inertia_matrix_kgm2": [[1, 0], [0, 1]]}),
        (Buoyancy, {"volume_m3": -1}),
        (Buoyancy, {"shapes": {"a": {"kind": "cone"}}}),
        (AddedMass, {"diagonal": [1, 2, 3]}),
        (AddedMass, {"matrix": [[1] * 6] * 5}),
        (AddedMass, {"reference_density_kgpm3": 0}),
        (Thruster, {"handedness": "up"}),
        (Thruster, {"installed_factor": 0}),
        (Thruster, {"installed_factor": 1.6}),
        (Thruster, {"inflow_factor": -0.1}),
    ],
)
def test_limits_hold(table: Any, keys: dict[str, Any], tree_of, report) -> None:
    assert tree_of({**SOURCE, **GOOD[table], **keys}, table).value is None
    assert report.lines


def test_defaults_of_a_thruster_are_those_of_its_device() -> None:
    thruster = msgspec.convert({**SOURCE, **GOOD[Thruster]}, Thruster)
    assert (thruster.voltage_V, thruster.installed_factor, thruster.inflow_factor) == (UNSET, 1.0, 1.0)
    assert thruster.handedness == "none"


def test_the_damping_of_a_vehicle_has_the_drag_of_its_stopped_thrusters_unless_it_says_so() -> None:
    assert msgspec.convert({**SOURCE, **GOOD[Thruster]}, Thruster).damping_includes_stopped


def test_a_vehicle_needs_body_water_and_damping_and_nothing_more(tree_of, report, raw_vehicle) -> None:
    bare = {key: raw_vehicle[key] for key in ("schema", "name", "description", "rigid_body", "buoyancy", "added_mass", "damping")}  # fmt: skip
    vehicle: VehicleFile = tree_of(bare, VehicleFile).value
    assert report.lines == []
    assert vehicle.thrusters == vehicle.sensors == vehicle.actuators == {}
    assert vehicle.contact.friction == 0.5
    for key in bare:
        report.lines.clear()
        assert tree_of({k: v for k, v in bare.items() if k != key}, VehicleFile).value is None
        (line,) = report.lines
        assert line.startswith(f': missing key "{key}"')


@pytest.mark.parametrize("schema", [0, 2, "1", True])
def test_another_schema_is_refused(schema: Any, tree_of, raw_vehicle, raw_device) -> None:
    assert tree_of({**raw_vehicle, "schema": schema}, VehicleFile).value is None
    assert tree_of({**raw_device, "schema": schema}, ThrusterDevice).value is None


@pytest.mark.parametrize("name", list(shipped("vehicles")))
def test_shipped_vehicles_are_named_as_their_files(name: str) -> None:
    raw = read(shipped("vehicles")[name]).raw
    assert raw["name"] == name
    assert len(raw["description"]) > 10
