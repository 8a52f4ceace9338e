"""A scenario in Python: each verb puts its table where the file has it, checks it at once, and refuses without a trace."""

# ruff: noqa: E501 - one case a line
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.export import tables


@pytest.fixture
def builder() -> ScenarioBuilder:
    return ScenarioBuilder("built", adapters={}).vehicle("rov", "bluerov2")


def raw(builder: ScenarioBuilder) -> dict[str, Any]:
    return tables(builder.build())


def test_a_bare_one() -> None:
    scenario = ScenarioBuilder("tank", seed=3, rate_hz=120).build()
    assert (scenario.schema, scenario.title, scenario.seed, scenario.world.rate_hz) == (1, "tank", 3, 120.0)
    assert scenario.vehicles == scenario.adapters == {}


Verb = Callable[[ScenarioBuilder], ScenarioBuilder]


@pytest.mark.parametrize(
    ("verb", "path", "table"),
    [
        (lambda b: b.world(origin_lat_deg=1, origin_lon_deg=2), ("world",), {"origin_lat_deg": 1.0, "origin_lon_deg": 2.0}),
        (lambda b: b.clock(mode="freerun"), ("world", "clock"), {"mode": "freerun"}),
        (lambda b: b.environment(gravity_mps2=9.8), ("environment",), {"gravity_mps2": 9.8}),
        (lambda b: b.current(velocity_ned_mps=[1, 0, 0]), ("environment", "current"), {"velocity_ned_mps": [1.0, 0.0, 0.0]}),
        (lambda b: b.add_current("tide", "uniform", velocity_ned_mps=[1, 0, 0]), ("environment", "currents", "tide"), {"kind": "uniform", "velocity_ned_mps": [1.0, 0.0, 0.0]}),
        (lambda b: b.server(metrics=False), ("server",), {"metrics": False}),
        (lambda b: b.seabed("flat", depth_m=9), ("seabed",), {"kind": "flat", "depth_m": 9.0}),
        (lambda b: b.structure("wall", "sphere", radius_m=1), ("structures", "wall"), {"kind": "sphere", "radius_m": 1.0}),
        (lambda b: b.free_object("ball", "sphere", radius_m=1, mass_kg=2), ("objects", "ball"), {"kind": "sphere", "radius_m": 1.0, "mass_kg": 2.0}),
        (lambda b: b.vehicle("two", "lauv", present=False), ("vehicles", "two"), {"model": "lauv", "present": False}),
        (lambda b: b.truth("rov", rate_hz=10), ("vehicles", "rov", "truth"), {"rate_hz": 10.0}),
        (lambda b: b.sensor("rov", "imu", "imu", rate_hz=60), ("vehicles", "rov", "sensors", "imu"), {"kind": "imu", "rate_hz": 60.0}),
        (lambda b: b.fault("f", "sensor_silent", "rov/imu", at_s=3), ("faults", "f"), {"kind": "sensor_silent", "target": "rov/imu", "at_s": 3.0}),
    ],
)  # fmt: skip
def test_each_verb_puts_its_table_where_the_file_has_it(
    verb: Verb, path: tuple[str, ...], table: dict[str, Any], builder: ScenarioBuilder
) -> None:
    assert verb(builder) is builder
    found: Any = raw(builder)
    for key in path:
        found = found[key]
    assert table.items() <= found.items()


def test_waves(builder: ScenarioBuilder) -> None:
    builder.waves(significant_height_m=1, peak_period_s=8, direction_deg=30)
    waves = builder.build().environment.waves
    assert not isinstance(waves, msgspec.UnsetType)
    assert (waves.significant_height_m, waves.direction_deg) == (1.0, 30.0)


def test_a_verb_said_twice_adds_to_its_table(builder: ScenarioBuilder) -> None:
    builder.environment(gravity_mps2=9.8).environment(temperature_degc=4).environment(gravity_mps2=9.7)
    environment = builder.build().environment
    assert (environment.gravity_mps2, environment.temperature_degc) == (9.7, 4.0)
    builder.sensor("rov", "imu", "imu", rate_hz=60).sensor("rov", "imu", "imu", latency_s=0.1)
    assert builder.build().vehicles["rov"].sensors["imu"].rate_hz == 60.0


def test_arrays_and_numbers_of_numpy_and_tuples_are_taken(builder: ScenarioBuilder) -> None:
    builder.vehicle(
        "two", "lauv", position_ned_m=np.array([1.0, 2.0, 3.0]), override={"a": {"b": (np.float64(1.5), 2)}}
    )
    entry = builder.build().vehicles["two"]
    assert entry.position_ned_m == (1.0, 2.0, 3.0)
    assert entry.override == {"a": {"b": [1.5, 2]}}
    assert type(entry.override["a"]["b"][0]) is float


# -- sensors and their errors -----------------------------------------------------------------------------------------------------------


def test_errors_of_an_added_sensor_stand_beside_it(builder: ScenarioBuilder) -> None:
    builder.sensor("rov", "depth", "pressure", rate_hz=10)
    builder.modifier("rov", "depth", "noise", "white_noise", field="pressure", sigma=1.0)
    builder.stream("rov", "depth", "radio").modifier("rov", "depth", "loss", "dropout", stream="radio", probability=0.1)
    sensor = raw(builder)["vehicles"]["rov"]["sensors"]["depth"]
    assert sensor["modifiers"]["noise"] == {"kind": "white_noise", "field": "pressure", "sigma": 1.0}
    assert sensor["streams"]["radio"]["modifiers"]["loss"] == {"kind": "dropout", "probability": 0.1}


def test_errors_of_a_sensor_of_the_vehicle_file_override_it(builder: ScenarioBuilder) -> None:
    builder.modifier("rov", "imu", "drift", "random_walk", field="f_S", density=1e-3)
    entry = raw(builder)["vehicles"]["rov"]
    assert "sensors" not in entry
    assert entry["override"]["sensors"]["imu"]["modifiers"]["drift"]["kind"] == "random_walk"


@pytest.mark.parametrize(
    "verb",
    [
        lambda b: b.truth("row", rate_hz=10),
        lambda b: b.sensor("row", "imu", "imu", rate_hz=60),
        lambda b: b.stream("row", "imu", "radio"),
        lambda b: b.modifier("row", "imu", "n", "bias", field="f_S", value=1.0),
    ],
)
def test_a_vehicle_comes_before_its_parts(verb: Verb, builder: ScenarioBuilder) -> None:
    with pytest.raises(ScenarioError, match=r'built: vehicles: there is no vehicle "row" yet \(did you mean "rov"\?\)'):
        verb(builder)


# -- refusals ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verb", "text"),
    [
        (lambda b: b.world(rate=3), r'built: world: unknown key "rate" \(did you mean "rate_hz"\?\)'),
        (lambda b: b.clock(mode="fast"), r"built: world\.clock\.mode: expected one of"),
        (lambda b: b.add_current("1", "uniform", velocity_ned_mps=[0, 0, 0]), r'"1" cannot be a name'),
        (lambda b: b.add_current("a", "unifrom"), r'unknown kind "unifrom" \(did you mean "uniform"\?\)'),
        (lambda b: b.waves(significant_height_m=1), r"built: environment\.waves: missing key"),
        (lambda b: b.seabed("flat"), r'built: seabed: missing key "depth_m"'),
        (lambda b: b.structure("w", "box", size_m=[1, 2]), r"structures\.w\.size_m: expected an array of 3"),
        (
            lambda b: b.free_object("o", "sphere", radius_m=-1),
            r"objects\.o\.radius_m: expected a number greater than 0",
        ),
        (lambda b: b.vehicle("v", ""), r"vehicles\.v\.model: expected a string that is not empty"),
        (lambda b: b.fault("f", "mass_loss", "rov"), r'faults\.f: missing key "mass_kg"'),
        (lambda b: b.fault("f", "buoyancy_change", "rov"), r"give exactly one of force_N, fraction and volume_m3: 0"),
        (lambda b: b.modifier("rov", "imu", "n", "noise"), r'modifiers\.n\.kind: unknown kind "noise"'),
        (lambda b: b.adapter("a", "sockets"), r'adapters\.a\.kind: unknown kind "sockets"; allowed: none'),
        (lambda b: b.server(metrics_port=70000), r"server\.metrics_port: expected a whole number from 0 to 65535"),
    ],
)
def test_a_wrong_key_is_refused_at_once_and_leaves_no_trace(verb: Verb, text: str, builder: ScenarioBuilder) -> None:
    before = builder.build()
    with pytest.raises(ScenarioError, match=text):
        verb(builder)
    assert builder.build() == before


def test_all_faults_of_a_verb_are_told(builder: ScenarioBuilder) -> None:
    with pytest.raises(ScenarioError) as refused:
        builder.environment(gravity_mps2=-1, densty_kgpm3=1000, temperature_degc="cold")
    assert len(refused.value.problems) == 3
    assert {(p.file, p.line) for p in refused.value.problems} == {("built", 0)}


def test_without_a_title_it_is_called_a_scenario() -> None:
    with pytest.raises(ScenarioError, match=r"^scenario: world: unknown key"):
        ScenarioBuilder("").world(x=1)


def test_what_was_built_does_not_change_with_the_builder(builder: ScenarioBuilder) -> None:
    first = builder.build()
    builder.sensor("rov", "imu", "imu", rate_hz=60)
    assert first.vehicles["rov"].sensors == {}
    assert list(builder.build().vehicles["rov"].sensors) == ["imu"]


# -- extensions -------------------------------------------------------------------------------------------------------------------------


def test_kinds_of_extensions_are_known_after_it(beside: Path) -> None:
    builder = ScenarioBuilder("built", adapters={}).vehicle("rov", "bluerov2")
    with pytest.raises(ScenarioError, match='unknown kind "tide"'):
        builder.add_current("t", "tide", velocity_ned_mps=[1, 0, 0])
    builder.extension("river.py").extension("loose.py")
    builder.add_current("t", "tide", velocity_ned_mps=[1, 0, 0])
    builder.fault("plug", "loose_connector", "rov/thrusters", until_s=5)
    scenario = builder.build()
    assert scenario.extensions == (str(beside / "river.py"), str(beside / "loose.py"))
    assert type(scenario.environment.currents["t"]).__name__ == "TideConfig"
    assert type(scenario.faults["plug"]).__name__ == "LooseConnectorConfig"


def test_an_extension_that_fails_is_not_taken(beside: Path) -> None:
    builder = ScenarioBuilder("built", adapters={})
    with pytest.raises(ScenarioError, match=r'built: extensions: there is no Python file "none\.py"'):
        builder.extension("none.py")
    (beside / "bad.py").write_text("1 / 0\n")
    with pytest.raises(ScenarioError, match=r"bad\.py:1:1: running it failed: ZeroDivisionError"):
        builder.extension("bad.py")
    assert builder.build().extensions == ()
