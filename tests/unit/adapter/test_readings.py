"""The newest good values of some ports: which fields are read, what counts as good, what is kept after a bad sample."""

from __future__ import annotations

import math

import pytest

from uwserver.adapter import CannotServe, Readings
from uwserver.ports import Field, Port, Sample
from uwserver.testing.fake_context import DEPTH, IMU, PORTS

ALTIMETER = Port(
    "rov/altimeter", "sensor", "altimeter", (Field("altitude", "m", "height"), Field("name", "1", "of it", type="str")),
    "Altimeter.", rate_hz=10.0,
)  # fmt: skip


def readings() -> Readings:
    return Readings({port.path: port for port in (*PORTS, ALTIMETER)}, "rov")


def imu(t_ns: int, f_S: object, w_S: object, valid: bool = True) -> Sample:
    return Sample("rov/imu", 0, t_ns, t_ns + 9, valid, (f_S, w_S, 20.0))


F, W = (0.0, 0.0, -9.8), (0.1, 0.2, 0.3)


def test_fields_come_in_the_order_asked_with_the_time_at_which_they_were_true():
    of = readings()
    reading = of.subscribe("imu", "imu", [("w_S", "f_S")])
    assert (reading.path, reading.rate_hz, reading.values, reading.count) == ("rov/imu", IMU.rate_hz, None, 0)
    of.see([imu(100, F, W), Sample("rov/depth", 0, 1, 1, True, (5.0,)), Sample("nobody/knows", 0, 1, 1, True, (5.0,))])
    assert (reading.values, reading.t_ns, reading.count) == ((W, F), 100, 1)


def test_the_first_choice_that_the_port_has_is_read():
    reading = readings().subscribe("distance", "rov/altimeter", [("range",), ("altitude",)])
    reading.take(Sample("rov/altimeter", 0, 5, 5, True, (3.5, "x")))
    assert reading.values == (3.5,)


@pytest.mark.parametrize(
    "bad",
    [
        imu(200, F, W, valid=False),
        imu(200, (0.0, math.nan, 0.0), W),
        imu(200, F, (0.0, 0.0, math.inf)),
        imu(200, (1e308, 1e308, 1e308), W),
        imu(200, (None, 0.0, 0.0), W),
        imu(200, None, W),
    ],
)
@pytest.mark.parametrize("keeps", [True, False])
def test_a_bad_sample_is_no_reading(bad: Sample, keeps: bool):
    reading = readings().subscribe("imu", "imu", [("f_S", "w_S")], keeps)
    reading.take(imu(100, F, W))
    reading.take(bad)
    assert reading.values == ((F, W) if keeps else None)
    assert (reading.t_ns, reading.count) == (100, 1)
    reading.take(imu(300, F, W))
    assert (reading.values, reading.t_ns, reading.count) == ((F, W), 300, 2)


def test_a_text_is_no_number():
    reading = readings().subscribe("name", "altimeter", [("name",)])
    reading.take(Sample("rov/altimeter", 0, 5, 5, True, (3.5, "x")))
    assert reading.values is None


def test_two_readings_of_one_port_are_each_served():
    of = readings()
    first, second = of.subscribe("a", "depth", [("depth",)]), of.subscribe("b", DEPTH.path, [("depth",)])
    of.see([Sample("rov/depth", 0, 1, 1, True, (5.0,))])
    assert first.values == second.values == (5.0,)


@pytest.mark.parametrize(
    ("name", "choices", "told"),
    [
        ("imu", [("p_NB",), ("q_NB", "w_S")], 'pose: "rov/imu" has the fields f_S, temperature, w_S; needed is p_NB or q_NB and w_S'),
        ("imo", [("w_S",)], "imu"),
        ("thrusters", [("u",)], "thrusters"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused(name: str, choices: list[tuple[str, ...]], told: str):
    with pytest.raises(CannotServe) as refused:
        readings().subscribe("pose", name, choices)
    assert told in str(refused.value)
    assert str(refused.value).startswith("pose")
