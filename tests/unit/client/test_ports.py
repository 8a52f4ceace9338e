"""Types and checks: samples as numbers, patterns, commands against the description."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from uwclient.checks import command_value
from uwclient.cli_verbs import rate
from uwclient.errors import CallRefused, ProtocolError, UwError
from uwclient.ports import Description, Port, Sample, Service, matches
from uwclient_fake_server import DEPTH, IMU, SERVICES, THRUSTERS, sample

PORTS = Description.from_wire({"ports": [IMU, DEPTH, THRUSTERS], "services": SERVICES}).ports


def test_description_is_typed() -> None:
    imu = PORTS["rov/imu"]
    assert (imu.direction, imu.kind, imu.rate_hz) == ("sensor", "imu", 125.0)
    assert imu.fields[0].shape == (3,)
    assert (imu.fields[0].unit, imu.fields[0].frame) == ("m/s^2", "S")
    thrusters = PORTS["rov/thrusters"]
    assert (thrusters.rate_hz, thrusters.timeout_s, thrusters.fields[0].maximum) == (None, 1.0, 1.0)
    step = Service.from_wire({"path": "world/step", "arguments": [{"name": "n", "type": "int", "default": 1}]})
    assert step.arguments[0].default == 1
    assert not step.arguments[0].required


def test_faults_of_a_description_name_the_key() -> None:
    with pytest.raises(ProtocolError, match='"direction"'):
        Port.from_wire({"path": "x"})
    with pytest.raises(ProtocolError, match="a list"):
        Description.from_wire({"ports": {}})


def test_a_sample_gives_its_fields() -> None:
    good = Sample.from_wire(sample("rov/imu", 2))
    assert good.time_s == pytest.approx(0.016)
    assert good.t_sent_ns == 20_000_000
    assert good["f_S"] == [0.2, 0.0, -9.81]
    assert good.number("temperature") == 12.0
    np.testing.assert_array_equal(good.array("f_S"), [0.2, 0.0, -9.81])
    hash(good)
    with pytest.raises(UwError, match=r'"f_B"; it has: f_S, temperature'):
        good["f_B"]
    with pytest.raises(UwError, match="no scalar"):
        good.number("f_S")


def test_what_was_not_measured_is_nan() -> None:
    bad = Sample.from_wire(sample("rov/imu", 1))
    assert not bad.valid
    assert bad["temperature"] is None
    assert math.isnan(bad.number("temperature"))
    assert np.isnan(bad.array("temperature"))
    holes = Sample("p", 0, 0, 0, True, {"x": [1, None, [2.5]], "s": "text"})
    assert holes.vector("x")[0::2] == (1.0, 2.5)
    assert math.isnan(holes.vector("x")[1])
    with pytest.raises(UwError, match="no number"):
        holes.vector("s")


def test_array_without_numpy_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(UwError, match=r"uwclient\[numpy\]"):
        Sample.from_wire(sample("rov/imu", 2)).array("f_S")


@pytest.mark.parametrize(
    ("pattern", "path", "expected"),
    [
        ("rov/imu", "rov/imu", True),
        ("rov/imu", "rov/imu2", False),
        ("rov/*", "rov/imu", True),
        ("rov/*", "rov/truth/pose", False),
        ("*/imu", "rov/imu", True),
        ("**", "rov/truth/pose", True),
        ("rov/**", "rov", True),
        ("**/pose", "rov/truth/pose", True),
        ("rov/**/pose", "rov/pose", True),
        ("rov/**/pose", "auv/pose", False),
    ],
)
def test_patterns(pattern: str, path: str, expected: bool) -> None:
    assert matches(pattern, path) is expected


def test_good_commands_become_plain_values() -> None:
    assert command_value(PORTS, "rov/thrusters", {"u": np.full(8, 0.5)}) == {"u": [0.5] * 8}
    assert command_value(PORTS, "rov/thrusters", {"u": (0,) * 8}) == {"u": [0] * 8}
    assert command_value(PORTS, "rov/thrusters", {"u": [np.float32(0.5)] * 8}) == {"u": [0.5] * 8}


@pytest.mark.parametrize(
    ("port", "fields", "code", "phrase"),
    [
        ("rov/thruster", {"u": [0] * 8}, "unknown_port", 'did you mean "rov/thrusters"'),
        ("rov/imu", {"u": [0] * 8}, "bad_argument", "is a sensor"),
        ("rov/thrusters", {}, "bad_argument", "u (a list of 8 float, 1)"),
        ("rov/thrusters", {"v": [0] * 8}, "bad_argument", 'no field "v"'),
        ("rov/thrusters", {"u": [0] * 7}, "bad_shape", "a list of 8 float"),
        ("rov/thrusters", {"u": 0.5}, "bad_shape", "not 0.5"),
        ("rov/thrusters", {"u": [[0]] * 8}, "bad_shape", "a list of 8 float"),
        ("rov/thrusters", {"u": [0] * 7 + [math.nan]}, "not_finite", "nan"),
        ("rov/thrusters", {"u": np.full(8, np.inf)}, "not_finite", "inf"),
        ("rov/thrusters", {"u": ["a"] * 8}, "bad_argument", "of type str"),
        ("rov/thrusters", {"u": [True] * 8}, "bad_argument", "of type bool"),
    ],
)
def test_bad_commands_are_refused_here(port: str, fields: dict[str, object], code: str, phrase: str) -> None:
    with pytest.raises(CallRefused) as caught:
        command_value(PORTS, port, fields)
    assert caught.value.code == code
    assert phrase in str(caught.value)
    assert caught.value.where


def test_rates_count_gaps_and_take_a_reset_for_none() -> None:
    seqs = [0, 1, 2, 4, 7, 0, 1]
    arrivals = [(0.1 * i, Sample("p", seq, i * 20_000_000, 0, True, {})) for i, seq in enumerate(seqs)]
    found = rate("p", arrivals)
    assert found.samples == 7
    assert found.drops == 3
    assert found.sim_hz == pytest.approx(50.0)
    assert found.wall_hz == pytest.approx(10.0)
    assert found.sim_jitter_ms == pytest.approx(0.0, abs=1e-9)
    assert rate("p", arrivals[:1]).sim_hz is None
