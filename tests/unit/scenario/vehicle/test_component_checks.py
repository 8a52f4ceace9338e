"""Checks of the sensors of a vehicle (rate, place on the Earth, mount, parts, errors) and of the actuators of extensions."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from msgspec import Struct
from msgspec.structs import replace

from uwserver.actuators import ActuatorTable, Body, ThrustersConfig
from uwserver.ports import Field
from uwserver.scenario.files.convert import Converter
from uwserver.scenario.vehicle.component_checks import (
    check_actuators,
    check_fields,
    check_memory,
    check_sensor,
    enabled,
)
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.world.tables import Environment, WorldTable
from uwserver.sensors import IdealSensor, Pose, Scope, SensorTable

ON_EARTH = WorldTable(origin_lat_deg=63.4, origin_lon_deg=10.4)
NOISE = {"kind": "white_noise", "field": "f_S", "sigma": 0.1}


class OddConfig(SensorTable, tag="odd", kw_only=True, frozen=True):
    """A kind of an extension, of what a test says."""

    made: ClassVar[Any] = None
    built: ClassVar[int] = 0

    def build(self, mount: Pose) -> Any:
        type(self).built += 1
        return self.made()


class Odd(IdealSensor):
    """A sensor that keeps the contract."""

    doc = "Something."
    fields = (Field("x", "1", "a number"),)

    def measure(self, scope: Scope) -> tuple[bool, list[Any]]:
        return True, [0.0]


@pytest.fixture
def told(raw_vehicle, report):
    """What is told of a sensor `s0` of the tiny vehicle, beside others."""

    def check(sensor: dict[str, Any], world: WorldTable | None = ON_EARTH, **others: Any) -> list[str]:
        raw_vehicle["sensors"] = {**raw_vehicle["sensors"], **others, "s0": {"rate_hz": 60, **sensor}}
        tree = Converter(report, {SensorTable: {"odd": OddConfig}}).tree(raw_vehicle, VehicleFile)
        report.lines.clear()  # what conversion tells has tests of its own
        check_sensor(tree, "s0", tree.values("sensors")["s0"], world, report)
        lines: list[str] = report.lines
        return lines

    return check


# -- rate, Earth, mount -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "line"),
    [(60, None), (0.5, None), (500, "500 Hz is above the physics rate of 240 Hz: use at most 240"), (50, "50 Hz does not divide the physics rate of 240 Hz: the nearest rates that do are 48 and 60")],
)  # fmt: skip
def test_a_rate_falls_on_ticks(rate: float, line: str | None, told) -> None:
    assert told({"kind": "imu", "rate_hz": rate}) == ([] if line is None else [f"sensors.s0.rate_hz: {line}"])
    assert told({"kind": "imu", "rate_hz": rate}, None) == []


@pytest.mark.parametrize(
    ("world", "line"),
    [
        (ON_EARTH, None),
        (None, None),
        (WorldTable(), "needs to know where on the Earth N lies: give origin_lat_deg and origin_lon_deg in [world]"),
        (WorldTable(origin_lat_deg=63.4), "needs to know where on the Earth N lies: give origin_lat_deg and origin_lon_deg in [world]"),
        (WorldTable(origin_lat_deg=1, origin_lon_deg=1, epoch_utc="2024-12-31T00:00:00Z"), "the magnetic model holds from 2025 to 2029, but epoch_utc in [world] is in 2024"),
        (WorldTable(origin_lat_deg=1, origin_lon_deg=1, epoch_utc="2030-01-01T00:00:00Z"), "the magnetic model holds from 2025 to 2029, but epoch_utc in [world] is in 2030"),
        (WorldTable(origin_lat_deg=1, origin_lon_deg=1, epoch_utc="once"), None),
    ],
)  # fmt: skip
def test_a_magnetometer_needs_a_place_on_the_earth(world: WorldTable | None, line: str | None, told) -> None:
    assert told({"kind": "magnetometer"}, world) == ([] if line is None else [f"sensors.s0: {line}"])


def test_an_imu_does_not(told) -> None:
    assert told({"kind": "imu"}, WorldTable()) == []


def test_a_mount_is_there(told) -> None:
    assert told({"kind": "imu", "mount": "nose"}) == []
    text = 'sensors.s0.mount: no mount "nosy" (did you mean "nose"?)'
    assert told({"kind": "imu", "mount": "nosy"}) == [text]
    assert told({"kind": "imu", "mount": "tail"}) == ['sensors.s0.mount: no mount "tail"; there are: nose']


@pytest.mark.parametrize("key", ["position_frd_m", "rpy_deg"])
def test_a_mount_or_a_place_of_its_own(key: str, told) -> None:
    text = f'the mount "nose" sets the place of this sensor: remove either mount or {key}'
    assert told({"kind": "imu", "mount": "nose", key: [0, 0, 0]}) == [f"sensors.s0.{key}: {text}"]
    assert told({"kind": "imu", key: [1, 2, 3]}) == []


# -- parts ------------------------------------------------------------------------------------------------------------------------------


def test_rpm_counts_thrusters_that_are_there(told) -> None:
    assert told({"kind": "rpm", "members": ["left"]}) == []
    text = 'sensors.s0.members[1]: no thruster "right"; there are: left'
    assert told({"kind": "rpm", "members": ["left", "right"]}) == [text]


DEPTH = {"kind": "pressure", "rate_hz": 60}


@pytest.mark.parametrize(
    ("members", "others", "lines"),
    [
        (["imu", "depth"], {"depth": DEPTH}, []),
        (["imu", "deep"], {"depth": DEPTH}, ['members[1]: no sensor "deep" (did you mean "depth"?)']),
        (["s0"], {}, ['members[0]: no sensor "s0"; there are: imu']),
        (["depth"], {"depth": {**DEPTH, "enabled": False}}, ['members[0]: no sensor "depth"; there are: imu']),
        (["all"], {"all": {"kind": "compound", "rate_hz": 60, "members": ["imu"]}}, ['members[0]: "all" is a compound sensor too: name its members instead']),
        (["imu", "imu"], {}, ['members[1]: "imu" is named twice']),
        (["depth"], {"depth": {"kind": "pressure", "rate_hz": 0}}, []),
    ],
)  # fmt: skip
def test_members_of_a_compound_sensor(members: list[str], others: dict[str, Any], lines: list[str], told) -> None:
    assert told({"kind": "compound", "members": members}, **others) == [f"sensors.s0.{line}" for line in lines]


# -- errors -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("modifier", "line"),
    [
        (NOISE, None),
        ({"kind": "bias", "field": "f_S", "value": [0.1, 0.2, 0.3]}, None),
        ({**NOISE, "field": "f"}, 'field: no field "f" to modify here, there are: f_S, w_S, temperature'),
        ({"kind": "bias", "field": "f_S", "value": [0.1, 0.2]}, '"value" needs one number or 3, one for each component of "f_S"'),
        ({"kind": "delay", "latency_s": 0.1}, None),
    ],
)  # fmt: skip
def test_errors_fit_the_fields_of_the_sensor(modifier: dict[str, Any], line: str | None, told) -> None:
    place = "sensors.s0.modifiers.m"
    expected = [] if line is None else [f"{place}.{line}" if line.startswith("field") else f"{place}: {line}"]
    assert told({"kind": "imu", "modifiers": {"m": modifier}}) == expected


def test_errors_of_further_streams_are_checked_too(told) -> None:
    streams = {"radio": {"modifiers": {"m": {**NOISE, "field": "x"}}}, "good": {"modifiers": {"m": NOISE}}}
    (line,) = told({"kind": "imu", "streams": streams})
    assert line.startswith('sensors.s0.streams.radio.modifiers.m.field: no field "x" to modify here')


@pytest.mark.parametrize("name", ["activate", "deactivate", "get", "set"])
def test_a_stream_cannot_have_the_name_of_a_service(name: str, told) -> None:
    text = f'a service of the sensor is named "{name}": choose another name for the stream'
    assert told({"kind": "imu", "streams": {name: {}}}) == [f"sensors.s0.streams.{name}: {text}"]


# -- kinds of an extension --------------------------------------------------------------------------------------------------------------


@pytest.fixture
def odd(monkeypatch, told):
    """As `told`, of a kind of an extension that builds what is given."""

    def check(made: Any, **keys: Any) -> list[str]:
        monkeypatch.setattr(OddConfig, "made", staticmethod(made))
        lines: list[str] = told({"kind": "odd", **keys})
        return lines

    return check


def test_a_good_kind_is_built_once(odd, monkeypatch) -> None:
    monkeypatch.setattr(OddConfig, "built", 0)
    assert odd(Odd, modifiers={"m": {**NOISE, "field": "x"}}, streams={"s": {}}) == []
    assert OddConfig.built == 1


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (lambda: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda: None, "TypeError: it must derive from uwserver.sensors.Sensor or IdealSensor"),
        (
            type("X", (Odd,), {"fields": ["x"]}),
            "ValueError: its fields must be a tuple of uwserver.ports.Field",
        ),
        (type("X", (Odd,), {"fields": Odd.fields * 2}), "ValueError: two of its fields have the same name"),
    ],
)
def test_a_kind_that_cannot_be_built_is_told(made: Any, reason: str, odd) -> None:
    (line,) = odd(made, modifiers={"m": NOISE})
    assert line.startswith('sensors.s0: a component of kind "odd" cannot be built (')
    assert line.endswith(reason)


@pytest.mark.parametrize("fields", [(), [Odd.fields[0]], (Odd.fields[0], "x"), None, "fields"])
def test_what_are_no_fields(fields: object) -> None:
    with pytest.raises(ValueError, match=r"must be a tuple of uwserver\.ports\.Field"):
        check_fields(fields, "")


# -- which are enabled ------------------------------------------------------------------------------------------------------------------


def test_one_error_does_not_hide_the_others(tree_of, raw_vehicle) -> None:
    raw_vehicle["rigid_body"]["mass_kg"] = "heavy"
    raw_vehicle["sensors"]["odd"] = {"kind": "imu", "rate_hz": 0}
    raw_vehicle["sensors"]["off"] = {"kind": "imu", "rate_hz": 60, "enabled": False}
    raw_vehicle["thrusters"] = 3
    tree = tree_of(raw_vehicle, VehicleFile)
    assert tree.at("rigid_body").value is None
    assert tree.at("buoyancy").value is not None
    assert list(tree.values("sensors")) == ["imu", "off"]
    assert tree.names("sensors") == ("imu", "odd", "off")
    assert enabled(tree, "sensors") == ("imu", "odd")
    assert tree.values("thrusters") == {}
    assert tree.names("thrusters") == enabled(tree, "thrusters") == ()


def test_a_component_with_errors_counts_as_enabled(tree_of, raw_vehicle) -> None:
    raw_vehicle["sensors"]["odd"] = {"kind": "imu", "rate_hz": 60, "enabled": "no"}
    raw_vehicle["sensors"]["none"] = 3
    assert enabled(tree_of(raw_vehicle, VehicleFile), "sensors") == ("imu", "odd", "none")


class Count(Struct):
    """A memory."""

    n: int = 0


class Good:
    fields = (Field("u", "1", "part of full command"),)
    doc = "Something."

    def __init__(self, body: Body) -> None:
        self.body, self.memory = body, Count()

    def apply(self, value: Any) -> None:
        self.body.push((value, 0.0, 0.0))

    def neutral(self) -> None:
        self.apply(0.0)


class OwnConfig(ActuatorTable, tag="own", kw_only=True, frozen=True):
    """Makes what a test says."""

    made: ClassVar[Any] = Good
    bodies: ClassVar[list[Body]] = []

    def build(self, body: Body) -> Any:
        self.bodies.append(body)
        return self.made(body)


@pytest.fixture
def actuator_report(tiny, motor, report, monkeypatch):
    monkeypatch.setattr(OwnConfig, "bodies", [])

    def check(made: Any = Good, **actuators: ActuatorTable) -> list[str]:
        monkeypatch.setattr(OwnConfig, "made", staticmethod(made))
        vehicle = replace(tiny, actuators={"thrusters": ThrustersConfig(), **actuators})
        check_actuators(vehicle, {"left": motor}, Environment(), report)
        lines: list[str] = report.lines
        return lines

    return check


def test_a_good_one_is_built_once_with_the_rows_of_its_vehicle(actuator_report) -> None:
    assert actuator_report(jet=OwnConfig()) == []
    (body,) = OwnConfig.bodies
    assert body.thrusters == {"left": 0}
    assert body.wrench == 1


def test_shipped_kinds_are_not_built(actuator_report) -> None:
    assert actuator_report() == []
    assert OwnConfig.bodies == []


class Listed(Good):
    fields = [Good.fields[0]]  # type: ignore[assignment]  # noqa: RUF012


class Forgetful(Good):
    def __init__(self, body: Body) -> None:
        super().__init__(body)
        self.memory = [0]  # type: ignore[assignment]


class Restless(Good):
    def neutral(self) -> None:
        raise RuntimeError("never")


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (lambda body: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda body: None, "AttributeError: 'NoneType' object has no attribute 'fields'"),
        (Listed, "ValueError: its fields must be a tuple of uwserver.ports.Field"),
        (Forgetful, "ValueError: its memory must be a msgspec Struct of plain typed values, not [0]"),
        (Restless, "RuntimeError: never"),
        (lambda body: body.thrusters["t9"], "KeyError: 't9'"),
    ],
)
def test_one_that_cannot_be_built_is_told(made: Any, reason: str, actuator_report) -> None:
    (line,) = actuator_report(made, jet=OwnConfig())
    assert line.startswith('actuators.jet: a component of kind "own" cannot be built (')
    assert line.endswith(reason)


def test_one_does_not_hide_the_other(actuator_report) -> None:
    lines = actuator_report(lambda body: 1 / 0, one=OwnConfig(), two=OwnConfig())
    assert [line.split(":")[0] for line in lines] == ["actuators.one", "actuators.two"]


class Loose(Struct):
    """Two that look alike as bytes."""

    value: Any = (1, 2)


@pytest.mark.parametrize("memory", [None, Count(), Count(n=7)])
def test_a_memory_that_can_be_saved(memory: object) -> None:
    check_memory(memory)


@pytest.mark.parametrize("memory", [[], {}, 0, "x", Loose()])
def test_a_memory_that_cannot_be_saved(memory: object) -> None:
    with pytest.raises(ValueError, match="its memory must be a msgspec Struct of plain typed values"):
        check_memory(memory)
