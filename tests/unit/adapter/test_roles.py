"""Which vehicle, port and field a table means; and readings of them."""

from __future__ import annotations

import math

import pytest

from uwserver.adapter import CannotServe, Readings, field_of, port_of, port_of_kind, vehicle_of, vehicles_of
from uwserver.ports import Field, Port, Sample
from uwserver.testing.fake_context import DEPTH, IMU, PORTS, WORLD, sample_of

POSE = Port("rov/truth/pose", "sensor", "truth_pose", (Field("p_NB", "m", "position", "N", (3,)),), "Pose.")
BY_PATH = {port.path: port for port in PORTS}
TWO = BY_PATH | {"auv/depth": DEPTH}


def test_the_only_vehicle_need_not_be_named():
    assert vehicles_of(TWO) == ["auv", "rov"]
    assert vehicle_of(None, BY_PATH) == "rov"
    assert vehicle_of("auv", TWO) == "auv"


@pytest.mark.parametrize(
    ("name", "ports", "text"),
    [
        (None, TWO, "say which vehicle this is: vehicle = one of auv, rov"),
        (None, {}, "say which vehicle this is: vehicle = one of none"),
        ("sub", TWO, 'no vehicle "sub"; there are: auv, rov'),
        ("rovv", TWO, 'no vehicle "rovv"; there are: auv, rov'),
    ],
)
def test_a_vehicle_that_is_none(name, ports, text):
    with pytest.raises(CannotServe) as caught:
        vehicle_of(name, ports)
    assert str(caught.value) == text


@pytest.mark.parametrize("name", ["imu", "rov/imu"])
def test_a_port_is_named_below_its_vehicle_or_whole(name):
    assert port_of("imu", name, BY_PATH, "rov", "sensor") is IMU


@pytest.mark.parametrize(
    ("name", "direction", "text"),
    [
        ("gps", "sensor", 'role: no sensor "rov/gps"; there are: rov/depth, rov/imu'),
        ("inu", "sensor", 'role: no sensor "rov/inu"; there are: rov/depth, rov/imu'),
        ("imu", "actuator", 'role: no actuator "rov/imu"; there are: rov/thrusters'),
        (
            "truth/pose",
            "sensor",
            'role: no sensor "rov/truth/pose"; set truth = true for this adapter, or name a sensor; there are: rov/depth, rov/imu',
        ),
    ],
)
def test_a_port_that_is_none(name, direction, text):
    with pytest.raises(CannotServe) as caught:
        port_of("role", name, BY_PATH, "rov", direction)
    assert str(caught.value) == text


def test_fields_by_name():
    assert field_of("role", IMU, "w_S").unit == "rad/s"
    with pytest.raises(CannotServe, match=r'role: "rov/imu" has no field "w_B", it has: f_S, w_S, temp'):
        field_of("role", IMU, "w_B")


def test_ports_by_kind():
    ports = {"rov/truth/pose": replace_kind(POSE, "imu")} | BY_PATH
    assert port_of_kind("imu", ports, "rov") is IMU
    assert port_of_kind("imu", ports, "auv") is None
    assert port_of_kind("teleport", ports, "rov") is None


def replace_kind(port: Port, kind: str) -> Port:
    return Port(port.path, port.direction, kind, port.fields, port.doc)


def test_readings_keep_the_last_good_values_or_forget_them():
    readings = Readings(BY_PATH, "rov")
    kept = readings.subscribe("imu", "imu", [("nothing",), ("w_S", "temperature")])
    forgotten = readings.subscribe("depth", "rov/depth", [("depth",)], keeps=False)
    assert (kept.path, kept.rate_hz, kept.values, kept.count) == ("rov/imu", 125.0, None, 0)
    readings.see([sample_of(IMU, 0, 7), sample_of(DEPTH, 0, 8), Sample("who/knows", 0, 0, 0, True, (1.0,))])
    assert kept.values == ((100.0, 101.0, 102.0), 200.0)
    assert (kept.t_ns, forgotten.values, forgotten.t_ns) == (7, (0.0,), 8)
    for bad in (
        sample_of(IMU, 1, 9, valid=False),
        Sample("rov/imu", 1, 9, 9, True, ((1.0, 1.0, 1.0), (1.0, math.nan, 1.0), 1.0)),
        Sample("rov/imu", 1, 9, 9, True, ((1.0, 1.0, 1.0), (1.0, None, 1.0), 1.0)),
    ):
        readings.see([bad])
        assert (kept.t_ns, kept.count) == (7, 1)
    readings.see([Sample("rov/depth", 1, 9, 9, True, (math.inf,))])
    assert forgotten.values is None


def test_readings_say_what_is_missing():
    readings = Readings(BY_PATH, "rov")
    with pytest.raises(CannotServe, match='gps: no sensor "rov/gps"'):
        readings.subscribe("gps", "gps", [("latitude",)])
    with pytest.raises(
        CannotServe, match='imu: "rov/imu" has the fields f_S, temperature, w_S; needed is a and b or c'
    ):
        readings.subscribe("imu", "imu", [("a", "b"), ("c",)])


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("2026-01-01T00:00:00Z", 1767225600),
        ("2026-01-01T00:00:00", 1767225600),
        ("2026-01-01T02:00:00+02:00", 1767225600),
    ],
)
def test_the_epoch_in_nanoseconds(text, seconds):
    facts = type(WORLD)(
        **{name: getattr(WORLD, name) for name in WORLD.__struct_fields__ if name != "epoch_utc"}, epoch_utc=text
    )
    assert facts.epoch_ns == seconds * 1_000_000_000
