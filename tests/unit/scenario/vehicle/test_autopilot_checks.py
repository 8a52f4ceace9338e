"""Checks of a vehicle's built-in autopilot: rates, gains, names, and something to steer with. Also of uwserver.autopilot.config."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

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
from uwserver.scenario.vehicle.autopilot_checks import check_autopilot, is_steerable
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.world.tables import WorldTable

WORLD = WorldTable()
PATH = ("vehicles", "rov", "autopilot")


@pytest.fixture
def told(raw_vehicle, tree_of, report):
    """What is told of an autopilot of the tiny vehicle with tables in the place of its own."""

    def check(world: WorldTable | None = WORLD, config: Any = None, **tables: Any) -> list[str]:
        tree = tree_of({**raw_vehicle, **tables}, VehicleFile)
        check_autopilot(msgspec.convert(config or {}, AutopilotConfig), tree, PATH, world, report)
        lines: list[str] = report.lines
        return lines

    return check


def test_a_good_one_passes(told) -> None:
    assert told() == []
    assert told(config={"rate_hz": 60, "state_rate_hz": 10, "gains": {"rate_p": 1.0, "rate_i": 0.5}}) == []


@pytest.mark.parametrize("key", ["rate_hz", "state_rate_hz"])
def test_rates_fall_on_ticks(key: str, told) -> None:
    (line,) = told(config={key: 7.0})
    assert line.startswith(f"vehicles.rov.autopilot.{key}: 7 Hz does not divide the physics rate of 240 Hz")


def test_without_a_world_rates_are_left_out(told) -> None:
    assert told(None, {"rate_hz": 7.0}) == []


def test_gains_are_those_that_there_are(told) -> None:
    (line,) = told(config={"gains": {"no_such_gain": 1.0}})
    assert line.startswith('vehicles.rov.autopilot.gains.no_such_gain: unknown gain "no_such_gain"')


def test_a_misspelt_gain_is_told_with_what_was_meant(told) -> None:
    (line,) = told(config={"gains": {"yaw_rate_q": 1.0}})
    assert '(did you mean "yaw_rate_' in line


@pytest.mark.parametrize("value", [-1.0, 1001.0])
def test_values_of_gains_are_checked_as_in_the_vehicle_file(value: float, told) -> None:
    text = f"vehicles.rov.autopilot.gains.rate_p: expected a number from 0 to 1000, found {value}"
    assert told(config={"gains": {"rate_p": value}}) == [text]


@pytest.mark.parametrize("table", ["sensors", "actuators"])
def test_nothing_else_may_have_its_path(table: str, told, raw_vehicle) -> None:
    own = {"sensors": {"kind": "imu", "rate_hz": 60}, "actuators": {"kind": "teleport"}}[table]
    text = f'"autopilot" in {table} would have the same path as the built-in autopilot: rename it'
    assert told(**{table: {**raw_vehicle[table], "autopilot": own}}) == [f"vehicles.rov.autopilot: {text}"]


def test_without_anything_to_steer_with_it_is_refused(told) -> None:
    (line,) = told(actuators={"move": {"kind": "teleport"}})
    assert line.startswith("vehicles.rov.autopilot: it cannot steer this vehicle")


FIN, FINS = FinConfig(member="rudder"), FinsConfig()
PROPELLER = PropellerConfig(member="main")


@pytest.mark.parametrize(
    ("actuators", "steerable"),
    [
        ([ThrustersConfig()], True),
        ([ThrusterConfig(member="t1")], True),
        ([ForceTorqueConfig()], True),
        ([FIN, PROPELLER], True),
        ([FINS, PROPELLER], True),
        ([FINS], False),
        ([PROPELLER], False),
        ([TeleportConfig()], False),
        ([], False),
        ([ThrustersConfig(enabled=False)], False),
        ([FINS, PropellerConfig(member="main", enabled=False)], False),
    ],
)
def test_what_can_be_steered(actuators: list[ActuatorConfig], steerable: bool) -> None:
    assert is_steerable({str(k): config for k, config in enumerate(actuators)}) is steerable
