"""Merging, lookup, and the ways back: TOML, builder, explain."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.documents import shipped
from uwserver.scenario.files.errors import Problem, ScenarioError
from uwserver.scenario.load.export import explain, to_toml
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Write = Callable[..., Path]
Adapters = Mapping[str, type]


def test_problem_text_is_exact() -> None:
    text = 'unknown key "bin" (did you mean "bins"?)'
    problem = Problem("tank.toml", 14, 1, "vehicles.rov.sensors.s0", text)
    assert str(problem) == 'tank.toml:14:1: vehicles.rov.sensors.s0: unknown key "bin" (did you mean "bins"?)'


def test_a_vehicle_without_inertia_is_reported(write: Write, files: dict[str, str], adapters: Adapters) -> None:
    """All other checks go on without it."""
    with pytest.raises(ScenarioError) as caught:
        load(write(vehicle=files["tiny"].replace("inertia_kgm2 = [0.1, 0.2, 0.3]\n", "")), adapters=adapters)
    texts = [problem.text for problem in caught.value.problems if problem.severity == "error"]
    assert texts == ["give exactly one of inertia_kgm2 and inertia_matrix_kgm2: none is given"]


def test_override_is_merged_deep_and_sensors_replace_whole(
    write: Write, files: dict[str, str], adapters: Adapters
) -> None:
    extra = """
[vehicles.rov.override.rigid_body]
mass_kg = 10.1
[vehicles.rov.override.thrusters.left]
installed_factor = 0.5
[vehicles.rov.override.sensors.imu]
latency_s = 0.5
[vehicles.rov.sensors.imu]
kind = "imu"
rate_hz = 60
[vehicles.rov.sensors.depth]
kind = "pressure"
rate_hz = 10
"""
    vehicle = load(write(files["tank"] + extra), adapters=adapters).vehicles["rov"].vehicle
    assert vehicle.rigid_body.mass_kg == 10.1
    assert vehicle.rigid_body.inertia_kgm2 == (0.1, 0.2, 0.3)
    assert vehicle.thrusters["left"].installed_factor == 0.5
    assert vehicle.sensors["imu"].rate_hz == 60
    assert vehicle.sensors["imu"].mount is msgspec.UNSET
    assert vehicle.sensors["imu"].latency_s is msgspec.UNSET
    assert list(vehicle.sensors) == ["imu", "depth"]


def test_disabled_components_are_taken_out_but_checked_first(
    write: Write, files: dict[str, str], adapters: Adapters
) -> None:
    off = files["tank"] + "[vehicles.rov.override.sensors.imu]\nenabled = false\n"
    off += "[vehicles.rov.override.actuators.thrusters]\nenabled = false\n"
    vehicle = load(write(off), adapters=adapters).vehicles["rov"].vehicle
    assert dict(vehicle.sensors) == {}
    assert dict(vehicle.actuators) == {}
    with pytest.raises(ScenarioError, match="rate_hs"):
        load(write(off.replace("enabled = false\n[", "enabled = false\nrate_hs = 3\n[", 1)), adapters=adapters)


def test_a_device_given_in_the_scenario_lies_beside_the_scenario(
    write: Write, files: dict[str, str], adapters: Adapters, tmp_path: Path
) -> None:
    write(files["tank"])
    (tmp_path / "vehicles").mkdir()
    (tmp_path / "vehicles/tiny.toml").write_text(files["tiny"])
    (tmp_path / "vehicles/motor.toml").write_text(files["motor"])
    (tmp_path / "strong.toml").write_text(files["motor"].replace("50.0", "70.0"))
    text = files["tank"].replace("./tiny", "vehicles/tiny")
    assert _force(load(write(text), adapters=adapters)) == 50.0
    override = "[vehicles.rov.override.thrusters.left]\ndevice = './strong.toml'\n"
    assert _force(load(write(text + override), adapters=adapters)) == 70.0


def _force(resolved: Any) -> float:
    force: float = resolved.vehicles["rov"].devices["left"].curves["v16"].max_forward_N
    return force


@pytest.mark.parametrize("name", list(shipped()))
def test_shipped_scenarios_load_come_back_from_toml_and_are_explained(
    name: str, adapters: Adapters, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the explanation each default stands, and each source and status."""
    resolved = load(name, adapters=adapters)
    assert resolved.name == name
    path = tmp_path / "again.toml"
    path.write_text(to_toml(resolved.scenario), encoding="utf-8")
    assert resolved.path is not None
    (tmp_path / "assets").symlink_to(resolved.path.parent / "assets")  # grids are named relative to the file
    assert load(path, adapters=adapters).scenario == resolved.scenario
    monkeypatch.chdir(tmp_path)
    again = load(resolved.scenario, adapters=adapters)
    assert again.scenario == resolved.scenario
    assert again.path is None
    whole = tomllib.loads(explain(resolved))
    assert whole["world"]["clock"]["speed"] == resolved.scenario.world.clock.speed
    assert whole["server"]["metrics_port"] == 9600
    for vehicle in resolved.vehicles.values():
        file = whole["vehicles"][vehicle.name]["file"]
        assert file["rigid_body"]["mass_kg"] == vehicle.vehicle.rigid_body.mass_kg
        assert file["rigid_body"]["status"] == vehicle.vehicle.rigid_body.status
        for thruster, device in vehicle.devices.items():
            told = whole["vehicles"][vehicle.name]["devices"][file["thrusters"][thruster]["device"]]
            assert told["propeller"]["source"] == device.propeller.source
            assert file["thrusters"][thruster]["inflow_factor"] >= 0.0


def test_awkward_text_survives(write: Write, adapters: Adapters) -> None:
    title = 'a "quoted" \\ back\nslash [\n    1,\n] ü\t# no comment'
    scenario = Scenario(schema=1, title=title, seed=2**40)
    path = write(to_toml(scenario))
    assert load(path, adapters=adapters).scenario == load(scenario, adapters=adapters).scenario
    assert load(path, adapters=adapters).scenario.title == title


def built(adapters: Adapters) -> ScenarioBuilder:
    return (
        ScenarioBuilder("built", seed=4, rate_hz=120, adapters=adapters)
        .clock(mode="freerun")
        .environment(density_kgpm3=1000)
        .current(velocity_ned_mps=np.array([0.1, 0.0, 0.0]))
        .server(metrics=False)
        .vehicle("rov", "./tiny.toml", position_ned_m=(0, 0, 2), override={"rigid_body": {"mass_kg": np.float64(9.9)}})
        .truth("rov", rate_hz=10)
        .sensor("rov", "depth", "pressure", rate_hz=10, output="depth")
        .modifier("rov", "depth", "noise", "white_noise", field="depth", sigma=0.1)
        .modifier("rov", "imu", "drift", "random_walk", field="f_S", density=1e-3)
        .stream("rov", "depth", "exact", ideal=True)
        .modifier("rov", "imu", "loss", "dropout", stream="radio", probability=0.1)
        .adapter("tcp", "sockets", port=0)
    )


FILE = """
schema = 1
title = "built"
seed = 4
world = {rate_hz = 120, clock.mode = "freerun"}
[environment]
density_kgpm3 = 1000
current.velocity_ned_mps = [0.1, 0, 0]
[server]
metrics = false
[vehicles.rov]
model = "./tiny.toml"
position_ned_m = [0, 0, 2]
truth.rate_hz = 10
[vehicles.rov.override]
rigid_body.mass_kg = 9.9
sensors.imu.modifiers.drift = {kind = "random_walk", field = "f_S", density = 1e-3}
sensors.imu.streams.radio.modifiers.loss = {kind = "dropout", probability = 0.1}
[vehicles.rov.sensors.depth]
kind = "pressure"
output = "depth"
rate_hz = 10
modifiers.noise = {kind = "white_noise", field = "depth", sigma = 0.1}
streams.exact.ideal = true
[adapters.tcp]
kind = "sockets"
port = 0
"""


def test_builder_gives_what_the_file_gives(write: Write, adapters: Adapters) -> None:
    from_file = load(write(FILE), adapters=adapters)
    from_builder = load(built(adapters).build(), adapters=adapters)
    assert from_builder.scenario == from_file.scenario
    assert from_builder.vehicles == from_file.vehicles
    assert from_builder.name == "built"
    assert list(from_builder.vehicles["rov"].vehicle.sensors["imu"].modifiers) == ["drift"]


@pytest.mark.parametrize(
    ("verb", "text"),
    [
        (lambda b: b.environment(densty_kgpm3=1000), r'built: environment: unknown key "densty_kgpm3" \(did you mean "density_kgpm3"'),
        (lambda b: b.world(rate_hz="fast"), r"built: world.rate_hz: expected a number"),
        (lambda b: b.vehicle("world rov", "x"), r'vehicles."world rov": "world rov" cannot be a name'),
        (lambda b: b.sensor("row", "s", "imu"), r'built: vehicles: there is no vehicle "row" yet \(did you mean "rov"'),
        (lambda b: b.sensor("rov", "s", "imuu"), r'sensors.s.kind: unknown kind "imuu" \(did you mean "imu"\?\)'),
        (lambda b: b.sensor("rov", "s", "imu"), r'sensors.s: missing key "rate_hz"'),
        (lambda b: b.modifier("rov", "depth", "n", "bias", field="depth", vale=1), r'did you mean "value"'),
        (lambda b: b.adapter("x", "zeno"), r'adapters.x.kind: unknown kind "zeno" \(did you mean "zenoh"\?\); allowed: .*sockets'),
        (lambda b: b.current(velocity_ned_mps=(0, 0, float("nan"))), r"velocity_ned_mps\[2\]: .*finite"),
    ],
)  # fmt: skip
def test_builder_refuses_at_once_and_keeps_what_it_had(
    verb: Callable[[ScenarioBuilder], Any], text: str, adapters: Adapters
) -> None:
    builder = built(adapters)
    with pytest.raises(ScenarioError, match=text):
        verb(builder)
    assert builder.build() == built(adapters).build()


def test_faults_of_a_built_scenario_have_no_position(write: Write, adapters: Adapters) -> None:
    write()
    scenario = built(adapters).sensor("rov", "fast", "imu", rate_hz=7).build()
    with pytest.raises(ScenarioError, match=r"^built: vehicles.rov.sensors.fast.rate_hz: 7 Hz does not divide"):
        load(scenario, adapters=adapters)
