"""Device files of sensors: each shipped one loads, is of use, and is refused when a key of its properties is misspelt."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwserver.scenario.build import build
from uwserver.scenario.documents import read, shipped
from uwserver.scenario.errors import ScenarioError
from uwserver.scenario.load import load

DEVICES = {name: path for name, path in shipped("devices").items() if read(path).raw["kind"] != "thruster"}
HEAD = 'schema = 1\n[world]\norigin_lat_deg = 63.4\norigin_lon_deg = 10.4\n[vehicles.rov]\nmodel = "bluerov2_heavy"\nposition_ned_m = [0, 0, 5]\n'


def scenario(folder: Path, profile: str) -> Path:
    path = folder / "x.toml"
    path.write_text(f'{HEAD}[vehicles.rov.sensors.device]\nprofile = "{profile}"\nrate_hz = 8\n')
    return path


@pytest.mark.parametrize("name", DEVICES)
def test_a_device_measures(name, tmp_path):
    world = build(load(scenario(tmp_path, name), adapters={}))
    world.step(240)
    assert world.ports["rov/device"].kind == read(DEVICES[name]).raw["kind"]
    assert world.sensors["rov/device"].seq > 0 or world.sensors["rov/device"].held is None


@pytest.mark.parametrize("name", DEVICES)
def test_a_misspelt_property_is_refused(name, tmp_path):
    text = DEVICES[name].read_text()
    lines = text.split("\n")
    wrong = []
    for k, line in enumerate(lines):
        key = line.partition(" = ")[0]
        if " = " not in line or line.startswith(("#", "source", "status", "modifiers.")):
            continue
        copy = tmp_path / "device.toml"
        copy.write_text("\n".join([*lines[:k], line.replace(key, key[:-1] + "qx", 1), *lines[k + 1 :]]))
        try:
            load(scenario(tmp_path, "device.toml"), adapters={})
            wrong.append(line)
        except ScenarioError:
            pass
    assert not wrong


def test_parts_of_one_table_add_up_and_the_user_has_the_last_word(tmp_path):
    path = scenario(tmp_path, "tactical_imu")
    path.write_text(path.read_text() + "gyroscope.turn_on = 0.5\n")
    config = load(path, adapters={}).vehicles["rov"].vehicle.sensors["device"]
    assert config.gyroscope.turn_on == 0.5
    assert config.gyroscope.noise_density == pytest.approx(4.36e-5)
    assert config.gyroscope.instability_tau_s == 3600.0


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('kind = "gps"\nrate_hz = 8', "origin_lat_deg"),
        ('kind = "magnetometer"\nrate_hz = 8', "origin_lat_deg"),
        ('kind = "rpm"\nrate_hz = 8\nmembers = ["t9"]', 'no thruster "t9"'),
        ('kind = "compound"\nrate_hz = 8\nmembers = ["imo"]', 'did you mean "imu"'),
        ('kind = "compound"\nrate_hz = 8\nmembers = ["imu", "imu"]', "named twice"),
    ],
)
def test_what_a_sensor_lacks_is_told_at_its_place(table, said, tmp_path):
    path = tmp_path / "x.toml"
    path.write_text(f'schema = 1\n[vehicles.rov]\nmodel = "bluerov2_heavy"\n[vehicles.rov.sensors.device]\n{table}\n')
    with pytest.raises(ScenarioError, match=said) as refused:
        load(path, adapters={})
    assert "vehicles.rov.sensors.device" in str(refused.value)
