"""Checks of one vehicle across its tables: matrices, propulsion, names, appendages, and its built-in autopilot.

Also of uwserver.autopilot.config.
"""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec import UNSET

from uwserver.actuators import (
    ActuatorConfig,
    FinConfig,
    FinsConfig,
    ForceTorqueConfig,
    PropellerConfig,
    TeleportConfig,
    ThrusterConfig,
    ThrustersConfig,
)
from uwserver.autopilot.config import AutopilotConfig
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.checks import check_autopilot, check_vehicle, is_steerable
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.world.tables import Environment, WorldTable

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


def faults(override, model="tethys"):
    with pytest.raises(ScenarioError) as caught:
        load(Scenario(schema=1, vehicles={"auv": VehicleEntry(model=model, override=override)}), adapters={})
    return str(caught.value)


FOIL = {"source": "x", "status": "guess", "position_frd_m": [0, 0, 0], "hinge_frd": [0, 1, 0]}
FIN = {**FOIL, "limit_deg": 10}
PROPELLER = {"source": "x", "status": "guess", "position_frd_m": [-1, 0, 0], "diameter_m": 0.2, "max_speed_radps": 100}
CURVE = [[0, 0.4, 0.0], [1, 0.1, 0.0]]
NONE = [0, 0, 0, 0]


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ({"fins": {"rudder": {"hinge_frd": [0, 0, 0]}}}, "fins.rudder.hinge_frd: the hinge has no direction"),
        ({"fins": {"rudder": {"chord_frd": [0, 0, 0]}}}, "fins.rudder.chord_frd: the chord has no direction"),
        ({"fins": {"rudder": {"chord_frd": [0, 0, 2]}}}, "fins.rudder.chord_frd: the chord is parallel to the hinge"),
        ({"fins": {"new": {**FIN, "area_m2": 0.01}}}, "fins.new: a foil with an area needs lift_slope_prad, aspect_ratio, or both"),
        ({"foils": {"new": {**FOIL, "area_m2": 1.0}}}, "foils.new: a foil with an area needs"),
        ({"fins": {"rudder": {"derivatives": {"Yuu": 1.0}}}}, '"Yuu" is not a derivative: write an axis of XYZKMN and two velocities of uvwpqr,'),
        ({"hull": {"derivatives": {"source": "x", "status": "guess", "terms": {"Yuud": 1.0}}}}, '"Yuud" is not a derivative'),
        ({"propellers": {"main": {"axis_frd": [0, 0, 0]}}}, "propellers.main.axis_frd: the axis has no direction"),
        ({"propellers": {"main": {"curve": [[0.5, 1, 1], [0.1, 1, 1]]}}}, "propellers.main.curve: the advance numbers J"),
        ({"propellers": {"main": {"curve": [[0.5, 1, 1]]}}}, "propellers.main.curve"),
        ({"propellers": {"main": {"curve": CURVE}}}, "main.pitch_ratio: describes four quadrants, but the curve describes the first one only"),
        ({"propellers": {"main": {"curve": CURVE, "quadrants": [NONE]}}}, "propellers.main.quadrants: describes four quadrants"),
        ({"propellers": {"main": {"curve": CURVE, "damping_includes_stopped": True}}}, "damping_includes_stopped: a stopped propeller with a curve"),
        ({"propellers": {"new": {**PROPELLER, "pitch_ratio": 1.5}}}, "propellers.new.pitch_ratio"),
        ({"propellers": {"new": {**PROPELLER, "astern_factor": 0.8}}}, "propellers.new.astern_factor: works with a curve only"),
        ({"propellers": {"new": {**PROPELLER, "quadrants": [NONE], "pitch_ratio": 1.0}}}, "propellers.new.pitch_ratio: is for the B4-70"),
        ({"propellers": {"new": {**PROPELLER, "quadrants": [NONE, [0, 0.7, 0, 0]]}}}, "quadrants: the propeller gives more power than"),
        ({"propellers": {"new": {**PROPELLER, "inflow": "speed"}}}, 'propellers.new.inflow: "speed" works with a curve only'),
        ({"propellers": {"new": {**PROPELLER, "quadrants": []}}}, "propellers.new.quadrants"),
        ({"ballasts": {"buoyancy_engine": {"neutral_volume_m3": 1.0}}}, "neutral_volume_m3: must lie between"),
        ({"moving_masses": {"battery": {"min_position_m": 0.01}}}, "moving_masses.battery: position 0 must lie between"),
        ({"moving_masses": {"battery": {"mass_kg": 500.0}}}, "moving_masses.battery.mass_kg: is part of the vehicle's mass_kg"),
        ({"moving_masses": {"battery": {"axis_frd": [0, 0, 0]}}}, "moving_masses.battery.axis_frd: the axis has no direction"),
        ({"actuators": {"rudder": {"member": "rudde"}}}, 'no fin "rudde" (did you mean "rudder"?)'),
        ({"actuators": {"propeller": {"member": "aft"}}}, 'no propeller "aft"'),
        ({"actuators": {"all": {"kind": "fins", "members": ["rudder", "rudder"]}}}, '"rudder" is named twice'),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_place(override, text):
    assert text in faults(override)


def test_a_vehicle_without_fins_has_none_to_command():
    assert "the vehicle has no fins to command" in faults({"actuators": {"f": {"kind": "fins"}}}, "bluerov2")


def test_all_faults_are_told_at_once():
    told = faults({"fins": {"rudder": {"hinge_frd": [0, 0, 0]}}, "propellers": {"main": {"axis_frd": [0, 0, 0]}}})
    assert "fins.rudder" in told
    assert "propellers.main" in told


@pytest.mark.parametrize(
    "extra",
    [
        {},
        {"pitch_ratio": 0.5},
        {"pitch_ratio": 1.3, "damping_includes_stopped": True},
        {"quadrants": [NONE, [0.2, -0.7, 0.03, -0.1]]},
    ],
)
def test_a_propeller_in_four_quadrants_needs_no_curve(extra):
    entry = VehicleEntry(model="tethys", override={"propellers": {"new": {**PROPELLER, **extra}}})
    loaded = load(Scenario(schema=1, vehicles={"auv": entry}), adapters={}).vehicles["auv"].vehicle
    assert loaded.propellers["new"].curve is UNSET


WORLD = WorldTable()
PATH = ("vehicles", "rov", "autopilot")


@pytest.fixture
def autopilot_report(raw_vehicle, tree_of, report):
    """What is told of an autopilot of the tiny vehicle with tables in the place of its own."""

    def check(world: WorldTable | None = WORLD, config: Any = None, **tables: Any) -> list[str]:
        tree = tree_of({**raw_vehicle, **tables}, VehicleFile)
        check_autopilot(msgspec.convert(config or {}, AutopilotConfig), tree, PATH, world, report)
        lines: list[str] = report.lines
        return lines

    return check


def test_a_good_one_passes(autopilot_report) -> None:
    assert autopilot_report() == []
    assert autopilot_report(config={"rate_hz": 60, "state_rate_hz": 10, "gains": {"rate_p": 1.0, "rate_i": 0.5}}) == []


@pytest.mark.parametrize("key", ["rate_hz", "state_rate_hz"])
def test_rates_fall_on_ticks(key: str, autopilot_report) -> None:
    (line,) = autopilot_report(config={key: 7.0})
    assert line.startswith(f"vehicles.rov.autopilot.{key}: 7 Hz does not divide the physics rate of 240 Hz")


def test_without_a_world_rates_are_left_out(autopilot_report) -> None:
    assert autopilot_report(None, {"rate_hz": 7.0}) == []


def test_gains_are_those_that_there_are(autopilot_report) -> None:
    (line,) = autopilot_report(config={"gains": {"no_such_gain": 1.0}})
    assert line.startswith('vehicles.rov.autopilot.gains.no_such_gain: unknown gain "no_such_gain"')


def test_a_misspelt_gain_is_told_with_what_was_meant(autopilot_report) -> None:
    (line,) = autopilot_report(config={"gains": {"yaw_rate_q": 1.0}})
    assert '(did you mean "yaw_rate_' in line


@pytest.mark.parametrize("value", [-1.0, 1001.0])
def test_values_of_gains_are_checked_as_in_the_vehicle_file(value: float, autopilot_report) -> None:
    text = f"vehicles.rov.autopilot.gains.rate_p: expected a number from 0 to 1000, found {value}"
    assert autopilot_report(config={"gains": {"rate_p": value}}) == [text]


@pytest.mark.parametrize("table", ["sensors", "actuators"])
def test_nothing_else_may_have_its_path(table: str, autopilot_report, raw_vehicle) -> None:
    own = {"sensors": {"kind": "imu", "rate_hz": 60}, "actuators": {"kind": "teleport"}}[table]
    text = f'"autopilot" in {table} would have the same path as the built-in autopilot: rename it'
    assert autopilot_report(**{table: {**raw_vehicle[table], "autopilot": own}}) == [f"vehicles.rov.autopilot: {text}"]


def test_without_anything_to_steer_with_it_is_refused(autopilot_report) -> None:
    (line,) = autopilot_report(actuators={"move": {"kind": "teleport"}})
    assert line.startswith("vehicles.rov.autopilot: it cannot steer this vehicle")


FIN_ACTUATOR, FINS = FinConfig(member="rudder"), FinsConfig()
PROPELLER_ACTUATOR = PropellerConfig(member="main")


@pytest.mark.parametrize(
    ("actuators", "steerable"),
    [
        ([ThrustersConfig()], True),
        ([ThrusterConfig(member="t1")], True),
        ([ForceTorqueConfig()], True),
        ([FIN_ACTUATOR, PROPELLER_ACTUATOR], True),
        ([FINS, PROPELLER_ACTUATOR], True),
        ([FINS], False),
        ([PROPELLER_ACTUATOR], False),
        ([TeleportConfig()], False),
        ([], False),
        ([ThrustersConfig(enabled=False)], False),
        ([FINS, PropellerConfig(member="main", enabled=False)], False),
    ],
)
def test_what_can_be_steered(actuators: list[ActuatorConfig], steerable: bool) -> None:
    assert is_steerable({str(k): config for k, config in enumerate(actuators)}) is steerable
