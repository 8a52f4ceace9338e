"""Faults in the tables of fins, propellers, ballast, moving masses and hull are told with their place."""

from __future__ import annotations

import pytest
from msgspec import UNSET

from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry


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
