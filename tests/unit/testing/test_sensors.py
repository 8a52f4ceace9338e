"""The sensor suite passes all shipped sensors and sees the faults it is there for."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from typing import Any, get_args

import pytest

from uwserver.ports import Buffer, Field, Layout, Value
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import CompoundConfig, IdealSensor, ModemTable, Pose, RpmConfig, Scope, SensorConfig, SensorTable
from uwserver.sensors.acoustic.bathymetry import BathymetryConfig
from uwserver.sensors.acoustic.multibeam import MultibeamConfig
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.sensors.onboard.tasks import HoldDepth
from uwserver.sensors.onboard.training import TrainingConfig
from uwserver.sensors.optical.camera.camera import CameraConfig
from uwserver.testing import check_sensor
from uwserver.testing.sensors import check_values, scopes

KINDS = [kind for kind in get_args(SensorConfig) if not issubclass(kind, ModemTable)]
"""All but modems, which tell what others send."""
SMALL: dict[type, dict[str, Any]] = {
    CameraConfig: {"width": 32, "height": 24},
    MultibeamConfig: {"beams": 32, "bins": 64, "field_deg": 60.0, "beam_width_horizontal_deg": 4.0},
    BathymetryConfig: {"beams": 32, "bins": 128, "field_deg": 100.0, "beam_width_across_deg": 4.0},
}
"""What their contract says does not depend on the size of a picture, and they are asked hundreds of times."""
DEAR = ("adcp", "bathymetry", "camera", "multibeam", "side_scan")
"""Of these by day some of the instants, of all positions, attitudes and speeds."""


def tag(kind: type[Any]) -> str:
    return str(kind.__struct_config__.tag)


@pytest.mark.parametrize("kind", KINDS, ids=tag)
def test_shipped_sensors(kind: type[Any]) -> None:
    check(kind, 7 if tag(kind) in DEAR else 1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if tag(kind) in DEAR], ids=tag)
def test_shipped_sensors_at_all_instants(kind: type[Any]) -> None:
    check(kind, 1)


def check(kind: type[Any], each: int) -> None:
    """At each so many-th instant."""
    needed = SMALL.get(kind, {})
    if kind in (RpmConfig, CompoundConfig):
        needed = {"members": ("t1",)}
    elif "beacons" in kind.__struct_fields__:
        needed = {"beacons": {"b": Beacon(position_ned_m=(10.0, 5.0, 20.0))}}
    elif kind is TrainingConfig:
        needed = {"tasks": {"down": HoldDepth(depth_m=5.0, for_s=10.0)}}
    config = kind(rate_hz=10.0, **needed)
    instants = wired() if kind in (RpmConfig, CameraConfig) else scopes()
    check_sensor(config, instants=instants[::each])


def wired() -> list[Scope]:
    """The ordinary instants, inside a vehicle of a world with light."""
    rov = VehicleEntry(model="bluerov2_heavy", sensors={"camera": CameraConfig(rate_hz=1.0, width=32, height=24)})
    world = build(load(Scenario(schema=1, vehicles={"rov": rov}), adapters={}))
    world.command("rov/thrusters", u=[0.5] * 8)
    world.step(20)
    return [replace(scope, wiring=world.sensors["rov/imu"].wiring, sight=world.sight, row=0) for scope in scopes()]


class Odd(IdealSensor):
    """A right sensor of one vector and one scalar, which the tests spoil."""

    doc = "A sensor of the test."
    fields: tuple[Field, ...] = (Field("v_S", "m/s", "velocity", "S", (3,)), Field("n", "1", "count", type="int"))

    def __init__(self, fault: str) -> None:
        self.fault = fault
        self.calls = 0
        self.list: list[Value] = []

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        self.calls += 1
        x, y, z = scope.v_NB_B
        values: list[Value] = [(x, y, z), 3]
        if self.fault == "remembers":
            values[0] = (float(self.calls), y, z)
        elif self.fault == "scope":
            scope.v_NB_B = (0.0, 1.0, z + 1.0)
        elif self.fault == "few":
            values.pop()
        elif self.fault == "shape":
            values[0] = (x, y)
        elif self.fault == "list":
            values[0] = [x, y, z]  # type: ignore[call-overload]
        elif self.fault == "type":
            values[1] = 3.0
        elif self.fault == "bool":
            values[1] = True
        elif self.fault == "nan":
            values[0] = (math.nan, y, z)
        elif self.fault == "scalar":
            values[1] = (3,)
        elif self.fault == "shared":
            self.list[:] = values
            values = self.list
        elif self.fault == "never":
            return False, [None, None]
        return True, values


class OddConfig(SensorTable, tag="odd", kw_only=True, frozen=True):
    fault: str = ""

    def build(self, mount: Pose) -> Odd:
        return Odd(self.fault)


def test_right() -> None:
    check_sensor(OddConfig(rate_hz=1.0))


@pytest.mark.parametrize(
    ("fault", "phrase"),
    [
        ("remembers", "stateless"), ("scope", "changed its scope"), ("few", "1 values for 2 fields"), ("shape", "2 components"),
        ("list", "an array is a tuple"), ("type", "declared int"), ("bool", "declared int"), ("nan", "valid reading"),
        ("scalar", "says scalar"), ("shared", "one list twice"), ("never", "valid at none"),
    ],
)  # fmt: skip
def test_faults_are_seen(fault: str, phrase: str) -> None:
    with pytest.raises(AssertionError, match=phrase):
        check_sensor(OddConfig(rate_hz=1.0, fault=fault))


@pytest.mark.parametrize(
    ("fields", "phrase"),
    [
        ((), "no fields"),
        ((Field("v_S", "m/s", "", "S", (3,)), Field("n", "1", "count", type="int")), "no doc"),
        ((Field("v_S", "", "velocity", "S", (3,)), Field("n", "1", "count", type="int")), "no unit"),
        ((Field("v_S", "m/s", "velocity", "", (3,)), Field("n", "1", "count", type="int")), "needs a frame"),
        ((Field("n", "m/s", "velocity", "S", (3,)), Field("n", "1", "count", type="int")), "one name"),
    ],
)
def test_bad_fields_are_seen(monkeypatch: pytest.MonkeyPatch, fields: tuple[Field, ...], phrase: str) -> None:
    monkeypatch.setattr(Odd, "fields", fields)
    with pytest.raises(AssertionError, match=phrase):
        check_sensor(OddConfig(rate_hz=1.0))


def test_a_config_that_builds_nothing_is_seen() -> None:
    with pytest.raises(AssertionError, match=r"build\(mount\)"):
        check_sensor(SensorTable(rate_hz=1.0))


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        (Buffer(dtype="uint8", shape=(2, 3), data=b"abcdef"), ""),
        (None, ""),
        (Buffer(dtype="uint8", shape=(3, 2), data=b"abcdef"), "declared uint8 nx3"),
        (Buffer(dtype="int8", shape=(2, 3), data=b"abcdef"), "declared uint8 nx3"),
        (Buffer(data=b"abcdef"), "declared uint8 nx3"),
        (b"abcdef", "is a bytes, declared buffer"),
        ((97.0,) * 6, "a tuple, the shape says scalar"),
    ],
)
def test_a_picture_fits_its_field(value, fault):
    field = Field("picture", "1", "what it saw", type="buffer", buffer=Layout("uint8", (-1, 3)))
    with pytest.raises(AssertionError, match=fault) if fault else contextlib.nullcontext():
        check_values("camera", (field,), [value], True)
