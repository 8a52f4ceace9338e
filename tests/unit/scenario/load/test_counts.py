"""A small file that asks for more than can be built is refused, before anything is built."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load import counts
from uwserver.scenario.load.scenario import load

HEAD = "schema = 1\n"


def tables(kind: str, number: int, body: str) -> str:
    return "".join(f"[{kind}.t{n}]\n{body}\n" for n in range(number))


def refusal(tmp_path: Path, text: str) -> str:
    path = tmp_path / "many.toml"
    path.write_text(HEAD + text)
    with pytest.raises(ScenarioError) as caught:
        load(path, adapters={})
    (problem,) = [each for each in caught.value.problems if each.severity == "error"]
    assert problem.line > 1
    return f"{problem.path}: {problem.text}"


MANY = {
    "vehicles": (tables("vehicles", 2500, 'model = "bluerov2"'), "vehicles: 2500 vehicles, copies included, and 0 objects"),
    "copies": (
        tables("vehicles", 3, 'model = "bluerov2"\ncopies = {count = 1000}'),
        "vehicles: 3000 vehicles, copies included, and 0 objects",
    ),
    "objects": (
        tables("objects", 1999, 'kind = "box"\nsize_m = [1, 1, 1]\nmass_kg = 9') + tables("vehicles", 2, 'model = "bluerov2"'),
        "objects: 2 vehicles, copies included, and 1999 objects",
    ),
    "structures": (tables("structures", 2001, 'kind = "box"\nsize_m = [1, 1, 1]'), "structures: 2001 structures"),
}  # fmt: skip


@pytest.mark.parametrize("what", MANY)
def test_more_than_there_may_be_are_refused_with_their_number_before_a_vehicle_file_is_read(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uwserver.scenario.load.scenario.merged_file", None)  # nobody gets that far
    text, expected = MANY[what]
    told = refusal(tmp_path, text)
    assert told.startswith(expected)
    assert "at most 2000" in told


def test_components_are_counted_with_those_of_copies(tmp_path: Path) -> None:
    sensors = tables("vehicles.rov.sensors", 300, 'kind = "pressure"\nrate_hz = 10')
    rov = '[vehicles.rov]\nmodel = "bluerov2"\ncopies = {count = 1000}\n'
    assert f"at most {counts.MOST_COMPONENTS}" in refusal(tmp_path, rov + sensors)


def test_streams_and_modifiers_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "one.toml"
    vehicle = '[vehicles.rov]\nmodel = "bluerov2"\n[vehicles.rov.sensors.p]\nkind = "pressure"\nrate_hz = 10\n'
    stream = '[vehicles.rov.sensors.p.streams.s]\n[vehicles.rov.sensors.p.streams.s.modifiers.m]\nkind = "bias"\n'
    path.write_text(HEAD + vehicle + stream + 'field = "pressure"\nvalue = 1.0\n')
    file = load(path, adapters={}).vehicles["rov"].vehicle
    own = len(file.sensors) + len(file.actuators) + sum(len(sensor.modifiers) for sensor in file.sensors.values())
    monkeypatch.setattr(counts, "MOST_COMPONENTS", own + 1)
    with pytest.raises(ScenarioError, match=f"{own + 2} sensors"):
        load(path, adapters={})
    monkeypatch.setattr(counts, "MOST_COMPONENTS", own + 2)
    load(path, adapters={})


@pytest.mark.parametrize("copies", ["{count = -5}", '{count = "many"}', "7", "{count = 1.5}", "{}"])
def test_a_count_that_is_none_is_told_as_that(copies: str, tmp_path: Path) -> None:
    assert "vehicles.t0.copies" in refusal(tmp_path, tables("vehicles", 1, f'model = "bluerov2"\ncopies = {copies}'))


def test_a_thousand_vehicles_are_not_too_many(tmp_path: Path) -> None:
    path = tmp_path / "swarm.toml"
    path.write_text(HEAD + tables("vehicles", 1, 'model = "bluerov2_heavy"\ncopies = {count = 1000}'))
    assert len(load(path, adapters={}).vehicles) == 1000


CAMERA = 'model = "bluerov2"\n[vehicles.t0.sensors.eye]\nkind = "camera"\n'
SLOW = {
    "latency": CAMERA + "rate_hz = 30\nlatency_s = 1e6",
    "modifier": CAMERA + 'rate_hz = 30\n[vehicles.t0.sensors.eye.modifiers.late]\nkind = "delay"\nlatency_s = 60.0',
    "jitter": CAMERA
    + 'rate_hz = 30\n[vehicles.t0.sensors.eye.streams.s.modifiers.late]\nkind = "delay"\nlatency_s = 0\njitter_s = 1e3',
    "size": CAMERA + "rate_hz = 30\nwidth = 4096\nheight = 3072\nlatency_s = 1.0",
    "copies": CAMERA.replace('"bluerov2"', '"bluerov2"\ncopies = {count = 1000}') + "rate_hz = 10",
    "sonar": 'model = "bluerov2"\n[vehicles.t0.sensors.eye]\nkind = "multibeam"\nrate_hz = 10\noutput = "complex"\nlatency_s = 60.0',
    "numbers": 'model = "bluerov2"\n[vehicles.t0.sensors.eye]\nkind = "imu"\nrate_hz = 120\nlatency_s = 1e6',
}


@pytest.mark.parametrize("what", SLOW)
def test_more_readings_under_way_than_there_is_room_for_are_refused(what: str, tmp_path: Path) -> None:
    told = refusal(tmp_path, tables("vehicles", 1, SLOW[what]))
    assert told.startswith("vehicles.t0.sensors.eye: ")
    assert "wait in memory for" in told
    assert "at most 512 are allowed: lower the latency or the rate" in told


def test_what_devices_have_is_not_too_much(tmp_path: Path) -> None:
    """Twelve million pixels thirty times a second, over USB; and an acoustic fix that takes a minute."""
    path = tmp_path / "s.toml"
    text = CAMERA + "rate_hz = 30\nwidth = 4096\nheight = 3072\n[vehicles.t0.sensors.deep]\n"
    path.write_text(HEAD + tables("vehicles", 1, text + 'kind = "pressure"\nrate_hz = 10\nlatency_s = 60.0'))
    load(path, adapters={})
