"""Warnings of what is allowed and hardly meant; each vanishes when the scenario says what was meant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from uwserver.scenario.files.documents import shipped
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario

HEAD = 'schema = 1\n[adapters.tcp]\nkind = "sockets"\n'


def rov(name: str, *position: float, model: str = "bluerov2", more: str = "") -> str:
    return f'[vehicles.{name}]\nmodel = "{model}"\nposition_ned_m = {list(position)}\n{more}'


@pytest.fixture
def warned(tmp_path: Path, adapters: Mapping[str, type]):
    """The warnings of a scenario's text: path and text."""

    def load_text(*parts: str) -> list[str]:
        path = tmp_path / "s.toml"
        path.write_text("".join(parts))
        return [f"{problem.path}: {problem.text}" for problem in load(path, adapters=adapters).warnings]

    return load_text


def test_a_vehicle_in_the_air_is_told_with_what_was_meant(warned):
    (warning,) = warned(HEAD, rov("a", 0, 0, -5))
    assert warning.startswith("vehicles.a.position_ned_m[2]: it starts 5 m above the water")
    assert warning.endswith("did you mean +5?")
    assert not warned(HEAD, rov("a", 0, 0, 5))
    assert not warned(HEAD, rov("a", 0, 0, -0.05))  # still floats, half out


def test_a_surface_vessel_may_begin_above_the_water(warned):
    assert not warned(HEAD, rov("a", 0, 0, -2, model="otter"))


def test_copies_in_the_air_are_told_once(warned):
    assert len(warned(HEAD, rov("a", 0, 0, -5, more="copies = {count = 9}\n"))) == 1


def test_a_vehicle_that_is_not_there_yet_is_not_judged(warned):
    assert not warned(HEAD, rov("a", 0, 0, -5, more="present = false\n"), rov("b", 0, 0, 5))


def test_two_bodies_in_one_place(warned):
    (warning,) = warned(HEAD, rov("a", 0, 0, 5), rov("b", 0.1, 0, 5))
    assert warning.startswith("vehicles.b.position_ned_m: b and a start at the same place")
    assert not warned(HEAD, rov("a", 0, 0, 5), rov("b", 1, 0, 5))
    assert not warned(HEAD, rov("a", 0, 0, 5), rov("b", 0, 1, 5))


def test_an_object_in_a_vehicle(warned):
    crate = (
        '[objects.crate]\nkind = "box"\nsize_m = [1.0, 1.0, 1.0]\nmass_kg = 1100\nposition_ned_m = [0.0, 0.0, 5.3]\n'
    )
    (warning,) = warned(HEAD, rov("a", 0, 0, 5), crate)
    assert warning.startswith("vehicles.a.position_ned_m: a and crate start at the same place")


def test_copies_of_one_table_in_one_place_are_told_once(warned):
    (warning,) = warned(HEAD, rov("a", 0, 0, 5, more="copies = {count = 9, spacing_m = [0.01, 0.01]}\n"))
    assert warning.startswith("vehicles.a.position_ned_m: a_")


def test_a_vehicle_below_the_seabed_is_refused(warned):
    from uwserver.scenario.files.errors import ScenarioError

    with pytest.raises(ScenarioError, match=r"the seabed is 10.00 m deep"):
        warned(HEAD, '[seabed]\nkind = "flat"\ndepth_m = 10.0\n', rov("a", 0, 0, 12))


def test_a_vehicle_without_a_sensor(warned):
    blind = "".join(f"[vehicles.a.override.sensors.{s}]\nenabled = false\n" for s in ("imu", "pressure", "depth"))
    (warning,) = warned(HEAD, rov("a", 0, 0, 5, more=blind))
    assert warning.startswith("vehicles.a.sensors: it has no sensor")
    assert not warned(HEAD, rov("a", 0, 0, 5, more=blind + "[vehicles.a.truth]\nrate_hz = 20\n"))


@pytest.mark.parametrize(
    ("mode", "lacks"), [("mission", "heading"), ("position_hold", "heading"), ("altitude_hold", "altitude")]
)
def test_a_mode_that_no_sensor_serves(warned, mode, lacks):
    (warning,) = warned(HEAD, rov("a", 0, 0, 5, more=f'[vehicles.a.autopilot]\nmode = "{mode}"\n'))
    assert warning.startswith(f'vehicles.a.autopilot.mode: the mode "{mode}" cannot work: no {lacks}')


def test_a_mission_without_a_position(warned):
    compass = '[vehicles.a.sensors.ahrs]\nkind = "attitude"\nprofile = "mems_ahrs"\nrate_hz = 40\n'
    mission = '[vehicles.a.autopilot]\nmode = "mission"\n'
    (warning,) = warned(HEAD, rov("a", 0, 0, 5, more=compass + mission))
    assert '"mission" cannot work: no position: it needs a dvl' in warning
    dvl = '[vehicles.a.sensors.dvl]\nkind = "dvl"\nprofile = "a50"\nrate_hz = 10\n'
    assert not warned(HEAD, rov("a", 0, 0, 5, more=compass + dvl + mission))
    assert not warned(HEAD, rov("a", 0, 0, 5, more='[vehicles.a.autopilot]\nmode = "depth_hold"\n'))


def test_a_file_that_nobody_can_reach(warned):
    (warning,) = warned("schema = 1\n[adapters]\n", rov("a", 0, 0, 5))
    assert warning.startswith("adapters: there is no adapter, so nobody can reach the simulation")
    assert not warned("schema = 1\n", rov("a", 0, 0, 5))  # gets the default one


def test_a_scenario_of_python_may_have_no_adapter(adapters):
    assert not load(Scenario(schema=1), adapters=adapters).warnings


@pytest.mark.parametrize("name", sorted(shipped()))
def test_no_shipped_scenario_is_told_of(name, adapters):
    warnings = load(name, adapters=adapters).warnings
    assert not [w for w in warnings if w.path.startswith(("vehicles.", "adapters", "objects."))]
