"""Several vehicles from one table: names, places, faults of single ones, and what is told of bad ones."""

from __future__ import annotations

import pytest

from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load import solids as solid_files
from uwserver.scenario.load.export import to_toml
from uwserver.scenario.load.scenario import load

ROV = 'schema = 1\n[vehicles.rov]\nmodel = "./tiny.toml"\nposition_ned_m = [1.0, 2.0, 5.0]\n'
HULL = '[collision.hull]\nkind = "sphere"\nradius_m = 0.2\n'


@pytest.fixture
def loaded(write, files, adapters):
    """Loads a scenario with a tiny vehicle; more text for either file."""
    return lambda text, vehicle="": load(write(ROV + text, files["tiny"] + vehicle), adapters=adapters)


@pytest.fixture
def told(loaded):
    """All that is told of a scenario that does not load."""

    def run(text, vehicle=""):
        with pytest.raises(ScenarioError) as caught:
            loaded(text, vehicle)
        return "\n".join(str(problem) for problem in caught.value.problems)

    return run


def test_copies_stand_in_rows_and_columns(loaded):
    resolved = loaded("copies = { count = 5, columns = 2, spacing_m = [3.0, 4.0] }")
    places = {name: vehicle.entry.position_ned_m for name, vehicle in resolved.vehicles.items()}
    assert places == {
        "rov_1": (1.0, 2.0, 5.0),
        "rov_2": (1.0, 6.0, 5.0),
        "rov_3": (4.0, 2.0, 5.0),
        "rov_4": (4.0, 6.0, 5.0),
        "rov_5": (7.0, 2.0, 5.0),
    }
    world = build(resolved)
    assert {name: vehicle.p_NB for name, vehicle in world.vehicles.items()} == places
    assert {f"{name}/imu" for name in places} <= set(world.ports)
    world.step(240)
    assert len({world.read(f"{name}/imu").seq for name in places}) == 1


def test_a_square_is_the_default(loaded):
    resolved = loaded("copies = { count = 7 }")
    assert [vehicle.entry.position_ned_m[:2] for vehicle in resolved.vehicles.values()][2:5] == [
        (1.0, 12.0),
        (6.0, 2.0),
        (6.0, 7.0),
    ]


def test_each_copy_has_its_own_noise_and_one_file(loaded):
    noise = (
        '[vehicles.rov.sensors.imu]\nkind = "imu"\nrate_hz = 120\n'
        '[vehicles.rov.sensors.imu.modifiers.n]\nkind = "white_noise"\nfield = "f_S"\nsigma = 0.1\n'
    )
    resolved = loaded(f"copies = {{ count = 3 }}\n{noise}")
    assert len({id(vehicle.vehicle) for vehicle in resolved.vehicles.values()}) == 1
    world = build(resolved)
    world.step(10)
    assert len({world.read(f"rov_{k}/imu").value for k in (1, 2, 3)}) == 3


def test_written_out_it_is_the_same_scenario(loaded, tmp_path, adapters):
    resolved = loaded("copies = { count = 3 }")
    again = tmp_path / "again.toml"
    again.write_text(to_toml(resolved.scenario))
    assert load(again, adapters=adapters).scenario == resolved.scenario


def test_a_fault_names_one_of_them(loaded, told):
    fault = '[faults.weak]\nkind = "thruster_weak"\ntarget = "{}/thrusters"\nfactor = 0.5\n'
    assert loaded("copies = { count = 3 }\n" + fault.format("rov_2"))
    assert "rov_1/thrusters, rov_2/thrusters" in told("copies = { count = 2 }\n" + fault.format("rov"))


def test_bad_copies_are_told_once_and_where(told):
    assert told("copies = { count = 0 }").splitlines() == [
        "tank.toml:5:12: vehicles.rov.copies.count: expected a whole number from 1 to 1000, found 0"
    ]
    assert "missing key" in told("copies = { spacing_m = [1, 1] }")
    assert "spacing_m" in told("copies = { count = 2, spacing_m = [0, 1] }")
    assert 'vehicles.rov_2: "rov_2" is already the name of a vehicle or object of the table "rov"' in told(
        'copies = { count = 2 }\n[vehicles.rov_2]\nmodel = "./tiny.toml"\n'
    )


def test_a_copy_inside_the_seabed_is_told(told):
    seabed = '[seabed]\nkind = "flat"\ndepth_m = 20\n[structures.rock]\nkind = "sphere"\nradius_m = 1.0\nposition_ned_m = [1, 7, 5]\n'
    assert 'starts inside "rock"' in told("copies = { count = 2 }\n" + seabed)


def test_without_the_engines_one_vehicle_runs_and_two_are_told_what_to_install(loaded, told, monkeypatch):
    monkeypatch.setattr(solid_files, "missing_engines", lambda _: "install them")
    world = build(loaded("", HULL))
    assert world.scene is None
    world.step(10)
    assert "vehicles: install them" in told("copies = { count = 2 }", HULL)
