"""Device files: which keys those of sensors fill in and what wins, and checks of those of thrusters and sensors."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

import copy
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec import structs

from uwserver.frames import quat_from_rpy
from uwserver.physics.geometry.shapes import HalfSpace, Placed, Solid
from uwserver.physics.scene import Scene
from uwserver.ports import Refused
from uwserver.scenario.build.world import build
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.devices import check_device, check_profile
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import ThrusterDevice
from uwserver.sensors import DvlConfig, Pose, SensorConfig
from uwserver.testing import FakeGeometry
from uwserver.testing.fake_geometry import Plane
from uwserver.testing.sensors import scopes

SHIPPED = Path(__file__).parents[4] / "scenarios" / "uwserver_scenarios" / "devices"
PROFILES = [path for path in sorted(SHIPPED.glob("*.toml")) if "properties" in msgspec.toml.decode(path.read_bytes())]
SCENARIO = """\
schema = 1
[vehicles.rov]
model = "bluerov2_heavy"
[vehicles.rov.sensors.log]
kind = "dvl"
profile = "{profile}"
rate_hz = 8
{more}
"""


def loaded(tmp_path: Path, profile: str = "a50", more: str = ""):
    path = tmp_path / "x.toml"
    path.write_text(SCENARIO.format(profile=profile, more=more))
    return load(path, adapters={}).vehicles["rov"].vehicle.sensors["log"]


@pytest.mark.parametrize("path", PROFILES, ids=lambda path: path.stem)
def test_shipped_device_files_make_sensors(path):
    problems = []
    keys = check_profile(msgspec.toml.decode(path.read_bytes()), lambda *problem: problems.append(problem))
    assert problems == []
    assert keys["kind"] in kinds_of(SensorConfig)
    assert msgspec.toml.decode(path.read_bytes())["name"] == path.stem


def test_the_device_fills_in_and_the_table_wins(tmp_path):
    config = loaded(tmp_path, more="max_altitude_m = 30")
    assert isinstance(config, DvlConfig)
    assert (config.beam_angle_deg, config.range_modes[0]) == (22.5, (0.05, 0.6, 15.0))
    assert (config.max_altitude_m, config.rate_hz) == (30, 8)


def test_a_scenario_built_in_python():
    entry = VehicleEntry(model="bluerov2_heavy", sensors={"log": DvlConfig(profile="dvl1000", rate_hz=8)})
    world = build(load(Scenario(schema=1, vehicles={"rov": entry}), adapters={}))
    assert world.call("rov/log/get")["max_altitude"] == 75.0


def test_a_file_of_ones_own(tmp_path):
    text = (SHIPPED / "a50.toml").read_text().replace("22.5", "30.0")
    (tmp_path / "mine.toml").write_text(text)
    assert loaded(tmp_path, "mine.toml").beam_angle_deg == 30.0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("beam_angle_deg = 22.5", "beam_angel_deg = 22.5"), 'mine.toml:17:1: properties.beams.beam_angel_deg: unknown key'),
        (('status = "derived"\nbeam_angle', "beam_angle"), 'properties.beams: missing key "status"'),
        (("beam_angle_deg = 22.5", "beam_angle_deg = 99"), "properties.beams.beam_angle_deg: expected"),
        (("beam_angle_deg = 22.5", "beam_angle_deg = 20\nfrequency_hz = 1e6"), '"frequency_hz" is given twice, also at properties.acoustics'),
        (('kind = "dvl"', 'kind = "imu"'), "unknown key"),
        (('title = "Water Linked DVL A50"', ""), 'missing key "title"'),
    ],
)  # fmt: skip
def test_faults_of_a_device_file(tmp_path, change, told):
    text = (SHIPPED / "a50.toml").read_text()
    assert change[0] in text
    (tmp_path / "mine.toml").write_text(text.replace(*change))
    with pytest.raises(ScenarioError) as caught:
        loaded(tmp_path, "mine.toml")
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("profile", "told"),
    [
        ("a5", 'unknown device "a5" (did you mean "a50"?)'),
        ("t200", "t200.toml"),
        ("b/mine.toml", "there is no device file"),
    ],
)
def test_faults_of_the_reference(tmp_path, profile, told):
    with pytest.raises(ScenarioError) as caught:
        loaded(tmp_path, profile)
    assert told in str(caught.value)


def test_kinds_must_agree(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text(SCENARIO.format(profile="a50", more="").replace('kind = "dvl"', 'kind = "imu"'))
    with pytest.raises(ScenarioError, match='a device of kind "dvl", but this sensor is of kind "imu"'):
        load(path, adapters={})


def pings(name, distance, n):
    """Readings of a shipped device that looks down on sediment, and its settings."""
    keys = check_profile(msgspec.toml.decode((SHIPPED / f"{name}.toml").read_bytes()), lambda *_: None)
    reach = keys.get("max_altitude_m", keys.get("max_range_m"))
    config = msgspec.convert({"rate_hz": 240.0, **keys, **({"range_m": reach} if "bins" in keys else {})}, SensorConfig)
    down = quat_from_rpy(0.0, -math.pi / 2.0, 0.0) if "bins" in keys else (1.0, 0.0, 0.0, 0.0)
    bottom = FakeGeometry([Plane((0.0, 0.0, 200.0 + distance * reach), (0.0, 0.0, -1.0))])
    sensor = config.build(Pose(q=down))
    sensor.start(0)
    found = []
    for _ in range(n):
        calm = {"ready", "scale", "index"} & set(sensor.memory.__struct_fields__)
        sensor.memory = structs.replace(sensor.memory, **dict.fromkeys(calm, 0))
        found.append(sensor.measure(replace(scopes()[0], p_NB=(0.0, 0.0, 200.0), geometry=bottom)))
    return reach, found


@pytest.mark.parametrize(("name", "field"), [("a50", 1), ("dvl1000", 1), ("ping1d", 0), ("micron_echosounder", 0)])
@pytest.mark.parametrize("part", [0.1, 0.5, 0.8])
def test_shipped_altimeters_and_dvls_reach_what_they_promise(name, field, part):
    """Sediment within 0.8 of the range is told where it is; twice as far it is not."""
    reach, found = pings(name, part, 40)
    heard = [values[field] for valid, values in found[10:] if valid]
    assert len(heard) > 20
    assert np.median(heard) == pytest.approx(part * reach, rel=0.03)
    assert not any(valid for valid, _ in pings(name, 2.0, 20)[1])


@pytest.mark.parametrize(
    ("name", "part"),
    [("micron_dst", 0.1), ("micron_dst", 0.5), ("micron_dst", 0.8), ("ping360", 0.1), ("ping360", 0.4)],
)
def test_shipped_sonars_reach_what_they_promise(name, part):
    """A wall of sediment stands out of the noise of an empty picture, at its range; the picture is neither black nor white."""
    reach, found = pings(name, part, 10)
    seen = np.mean([values[3] for _, values in found], axis=0)
    empty = np.mean([values[3] for _, values in pings(name, 2.0, 10)[1]], axis=0)
    excess = np.convolve(seen - empty, np.full(5, 0.2), "same")
    assert 15.0 < excess.max() < 255.0
    first = int(np.argmax(excess > 0.5 * excess.max()))
    assert (first + 0.5) / len(excess) * reach == pytest.approx(part * reach, rel=0.04)
    assert empty.mean() < 100.0


# -- instruments in the world -----------------------------------------------------------------------------------------------------------


def test_settings_memory_and_stream_are_part_of_a_snapshot(tmp_path):
    """Back at a snapshot, an instrument goes on as it did: settings, random numbers and the time of its next ping."""
    path = tmp_path / "x.toml"
    path.write_text(SCENARIO.format(profile="a50", more=""))
    world = build(load(path, adapters={}))
    scene = Scene(lambda: world.hydro.state)
    scene.add_static(Solid("bottom", (Placed(HalfSpace(), p=(0.0, 0.0, 9.0)),)))
    world.set_scene(scene)
    world.command("rov/thrusters", u=[0.3] * 8)
    world.step(200)
    world.call("rov/log/set", max_altitude=40.0)
    world.call("world/snapshot")
    digest = world.call("world/state_hash")["hash"]
    first = world.step(300)
    world.call("rov/log/set", max_altitude=1.0)
    assert world.call("world/state_hash")["hash"] != digest
    world.call("world/restore")
    assert world.call("world/state_hash")["hash"] == digest
    assert world.call("rov/log/get")["max_altitude"] == 40.0
    assert world.step(300) == first
    assert any(s.port == "rov/log" and s.valid and s.t_sent_ns > s.t_ns for s in first)


def test_set_takes_all_or_nothing(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text(SCENARIO.format(profile="a50", more=""))
    world = build(load(path, adapters={}))
    for wrong in ({"max_altitude": 20.0, "rate_hz": 7.0}, {"range_mode": 9, "rate_hz": 4.0}, {"max_altitude": 1e6}):
        with pytest.raises(Refused):
            world.call("rov/log/set", **wrong)
    assert world.call("rov/log/get") == {
        "rate_hz": 8.0, "active": True, "latency_s": 0.0, "max_altitude": 50.0, "range_mode": -1, "tracking": "both", "sound_speed": 1500.0,
    }  # fmt: skip
    world.call("rov/log/set", rate_hz=4.0, tracking="bottom")
    assert world.call("rov/log/get")["rate_hz"] == 4.0


SOURCE = {"source": "x", "status": "guess"}
THIRD_ORDER = {**SOURCE, "numerator": [1.0], "denominator": [1.0, 6.0, 11.0, 6.0]}


@pytest.fixture
def told(raw_device, tree_of, report):
    """What is told of the good device with tables in the place of its own; None takes one out."""

    def check(**tables: Any) -> list[str]:
        raw = copy.deepcopy(raw_device)
        for name, table in tables.items():
            raw[name] = table
            if table is None:
                del raw[name]
        tree = tree_of(raw, ThrusterDevice)
        report.lines.clear()  # what conversion tells has tests of its own
        check_device(tree, report)
        lines: list[str] = report.lines
        return lines

    return check


def curve(**keys: Any) -> dict[str, Any]:
    return {**SOURCE, "voltage_V": 16, "max_forward_N": 50, "max_reverse_N": 40, "dead_band": [-0.1, 0.1], **keys}


def test_a_good_device_passes(told) -> None:
    assert told() == []
    assert told(lag=THIRD_ORDER) == []
    assert told(curves={"a": curve(), "b": curve(voltage_V=12)}) == []


@pytest.mark.parametrize("coefficients", [[0.0], [1.0, -1.0], [-2.0, 1.0], []])
def test_full_command_must_push(coefficients: list[float], told) -> None:
    text = "shape.coefficients: their sum, which is the force at full command, must be greater than 0"
    assert told(shape={**SOURCE, "coefficients": coefficients}) == [text]


def test_a_device_needs_a_curve_and_has_room_for_some(told) -> None:
    assert told(curves={}) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 0"]
    many = {f"c{k}": curve(voltage_V=10 + k) for k in range(9)}
    assert told(curves=many) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 9"]
    del many["c8"]
    assert told(curves=many) == []
    assert told(curves=None) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 0"]
    assert told(curves=3) == ["curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 0"]


@pytest.mark.parametrize(
    ("band", "fits"),
    [([-0.1, 0.1], True), ([0, 0], True), ([-0.1, 0], True), ([0.05, 0.1], False), ([-0.1, -0.05], False), ([-1, 0.1], False), ([-0.1, 1], False), ([0.1, -0.1], False)],
)  # fmt: skip
def test_the_dead_band_holds_zero(band: list[float], fits: bool, told) -> None:
    lines = told(curves={"a": curve(dead_band=band)})
    low, high = band
    text = f"curves.a.dead_band: ({low:g}, {high:g}) must lie inside (-1, 1) and hold 0"
    assert lines == ([] if fits else [text])


def points(commands: list[float], forces: list[float], voltage: float = 12.0) -> dict[str, Any]:
    return {**SOURCE, "voltage_V": voltage, "commands": commands, "forces_N": forces}


def test_measured_points_need_no_shape_and_limits_do(told) -> None:
    assert told(tables={"a": points([-1, 0, 1], [-5, 0, 5])}, shape=None, curves=None) == []
    text = "curves: curves need the table [shape], the force between dead band and limits; or give measured points under [tables]"
    assert told(tables={"a": points([-1, 0, 1], [-5, 0, 5])}, shape=None) == [text]


@pytest.mark.parametrize(
    ("commands", "forces", "fault"),
    [
        ([-1, -0.1, 0.1, 1], [-5, 0, 0, 5], ""),
        ([-1, 1], [0, 5], ""),  # one that cannot reverse
        ([-1, 0, 1], [-5, 5], ": needs 2 to 48 commands and a force for each, found 3 commands and 2 forces"),
        ([1], [5], ": needs 2 to 48 commands and a force for each, found 1 commands and 1 forces"),
        (
            [-1, *(k / 60 for k in range(48))],
            [0.0] * 49,
            ": needs 2 to 48 commands and a force for each, found 49 commands and 49 forces",
        ),
        ([-0.9, 0, 1], [-5, 0, 5], ".commands: commands must rise from -1 to 1"),
        ([-1, 0, 0, 1], [-5, 0, 0, 5], ".commands: commands must rise from -1 to 1"),
        (
            [-1, 0, 1],
            [-5, 1, 0],
            ".forces_N: forces must not fall from value to value; the first must be at most 0, the last at least 0",
        ),
        (
            [-1, 0, 1],
            [1, 2, 3],
            ".forces_N: forces must not fall from value to value; the first must be at most 0, the last at least 0",
        ),
    ],
)
def test_measured_points_rise_over_the_whole_command(
    commands: list[float], forces: list[float], fault: str, told
) -> None:
    lines = told(tables={"a": points(commands, forces)}, curves=None)
    assert lines == ([f"tables.a{fault}"] if fault else [])


def test_tables_and_curves_share_their_voltages_and_their_room(told) -> None:
    table = points([-1, 0, 1], [-5, 0, 5], 16.0)
    assert told(tables={"t": table}, curves={"a": curve()}) == [
        'curves.a.voltage_V: the curve "t" is for 16 V too: remove one of the two'
    ]
    many = {f"c{k}": curve(voltage_V=20 + k) for k in range(8)}
    assert told(tables={"t": table}, curves=many) == [
        "curves: a device needs 1 to 8 force curves (under [curves] or [tables]), found 9"
    ]


def test_two_curves_of_one_voltage_are_told_with_the_first(told) -> None:
    lines = told(curves={"a": curve(), "b": curve(voltage_V=12), "c": curve(), "d": curve()})
    assert lines == [f'curves.{name}.voltage_V: the curve "a" is for 16 V too: remove one of the two' for name in "cd"]


def test_a_faulty_curve_counts_but_is_left_out(told) -> None:
    assert told(curves={"a": curve(voltage_V="high", dead_band=[1, 1]), "b": curve()}) == []


@pytest.mark.parametrize(
    "lag",
    [
        {},
        {"time_constant_s": 0.1, "numerator": [1.0]},
        {"time_constant_s": 0.1, "numerator": [1.0], "denominator": [1.0, 1.0, 1.0, 1.0]},
        {"numerator": [1.0]},
        {"denominator": [1.0, 6.0, 11.0, 6.0]},
    ],
)
def test_the_lag_has_one_form(lag: dict[str, Any], told) -> None:
    assert told(lag={**SOURCE, **lag}) == ["lag: give exactly one form: time_constant_s, or numerator and denominator"]


@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [([1.0], [1.0, 1.0]), ([1.0], [0.0, 1.0, 1.0, 1.0]), ([1.0] * 4, [1.0, 6.0, 11.0, 6.0]), ([1.0], [1.0] * 5)],
)
def test_the_order_of_a_transfer_function(numerator: list[float], denominator: list[float], told) -> None:
    lag = {**SOURCE, "numerator": numerator, "denominator": denominator}
    text = "lag: a transfer function needs 4 denominator and at most 3 numerator coefficients"
    assert told(lag=lag) == [text]


@pytest.mark.parametrize(
    ("denominator", "stable"),
    [([1.0, 6.0, 11.0, 6.0], True), ([1.0, 4.0, 1.0, -6.0], False), ([1.0, 0.0, 1.0, 0.0], False), ([1.0, 3.0, 3.0, 1.0], True)],
)  # fmt: skip
def test_a_lag_is_stable(denominator: list[float], stable: bool, told) -> None:
    """Roots (-1, -2, -3), (1, -2, -3), on the imaginary axis, and three times -1."""
    lines = told(lag={**SOURCE, "numerator": [1.0], "denominator": denominator})
    text = "lag.denominator: the lag is unstable: all roots of the denominator need a negative real part"
    assert lines == ([] if stable else [text])


def test_all_faults_of_a_device_are_told(told) -> None:
    lines = told(shape={**SOURCE, "coefficients": [-1.0]}, curves={"a": curve(dead_band=[0.1, 0.2])}, lag=SOURCE)
    assert [line.split(":")[0] for line in lines] == ["shape.coefficients", "curves.a.dead_band", "lag"]


def test_holes_are_left_out(told) -> None:
    assert told(shape={**SOURCE, "coefficients": "x"}, lag={**SOURCE, "time_constant_s": -1}) == []
    assert told(lag=None) == []
    assert told(tables={"a": {**SOURCE, "voltage_V": 12, "commands": "x"}}) == []
