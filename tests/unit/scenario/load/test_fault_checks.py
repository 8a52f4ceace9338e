"""Checks of a scenario's faults against its vehicles: targets, members, and what would be left of a hull."""

# ruff: noqa: E501 - one case a line
from __future__ import annotations

from typing import Any, ClassVar

import pytest
from msgspec.structs import replace

from uwserver.actuators import TeleportConfig, ThrusterConfig, ThrustersConfig
from uwserver.scenario.files.convert import Converter
from uwserver.scenario.load.fault_checks import check_faults
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.water.tables import Environment
from uwserver.world.faults import FaultTable, SensorSilent, ThrusterDead

WATER = Environment()


class Made(FaultTable, tag="made", kw_only=True, frozen=True):
    """A kind of an extension, which comes to what a test says."""

    parts: ClassVar[Any] = None

    def build(self, targets: Any, rng: Any) -> Any:
        return self.parts(self, targets, rng)


@pytest.fixture
def told(tiny, report):
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


def test_good_faults_pass(told) -> None:
    assert told() == []
    silent = {"kind": "sensor_silent", "target": "rov/imu"}
    assert told(a=dead(), b=dead(target="rov/one", members=["left"]), c=lighter(fraction=-0.1), d=silent) == []


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
def test_a_fault_that_cannot_be_is_told_at_its_key(fault: dict[str, Any], line: str, told) -> None:
    assert told(f=fault) == [f"faults.f.{line}"]


def test_truth_is_a_target_where_there_is_some(told) -> None:
    frozen = {"kind": "sensor_frozen", "target": "rov/truth/pose"}
    (line,) = told(f=frozen)
    assert 'no sensor "rov/truth/pose"' in line
    lines = told(entry={"truth": {"rate_hz": 10}}, f={**frozen, "target": "rov/truth/nothing"})
    assert "there are: rov/imu, rov/truth/" in lines[-1]


def test_each_copy_is_a_target_and_their_table_is_none(told) -> None:
    entry = {"copies": {"count": 2}}
    assert told(entry=entry, a=dead(target="rov_2/thrusters"), b=lighter(target="rov_1", fraction=0.1)) == []
    (line,) = told(entry=entry, a=dead())
    assert "there are: rov_1/thrusters, rov_1/one, rov_2/thrusters, rov_2/one" in line


def test_what_faults_leave_together_counts(told) -> None:
    lines = told(a=lighter(volume_m3=-0.005), b=lighter(volume_m3=-0.004), c=lighter(volume_m3=-0.001))
    assert lines == ["faults.c.volume_m3: it takes away more than the 0.0098 m3 that the hull has"]


def test_without_gravity_there_is_no_force_of_buoyancy(told) -> None:
    lines = told(Environment(gravity_mps2=0), f=lighter(force_N=1.0))
    assert lines == ["faults.f.force_N: there is no buoyancy without gravity: give fraction or volume_m3"]


def test_a_fault_with_a_fault_of_its_table_is_left_out(told) -> None:
    lines = told(a={"kind": "nothing"}, b=lighter(), c=dead(members=["x"]))
    assert [line.split(":")[0] for line in lines] == ["faults.c.members"]


# -- kinds of an extension --------------------------------------------------------------------------------------------------------------


@pytest.fixture
def made(told, monkeypatch):
    def check(parts: Any, *, count: int = 1) -> list[str]:
        monkeypatch.setattr(Made, "parts", staticmethod(parts))
        names = [f"f{k}" for k in range(count)]
        lines: list[str] = told(**{name: {"kind": "made", "target": "rov/thrusters"} for name in names})
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
