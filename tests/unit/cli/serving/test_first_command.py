"""What `uwserver run` proposes to type moves the vehicle so that one sees it, whatever vehicle it is."""

from __future__ import annotations

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from uwserver.cli.serving.first_command import first_command
from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.load.scenario import load

BUOYANCY_ALONE = {"slocum"}
"""Goes by its ballast, which takes minutes."""


@pytest.mark.parametrize("model", sorted(shipped("vehicles")))
def test_the_proposed_command_moves_the_vehicle(model):
    depth = 0.0 if model == "otter" else 10.0
    scenario = ScenarioBuilder("a", seed=1).vehicle("rov", model, position_ned_m=(0.0, 0.0, depth)).build()
    resolved = load(scenario, adapters={})
    command = first_command(resolved.vehicles["rov"])
    if model in BUOYANCY_ALONE:
        assert command == ""
        return
    port, assignment, *_, seconds = command.split()
    name, _, value = assignment.partition("=")
    driven, left = build(resolved), build(resolved)
    for _ in range(10 * int(seconds)):
        driven.command(port, **{name: json.loads(value.strip("'"))})
        driven.step(24)
    left.step(240 * int(seconds))
    moved = np.subtract(driven.vehicles["rov"].p_NB, left.vehicles["rov"].p_NB)
    assert np.linalg.norm(moved) > 0.25, (command, moved)
    assert np.linalg.norm(moved) == pytest.approx(max(moved[2], np.hypot(*moved[:2])), rel=0.2)


def test_a_vehicle_without_known_actuators_gets_none():
    scenario = ScenarioBuilder("a").vehicle("rov", "bluerov2", position_ned_m=(0, 0, 5)).build()
    vehicle = load(scenario, adapters={}).vehicles["rov"]
    bare = replace(vehicle, vehicle=msgspec.structs.replace(vehicle.vehicle, actuators={}))
    assert first_command(vehicle) == "rov/thrusters u='[0,0,0,0,0.5,0.5]' --rate 10 --seconds 3"
    assert first_command(bare) == ""
