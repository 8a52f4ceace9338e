"""Checks of a whole scenario: truth falls on ticks, names and ports are free, faults fit their vehicles.

A small file that asks for more than can be built is refused before anything is built.
"""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import pytest
from msgspec.structs import replace

from uwserver.actuators import TeleportConfig, ThrusterConfig, ThrustersConfig
from uwserver.scenario.files.convert import Converter, Node
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load import checks
from uwserver.scenario.load.checks import check_faults, check_scenario
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.world.tables import Environment
from uwserver.table import Table
from uwserver.world.faults import FaultTable, SensorSilent, ThrusterDead

METRICS = 9600


class Served(Table, tag="served", tag_field="kind", kw_only=True, frozen=True):
    """Configuration of an adapter that listens."""

    port: Any = 0


class Silent(Table, tag="silent", tag_field="kind", kw_only=True, frozen=True):
    """Configuration of one that does not."""


@pytest.fixture
def told(tree_of, report, warn):
    """What is told of a scenario with tables and adapters' configurations."""

    def check(adapters: dict[str, Table] | None = None, **tables: Any) -> tuple[list[str], list[str]]:
        tree = tree_of({"schema": 1, **tables})
        report.lines.clear()  # what conversion tells has tests of its own
        if tree.value is not None:
            tree = Node(replace(tree.value, adapters=adapters or {}), tree.parts)
        check_scenario(tree, report, warn)
        return report.lines, warn.lines

    return check


def test_a_bare_scenario_passes(told) -> None:
    assert told() == ([], [])


@pytest.mark.parametrize(("rate", "fits"), [(240, True), (20, True), (7, False), (480, False)])
def test_truth_falls_on_ticks(rate: float, fits: bool, told) -> None:
    errors, _ = told(vehicles={"rov": {"model": "x", "truth": {"rate_hz": rate}}})
    assert len(errors) == (not fits)
    assert all(line.startswith(f"vehicles.rov.truth.rate_hz: {rate} Hz ") for line in errors)


def test_the_rate_is_that_of_the_world(told) -> None:
    vehicles = {"rov": {"model": "x", "truth": {"rate_hz": 100}}}
    assert told(vehicles=vehicles)[0]
    assert told(world={"rate_hz": 200}, vehicles=vehicles)[0] == []
    assert told(world={"rate_hz": "fast"}, vehicles=vehicles)[0] == []


def test_a_faulty_vehicle_does_not_hide_its_truth(told) -> None:
    errors, _ = told(vehicles={"rov": {"truth": {"rate_hz": 7}}, "odd": 3, "two": {"model": "x", "truth": 3}})
    assert len(errors) == 1


def test_no_vehicle_is_called_world(told) -> None:
    text = 'vehicles.world: a vehicle cannot be named "world", as paths of services begin with it: choose another name'
    assert told(vehicles={"world": {"model": "x"}}) == ([text], [])


def test_time_water_and_currents_are_checked_too(told) -> None:
    layers = {"kind": "profile", "depth_m": [5, 1], "velocity_ned_mps": [[0, 0, 0], [1, 0, 0]]}
    errors, warnings = told(
        world={"epoch_utc": "now"},
        environment={
            "currents": {"layers": layers},
            "water": {"kind": "constant"},
            "density_kgpm3": 900,
            "waves": {"significant_height_m": 20, "peak_period_s": 5, "direction_deg": 0},
        },
    )
    places = [line.split(":")[0] for line in errors]
    assert places == ["world.epoch_utc", "environment.currents.layers.depth_m[1]", "environment.density_kgpm3"]
    assert [line.split(":")[0] for line in warnings] == ["environment.waves.significant_height_m"]


# -- ports ------------------------------------------------------------------------------------------------------------------------------


def test_ports_that_differ_pass(told) -> None:
    adapters = {"a": Served(port=7600), "b": Served(port=7601), "c": Silent(), "d": Served(), "e": Served()}
    assert told(adapters) == ([], [])


def test_a_port_that_two_use_is_doubted_with_the_first(told) -> None:
    errors, warnings = told({"a": Served(port=7600), "b": Served(port=7600), "c": Served(port=7600)})
    assert errors == []
    text = "adapters.a uses port 7600 too: unless one is TCP and the other UDP, only one of them can start"
    assert warnings == [f"adapters.b.port: {text}", f"adapters.c.port: {text}"]


def test_the_port_of_the_metrics_counts_while_they_are_served(told) -> None:
    (line,) = told({"a": Served(port=METRICS)})[1]
    assert line.startswith(f"adapters.a.port: server.metrics_port uses port {METRICS} too")


def test_metrics_that_are_not_served_leave_their_port(told) -> None:
    assert told({"a": Served(port=METRICS)}, server={"metrics": False})[1] == []
    assert told({"a": Served(port=METRICS)}, server={"metrics_port": 9700})[1] == []


def test_what_is_no_number_is_no_port(told) -> None:
    assert told({"a": Served(port="/dev/ttyS0"), "b": Served(port="/dev/ttyS0")}) == ([], [])


def test_ports_of_a_faulty_scenario_are_left_out(told) -> None:
    assert told({"a": Served(port=METRICS)}, title=3) == ([], [])


WATER = Environment()


class Made(FaultTable, tag="made", kw_only=True, frozen=True):
    """A kind of an extension, which comes to what a test says."""

    parts: ClassVar[Any] = None

    def build(self, targets: Any, rng: Any) -> Any:
        return self.parts(self, targets, rng)


@pytest.fixture
def fault_report(tiny, report):
    """What is told of faults of `rov`, a tiny vehicle, and further tables of the scenario."""

    def check(environment: Environment = WATER, entry: Any = None, **faults: Any) -> list[str]:
        raw = {"schema": 1, "vehicles": {"rov": {"model": "x", **(entry or {})}}, "faults": faults}
        tree = Converter(report, {FaultTable: {"made": Made}}).tree(raw, Scenario)
        report.lines.clear()  # what conversion tells has tests of its own
        actuators = {
            "thrusters": ThrustersConfig(),
            "one": ThrusterConfig(member="left"),
            "move": TeleportConfig(),
        }
        check_faults(tree, {"rov": replace(tiny, actuators=actuators)}, environment, report)
        lines: list[str] = report.lines
        return lines

    return check


def dead(**keys: Any) -> dict[str, Any]:
    return {"kind": "thruster_dead", "target": "rov/thrusters", **keys}


def lighter(**keys: Any) -> dict[str, Any]:
    return {"kind": "buoyancy_change", "target": "rov", **keys}


def test_good_faults_pass(fault_report) -> None:
    assert fault_report() == []
    silent = {"kind": "sensor_silent", "target": "rov/imu"}
    assert fault_report(a=dead(), b=dead(target="rov/one", members=["left"]), c=lighter(fraction=-0.1), d=silent) == []


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        (dead(target="rov/move"), 'target: no actuator of thrusters "rov/move", there are: rov/thrusters, rov/one'),
        (dead(target="rov"), 'target: no actuator of thrusters "rov", there are: rov/thrusters, rov/one'),
        (dead(members=["t9"]), 'members: no thruster "t9" in "rov/thrusters", there are: left'),
        ({"kind": "sensor_frozen", "target": "rov/dvl"}, 'target: no sensor "rov/dvl", there are: rov/imu'),
        (lighter(target="row", fraction=0.1), 'target: no vehicle "row", there are: rov'),
        (dead(at_s=5, until_s=5), "until_s: 5 s is not after its begin at 5 s"),
        (lighter(volume_m3=-0.01), "volume_m3: it takes away more than the 0.0098 m3 that the hull has"),
        (lighter(fraction=9.5), "fraction: 0.1029 m3 would be more than 10 times the 0.0098 m3 of the hull"),
        ({"kind": "mass_loss", "target": "rov", "mass_kg": 10}, "mass_kg: it leaves no mass or no moment of inertia of the 10 kg"),
    ],
)  # fmt: skip
def test_a_fault_that_cannot_be_is_told_at_its_key(fault: dict[str, Any], line: str, fault_report) -> None:
    assert fault_report(f=fault) == [f"faults.f.{line}"]


def test_truth_is_a_target_where_there_is_some(fault_report) -> None:
    frozen = {"kind": "sensor_frozen", "target": "rov/truth/pose"}
    (line,) = fault_report(f=frozen)
    assert 'no sensor "rov/truth/pose"' in line
    lines = fault_report(entry={"truth": {"rate_hz": 10}}, f={**frozen, "target": "rov/truth/nothing"})
    assert "there are: rov/imu, rov/truth/" in lines[-1]


def test_each_copy_is_a_target_and_their_table_is_none(fault_report) -> None:
    entry = {"copies": {"count": 2}}
    assert fault_report(entry=entry, a=dead(target="rov_2/thrusters"), b=lighter(target="rov_1", fraction=0.1)) == []
    (line,) = fault_report(entry=entry, a=dead())
    assert "there are: rov_1/thrusters, rov_1/one, rov_2/thrusters, rov_2/one" in line


def test_what_faults_leave_together_counts(fault_report) -> None:
    lines = fault_report(a=lighter(volume_m3=-0.005), b=lighter(volume_m3=-0.004), c=lighter(volume_m3=-0.001))
    assert lines == ["faults.c.volume_m3: it takes away more than the 0.0098 m3 that the hull has"]


def test_without_gravity_there_is_no_force_of_buoyancy(fault_report) -> None:
    lines = fault_report(Environment(gravity_mps2=0), f=lighter(force_N=1.0))
    assert lines == ["faults.f.force_N: there is no buoyancy without gravity: give fraction or volume_m3"]


def test_a_fault_with_a_fault_of_its_table_is_left_out(fault_report) -> None:
    lines = fault_report(a={"kind": "nothing"}, b=lighter(), c=dead(members=["x"]))
    assert [line.split(":")[0] for line in lines] == ["faults.c.members"]


# -- kinds of an extension --------------------------------------------------------------------------------------------------------------


@pytest.fixture
def made(fault_report, monkeypatch):
    def check(parts: Any, *, count: int = 1) -> list[str]:
        monkeypatch.setattr(Made, "parts", staticmethod(parts))
        names = [f"f{k}" for k in range(count)]
        lines: list[str] = fault_report(**{name: {"kind": "made", "target": "rov/thrusters"} for name in names})
        return lines

    return check


def test_one_that_comes_to_good_faults_passes(made) -> None:
    good = (ThrusterDead(target="rov/thrusters"), SensorSilent(target="rov/imu", at_s=3.0))
    assert made(lambda fault, targets, rng: good) == []
    assert made(lambda fault, targets, rng: list(good)) == []


def test_it_is_given_what_there_is_to_fail(made) -> None:
    seen = []
    made(lambda fault, targets, rng: seen.append((fault.target, targets, rng.random())))
    ((target, targets, number),) = seen
    assert target == "rov/thrusters"
    assert targets.thrusters == {"rov/thrusters": ("left",), "rov/one": ("left",)}
    assert targets.sensors == ("rov/imu",)
    assert targets.hulls["rov"].volume == 0.0098
    assert 0.0 <= number < 1.0


@pytest.mark.parametrize(
    ("parts", "told_of"),
    [
        (lambda fault, targets, rng: None, "build() must give a tuple of faults of shipped kinds, not None"),
        (lambda fault, targets, rng: [], "build() must give a tuple of faults of shipped kinds, not []"),
        (lambda fault, targets, rng: (fault,), "build() must give a tuple of faults of shipped kinds, not (Made("),
        (lambda fault, targets, rng: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda fault, targets, rng: (ThrusterDead(target="x"),), 'it results in a "thruster_dead" fault with an error: target: no actuator of thrusters "x"'),
    ],
)  # fmt: skip
def test_one_that_does_not_is_told(parts: Any, told_of: str, made) -> None:
    (line,) = made(parts)
    assert line.startswith("faults.f0: ")
    assert told_of in line


def test_a_world_has_room_for_some_faults_only(made) -> None:
    def many(fault: Any, targets: Any, rng: Any) -> Any:
        return [ThrusterDead(target="rov/thrusters", at_s=float(k)) for k in range(100)]

    assert made(many, count=2) == []
    (line,) = made(many, count=3)
    assert line == "faults.f2: a world can have at most 256 faults, and this is one too many: remove some"


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
    assert f"at most {checks.MOST_COMPONENTS}" in refusal(tmp_path, rov + sensors)


def test_streams_and_modifiers_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "one.toml"
    vehicle = '[vehicles.rov]\nmodel = "bluerov2"\n[vehicles.rov.sensors.p]\nkind = "pressure"\nrate_hz = 10\n'
    stream = '[vehicles.rov.sensors.p.streams.s]\n[vehicles.rov.sensors.p.streams.s.modifiers.m]\nkind = "bias"\n'
    path.write_text(HEAD + vehicle + stream + 'field = "pressure"\nvalue = 1.0\n')
    file = load(path, adapters={}).vehicles["rov"].vehicle
    own = len(file.sensors) + len(file.actuators) + sum(len(sensor.modifiers) for sensor in file.sensors.values())
    monkeypatch.setattr(checks, "MOST_COMPONENTS", own + 1)
    with pytest.raises(ScenarioError, match=f"{own + 2} sensors"):
        load(path, adapters={})
    monkeypatch.setattr(checks, "MOST_COMPONENTS", own + 2)
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
