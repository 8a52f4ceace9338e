"""Checks of one vehicle across its tables: forms of matrices, what a rigid body can be, propulsion and names."""

# ruff: noqa: E501 - one case a line
from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwserver.scenario.vehicle.checks import check_vehicle
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.water.tables import Environment
from uwserver.scenario.world.tables import WorldTable

WATER = Environment()
SOURCE = {"source": "x", "status": "guess"}
THRUSTER = {**SOURCE, "device": "t200", "position_frd_m": [0, 0, 0], "axis_frd": [1, 0, 0]}


def rows(matrix: Any) -> list[list[float]]:
    result: list[list[float]] = np.asarray(matrix, dtype=float).tolist()
    return result


@pytest.fixture
def told(raw_vehicle, tree_of, report, warn):
    """What is told of the tiny vehicle with tables in the place of its own; None takes one out."""

    def check(environment: Environment | None = WATER, **tables: Any) -> list[str]:
        for name, table in tables.items():
            raw_vehicle[name] = table
            if table is None:
                del raw_vehicle[name]
        tree = tree_of(raw_vehicle, VehicleFile)
        report.lines.clear()  # what conversion tells has tests of its own
        check_vehicle(tree, WorldTable(), environment, report, warn)
        lines: list[str] = report.lines
        return lines

    return check


def test_a_good_vehicle_passes(told, warn) -> None:
    assert told() == []
    assert warn.lines == []


# -- forms ------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "keys", "line"),
    [
        ("rigid_body", {"mass_kg": 10}, "rigid_body: give exactly one of inertia_kgm2 and inertia_matrix_kgm2: none is given"),
        ("rigid_body", {"mass_kg": 10, "inertia_kgm2": [1, 1, 1], "inertia_matrix_kgm2": rows(np.eye(3))}, "rigid_body: give exactly one of inertia_kgm2 and inertia_matrix_kgm2: both are given"),
        ("added_mass", {}, "added_mass: give exactly one of diagonal and matrix: none is given"),
        ("added_mass", {"diagonal": [1] * 6, "matrix": rows(np.eye(6))}, "added_mass: give exactly one of diagonal and matrix: both are given"),
    ],
)  # fmt: skip
def test_a_matrix_has_one_form(table: str, keys: dict[str, Any], line: str, told) -> None:
    assert told(**{table: {**SOURCE, **keys}}) == [line]


@pytest.mark.parametrize("part", ["linear", "at_rest", "quadratic", "speed"])
def test_each_part_of_the_damping_has_one_form(part: str, told) -> None:
    assert told(damping={part: SOURCE}) == [f"damping.{part}: give exactly one of diagonal and matrix: none is given"]


# -- matrices ---------------------------------------------------------------------------------------------------------------------------


def body(inertia: Any, **keys: Any) -> dict[str, Any]:
    return {**SOURCE, "mass_kg": 10.0, "inertia_matrix_kgm2": rows(inertia), **keys}


def test_an_inertia_is_symmetric(told) -> None:
    matrix = np.diag([1.0, 2.0, 3.0])
    matrix[0, 1], matrix[1, 0] = 0.1, -0.1
    text = "rigid_body.inertia_matrix_kgm2: the inertia is not symmetric: (4,5) is 0.1 but (5,4) is -0.1"
    assert told(rigid_body=body(matrix)) == [text]


def test_rounding_of_a_published_inertia_passes(told) -> None:
    matrix = np.diag([1.0, 2.0, 3.0])
    matrix[0, 1], matrix[1, 0] = 0.1, 0.1 + 1e-10
    assert told(rigid_body=body(matrix)) == []


@pytest.mark.parametrize("least", [-3.0, 0.0])
def test_a_rigid_body_is_positive_definite(told, least: float) -> None:
    (line,) = told(rigid_body=body(np.diag([1.0, 2.0, least])))
    assert line.startswith(f"rigid_body: M_RB is not positive definite (smallest eigenvalue {least:.3g})")
    assert line.endswith("check mass, inertia and inertia_about")


def test_an_inertia_about_the_origin_may_be_too_small_for_the_lever(told) -> None:
    """10 kg at 1 m have 10 kg m2 about the origin alone."""
    keys = {"center_of_mass_frd_m": [1.0, 0.0, 0.0]}
    assert told(rigid_body=body(np.eye(3), **keys)) == []
    (line,) = told(rigid_body=body(np.eye(3), **keys, inertia_about="origin"))
    assert "M_RB is not positive definite" in line


def test_an_asymmetric_added_mass_is_refused_or_made_symmetric(told, warn) -> None:
    matrix = 5.0 * np.eye(6)
    matrix[0, 4], matrix[4, 0] = 0.5, 0.3
    (line,) = told(added_mass={**SOURCE, "matrix": rows(matrix)})
    assert line.startswith("added_mass: M_A is not symmetric: (1,5) is 0.5 but (5,1) is 0.3; correct it, or take its")
    assert warn.lines == []
    assert told(added_mass={**SOURCE, "matrix": rows(matrix), "symmetrise": True}) == []
    text = "added_mass: M_A is not symmetric, its symmetric part is used: (1,5) is 0.5 but (5,1) is 0.3"
    assert warn.lines == [text]


@pytest.mark.parametrize(
    ("diagonal", "fits"), [([0] * 6, True), ([5, 5, 5, 0, 0, 0], True), ([5, 5, -5, 1, 1, 1], False)]
)
def test_an_added_mass_is_positive_semi_definite(diagonal: list[float], fits: bool, told) -> None:
    lines = told(added_mass={**SOURCE, "diagonal": diagonal})
    assert lines == ([] if fits else [
        "added_mass: M_A is not positive semi-definite (smallest eigenvalue -5): check its signs and couplings"
    ])  # fmt: skip


def test_couplings_can_make_it_indefinite(told) -> None:
    matrix = np.eye(6)
    matrix[0, 1] = matrix[1, 0] = 2.0
    (line,) = told(added_mass={**SOURCE, "matrix": rows(matrix)})
    assert "(smallest eigenvalue -1)" in line


# -- trim -------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("volume", "text"),
    [
        (0.010, None),
        (0.0097, None),
        (0.011, "the vehicle floats up with 12.51 N (buoyancy 110.6 N, weight 98.1 N)"),
        (0.009, "the vehicle sinks with 7.603 N (buoyancy 90.5 N, weight 98.1 N)"),
    ],
)
def test_a_vehicle_far_from_neutral_is_doubted(volume: float, text: str | None, told, warn) -> None:
    assert told(buoyancy={**SOURCE, "volume_m3": volume}) == []
    assert warn.lines == ([] if text is None else [f"buoyancy: {text}"])


def test_a_surface_vessel_is_not_doubted(told, warn) -> None:
    """Shapes that displace more than twice the weight are freeboard; without shapes nothing can float."""
    assert told(buoyancy={**SOURCE, "volume_m3": 0.03, "shapes": {"hull": {"kind": "box", "size_m": [1, 1, 1]}}}) == []
    assert warn.lines == []
    assert told(buoyancy={**SOURCE, "volume_m3": 0.03, "shapes": {}}) == []
    assert "floats up" in warn.lines[0]


def test_the_trim_is_that_in_the_scenario_s_water(told, warn) -> None:
    told(Environment(density_kgpm3=1000), buoyancy={**SOURCE, "volume_m3": 0.0095})
    assert "sinks" in warn.lines[0]
    warn.lines.clear()
    told(Environment(density_kgpm3=1060), buoyancy={**SOURCE, "volume_m3": 0.0095})
    told(None, buoyancy={**SOURCE, "volume_m3": 0.05})
    assert warn.lines == []


# -- propulsion and names ---------------------------------------------------------------------------------------------------------------


def test_a_thruster_has_a_direction(told) -> None:
    text = "thrusters.left.axis_frd: the axis has no direction: give the direction of the force at a positive command"
    assert told(thrusters={"left": {**THRUSTER, "axis_frd": [0, 0, 0]}}) == [text]


@pytest.mark.parametrize(
    ("actuator", "lines"),
    [
        ({"kind": "thruster", "member": "left"}, []),
        ({"kind": "thruster", "member": "lift"}, ['member: no thruster "lift" (did you mean "left"?)']),
        ({"kind": "thrusters", "members": ["left", "x"]}, ['members[1]: no thruster "x"; there are: left']),
        ({"kind": "thrusters", "members": ["left", "left"]}, ['members[1]: "left" is named twice']),
        ({"kind": "thruster", "member": "x", "enabled": False}, []),
    ],
)
def test_members_of_actuators(actuator: dict[str, Any], lines: list[str], told) -> None:
    assert told(actuators={"a": actuator}) == [f"actuators.a.{line}" for line in lines]


def test_without_thrusters_there_are_none_to_command(told) -> None:
    assert told(thrusters=None) == [
        "actuators.thrusters: the vehicle has no thrusters to command: add some under [thrusters]"
    ]


def test_a_faulty_thruster_is_there_all_the_same(told) -> None:
    assert told(thrusters={"left": {"device": 3}}, actuators={"a": {"kind": "thruster", "member": "left"}}) == []


def test_a_sensor_and_an_actuator_need_two_names(told) -> None:
    imu, off = {"kind": "imu", "rate_hz": 60}, {"kind": "imu", "rate_hz": 60, "enabled": False}
    text = 'actuators.thrusters: a sensor is named "thrusters" too, so both would have the same path: rename one'
    assert told(sensors={"thrusters": imu}) == [text]
    assert told(sensors={"thrusters": off}) == []


@pytest.mark.parametrize("name", ["truth", "world"])
def test_names_of_the_server_s_own_paths(name: str, told) -> None:
    text = f'the server itself uses paths with "{name}": choose another name'
    assert told(sensors={name: {"kind": "imu", "rate_hz": 60}}) == [f"sensors.{name}: {text}"]
    assert told(sensors={}, actuators={name: {"kind": "teleport"}}) == [f"actuators.{name}: {text}"]


def test_all_faults_are_told_and_holes_left_out(told) -> None:
    lines = told(
        rigid_body={**SOURCE, "mass_kg": -1.0, "inertia_kgm2": [1, 1, 1]},
        added_mass={**SOURCE, "diagonal": [-1] * 6},
        thrusters={"left": {**THRUSTER, "axis_frd": [0, 0, 0]}},
        actuators={"a": {"kind": "thruster", "member": "right"}},
    )
    assert [line.split(":")[0] for line in lines] == ["thrusters.left.axis_frd", "actuators.a.member"]
