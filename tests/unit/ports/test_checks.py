"""What a sender is told: code, place and text of every refusal."""

from __future__ import annotations

import difflib
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwserver.ports import Argument, Buffer, Field, Layout, Port, Refused, Service
from uwserver.ports.checks import COMPARED, bind, checked_args, checked_command, find, suggestion

THRUSTERS = Port(
    "rov/thrusters",
    "actuator",
    "thrusters",
    (Field("u", "1", "part of full command", shape=(3,), minimum=-1.0, maximum=1.0),),
    "",
)
PUSH = Port(
    "rov/push",
    "actuator",
    "push",
    (
        Field("force_B", "N", "force", "B", (3,), minimum=-100.0),
        Field("gain", "1", "gain", maximum=2.0),
        Field("matrix", "m", "matrix", "B", (2, 3)),
    ),
    "",
)
IMU = Port("rov/imu", "sensor", "imu", (Field("f_S", "m/s^2", "f", "S", (3,)),), "")
NAN, INF = float("nan"), float("inf")


def refusal(action, *args):
    with pytest.raises(Refused) as caught:
        action(*args)
    return caught.value.fault


def test_a_good_command():
    assert checked_command(THRUSTERS, {"u": [0, 0.5, -1]}) == ((0.0, 0.5, -1.0),)
    assert all(type(number) is float for number in checked_command(THRUSTERS, {"u": (0, 1, -1)})[0])


def test_a_field_that_is_left_out_is_none():
    assert checked_command(PUSH, {"gain": 1}) == (None, (1.0,), None)


def test_nested_lists_become_row_major():
    assert checked_command(PUSH, {"matrix": [[1, 2, 3], [4, 5, 6]]}) == (None, None, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))


@pytest.mark.parametrize(
    ("port", "value", "code", "where", "text"),
    [
        (IMU, {"f_S": [0, 0, 0]}, "bad_argument", "rov/imu", 'rov/imu" is a sensor.*subscribe'),
        (THRUSTERS, [0, 0, 0], "bad_argument", "rov/thrusters", r'"value" must be a map like \{"u"'),
        (THRUSTERS, None, "bad_argument", "rov/thrusters", "must be a map"),
        (THRUSTERS, {}, "bad_argument", "rov/thrusters", "no field is given.*it takes: u$"),
        (THRUSTERS, {"U": [0, 0, 0]}, "bad_argument", "U", 'no field "U".*it takes: u$'),
        (
            PUSH,
            {"forceB": [0, 0, 0]},
            "bad_argument",
            "forceB",
            r'\(did you mean "force_B"\?\); it takes: force_B, gain, matrix$',
        ),
        (PUSH, {5: 1}, "bad_argument", "5", 'no field "5"'),
        (PUSH, {"gain": NAN, "matrx": 1}, "bad_argument", "matrx", 'no field "matrx"'),
        (THRUSTERS, {"u": [0, 0]}, "bad_shape", "u", "a list of 3, not a list of 2"),
        (THRUSTERS, {"u": [0, 0, 0, 0]}, "bad_shape", "u", "a list of 3, not a list of 4"),
        (THRUSTERS, {"u": 0.5}, "bad_shape", "u", "a list of 3, not a number"),
        (THRUSTERS, {"u": None}, "bad_shape", "u", "a list of 3, not null"),
        (THRUSTERS, {"u": "abc"}, "bad_shape", "u", "a list of 3, not a text"),
        (THRUSTERS, {"u": {"0": 1}}, "bad_shape", "u", "a list of 3, not a map"),
        (THRUSTERS, {"u": [0, [0], 0]}, "bad_shape", "u", "must be a number, not a list"),
        (THRUSTERS, {"u": [0, None, 0]}, "bad_shape", "u", "must be a number, not null"),
        (THRUSTERS, {"u": [0, "1", 0]}, "bad_shape", "u", "must be a number, not a text"),
        (THRUSTERS, {"u": [True, 0, 0]}, "bad_shape", "u", "must be a number, not a boolean"),
        (THRUSTERS, {"u": [b"1", 0, 0]}, "bad_shape", "u", "must be a number, not bytes"),
        (THRUSTERS, {"u": [1j, 0, 0]}, "bad_shape", "u", "must be a number, not a complex"),
        (THRUSTERS, {"u": [NAN, 0, 0]}, "not_finite", "u", "not a finite number"),
        (THRUSTERS, {"u": [0, 0, INF]}, "not_finite", "u", "not a finite number"),
        (THRUSTERS, {"u": [0, 0, -INF]}, "not_finite", "u", "not a finite number"),
        (THRUSTERS, {"u": [10**400, 0, 0]}, "not_finite", "u", "too large"),
        (THRUSTERS, {"u": [0, 1.5, 0]}, "out_of_range", "u", "at least -1 and at most 1, not 1.5"),
        (THRUSTERS, {"u": [0, 1.0000001, 0]}, "out_of_range", "u", "at most 1, not 1.0000001"),
        (THRUSTERS, {"u": [10**300, 0, 0]}, "out_of_range", "u", r"not 1e\+300"),
        (PUSH, {"force_B": [0, -101, 0]}, "out_of_range", "force_B", "at least -100 N, not -101"),
        (PUSH, {"gain": 3}, "out_of_range", "gain", "at most 2, not 3"),
        (PUSH, {"gain": [1]}, "bad_shape", "gain", "must be a number, not a list"),
        (PUSH, {"matrix": [1, 2, 3, 4, 5, 6]}, "bad_shape", "matrix", "a list of 2, not a list of 6"),
        (PUSH, {"matrix": [[1, 2, 3], [4, 5]]}, "bad_shape", "matrix", "a list of 3, not a list of 2"),
        (PUSH, {"matrix": [[1, 2, 3], 4]}, "bad_shape", "matrix", "a list of 3, not a number"),
        (PUSH, {"gain": 1, "force_B": [0, 0, NAN]}, "not_finite", "force_B", "not a finite number"),
    ],
)
def test_a_refused_command(port, value, code, where, text):
    fault = refusal(checked_command, port, value)
    assert (fault.code, fault.where) == (code, where)
    assert re.search(text, fault.text), fault.text


LIMITS = (-1.0, 1.0)


@pytest.mark.parametrize("number", LIMITS)
def test_limits_themselves_are_allowed(number):
    assert checked_command(THRUSTERS, {"u": [number] * 3}) == ((number,) * 3,)


json = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.binary(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5) | st.integers(), inner, max_size=3),
    max_leaves=12,
)


@given(json | st.dictionaries(st.sampled_from(["u", "force_B", "gain", "matrix", "x"]), json))
def test_whatever_comes_is_refused_or_fits(value):
    for port in (THRUSTERS, PUSH):
        try:
            checked = checked_command(port, value)
        except Refused:
            continue
        else:
            for field, part in zip(port.fields, checked, strict=True):
                assert part is None or (len(part) == field.size and all(map(math.isfinite, part)))


# -- paths ------------------------------------------------------------------------------------------------------------------------------


def test_a_known_path_is_found():
    find("port", "rov/imu", {"rov/imu": IMU})


@pytest.mark.parametrize(
    ("kind", "path", "code", "text"),
    [
        ("port", "rov/imo", "unknown_port", 'no port "rov/imo" (did you mean "rov/imu"?)'),
        ("port", "rov/sonar", "unknown_port", 'no port "rov/sonar"; there are rov/imu'),
        (
            "service",
            "rov/imo",
            "unknown_service",
            'no service "rov/imo" (did you mean "rov/imu"?)',
        ),
        ("port", "xyz", "unknown_port", 'no port "xyz"; paths begin with rov/'),
        ("port", "", "unknown_port", 'no port ""; paths begin with rov/'),
    ],
)
def test_an_unknown_path(kind, path, code, text):
    fault = refusal(find, kind, path, {"rov/imu": IMU})
    assert (fault.code, fault.where, fault.text) == (code, path, text)


def test_of_many_paths_some_are_listed():
    many = {f"rov/{k:04}": None for k in range(20)}
    told = refusal(find, "service", "rov/xyz", many).text
    assert told.endswith("rov/0010, rov/0011 and 8 more")
    assert refusal(find, "port", "a/b", {}).text == 'no port "a/b"; there are none'


def test_suggestion_of_nothing():
    assert suggestion("x", []) == ""


# -- calls ------------------------------------------------------------------------------------------------------------------------------

SERVICE = Service(
    "world/do",
    "",
    (
        Argument("count", "int", "how often", minimum=1, maximum=10),
        Argument("speed", "float", "how fast", "m/s", required=False, default=1.5, maximum=3.0),
        Argument("goal", "float", "where to", "m", required=False, shape=(3,)),
        Argument("mode", "str", "which way", required=False, default="fast", choices=("fast", "slow")),
        Argument("dry", "bool", "do nothing", required=False, default=False),
        Argument("extra", "json", "anything", required=False),
        Argument("t_ns", "int", "when", required=False),
    ),
)


def test_defaults_are_filled_in():
    assert checked_args(SERVICE, {"count": 2}) == {
        "count": 2, "speed": 1.5, "goal": None, "mode": "fast", "dry": False, "extra": None, "t_ns": None,
    }  # fmt: skip


def test_types_of_what_a_service_gets():
    args = checked_args(
        SERVICE, {"count": 3.0, "speed": 2, "goal": (1, 2, 3), "dry": True, "mode": "slow", "extra": {"a": [1]}}
    )
    assert args["count"] == 3
    assert type(args["count"]) is int
    assert type(args["speed"]) is float
    assert args["goal"] == [1.0, 2.0, 3.0]
    assert args["extra"] == {"a": [1]}
    assert args["dry"] is True


@pytest.mark.parametrize("t_ns", [2**53 + 1, 2**63 - 1, -(2**60) - 1])
def test_a_large_whole_number_stays_exact(t_ns):
    assert checked_args(SERVICE, {"count": 1, "t_ns": t_ns})["t_ns"] == t_ns


@pytest.mark.parametrize(
    ("args", "code", "where", "text"),
    [
        ([], "bad_argument", "world/do", '"args" must be a map'),
        (None, "bad_argument", "world/do", '"args" must be a map'),
        ({}, "bad_argument", "count", '"world/do" needs "count": how often'),
        ({"count": 1, "sped": 1}, "bad_argument", "sped", r'\(did you mean "speed"\?\); it takes: count, speed'),
        ({"count": 1, 7: 1}, "bad_argument", "7", 'no argument "7"'),
        ({"count": None}, "bad_shape", "count", "must be a number, not null"),
        ({"count": True}, "bad_shape", "count", "must be a number, not a boolean"),
        ({"count": "1"}, "bad_shape", "count", "must be a number, not a text"),
        ({"count": 1.5}, "bad_argument", "count", "must be a whole number, not 1.5"),
        ({"count": 0}, "out_of_range", "count", "at least 1 and at most 10, not 0"),
        ({"count": 11}, "out_of_range", "count", "at least 1 and at most 10, not 11"),
        ({"count": NAN}, "not_finite", "count", "not a finite number"),
        ({"count": INF}, "not_finite", "count", "not a finite number"),
        ({"count": 10**400}, "not_finite", "count", "too large"),
        ({"count": 1, "speed": 4}, "out_of_range", "speed", "at most 3 m/s, not 4"),
        ({"count": 1, "goal": [1, 2]}, "bad_shape", "goal", "a list of 3, not a list of 2"),
        ({"count": 1, "goal": [1, 2, [3]]}, "bad_shape", "goal", "must be a number, not a list"),
        (
            {"count": 1, "mode": "fas"},
            "bad_argument",
            "mode",
            r'one of fast, slow, not "fas" \(did you mean "fast"\?\)',
        ),
        ({"count": 1, "mode": 1}, "bad_argument", "mode", "must be a text, not a number"),
        ({"count": 1, "dry": 1}, "bad_argument", "dry", "must be true or false, not a number"),
        ({"count": 1, "dry": "true"}, "bad_argument", "dry", "must be true or false, not a text"),
    ],
)
def test_a_refused_call(args, code, where, text):
    fault = refusal(checked_args, SERVICE, args)
    assert (fault.code, fault.where) == (code, where)
    assert re.search(text, fault.text), fault.text


def test_a_service_without_arguments_says_so():
    assert refusal(checked_args, Service("world/reset", ""), {"x": 1}).text.endswith("it takes: none")


MODEM = Port(
    "rov/modem",
    "actuator",
    "modem",
    (
        Field("to", "1", "name of the receiver", type="str", max_bytes=8),
        Field("payload", "1", "what to send", type="bytes", max_bytes=16),
        Field("picture", "1", "a picture to show", type="buffer", buffer=Layout("uint8", (-1, 3)), max_bytes=12),
        Field("wave", "1", "a wave form", type="buffer", buffer=Layout("float32", (2,))),
        Field("gain", "1", "loudness"),
    ),
    "Modem.",
)
ROWS = Buffer(dtype="uint8", shape=(2, 3), data=b"abcdef")


@pytest.mark.parametrize(
    ("value", "checked"),
    [
        ({"to": "a50"}, ("a50", None, None, None, None)),
        ({"to": ""}, ("", None, None, None, None)),
        ({"to": "\u00e4\u00f6\u00fc\u00df"}, ("\u00e4\u00f6\u00fc\u00df", None, None, None, None)),
        ({"payload": b"\0\xff"}, (None, Buffer(data=b"\0\xff"), None, None, None)),
        ({"payload": {"base64": "AP8="}}, (None, Buffer(data=b"\0\xff"), None, None, None)),
        ({"payload": {"base64": ""}, "gain": 2}, (None, Buffer(data=b""), None, None, (2.0,))),
        ({"picture": ROWS}, (None, None, ROWS, None, None)),
        ({"picture": {"dtype": "uint8", "shape": [2, 3], "base64": "YWJjZGVm"}}, (None, None, ROWS, None, None)),
        ({"picture": {"dtype": "uint8", "shape": [2, 3], "data": b"abcdef"}}, (None, None, ROWS, None, None)),
        ({"picture": b"abcdef"}, (None, None, ROWS, None, None)),
        ({"picture": {"base64": "YWJjZGVm"}}, (None, None, ROWS, None, None)),
        ({"picture": np.frombuffer(b"abcdef", np.uint8).reshape(2, 3)}, (None, None, ROWS, None, None)),
    ],
)
def test_commands_of_text_bytes_and_buffers(value, checked):
    assert checked_command(MODEM, value) == checked


@pytest.mark.parametrize(
    ("value", "code", "text"),
    [
        ({"to": 3}, "bad_argument", "must be a text, not a number"),
        ({"to": b"a50"}, "bad_argument", "must be a text, not bytes"),
        ({"to": None}, "bad_argument", "must be a text, not null"),
        ({"to": "\ud800"}, "bad_argument", "half a surrogate pair"),
        ({"to": "x" * 9}, "too_large", "has 9 bytes; at most 8 are allowed"),
        ({"to": "\u00e4" * 5}, "too_large", "has 10 bytes; at most 8 are allowed"),
        ({"payload": "text"}, "bad_argument", 'must be bytes, in JSON {"base64": "..."}, not a text'),
        ({"payload": [1, 2]}, "bad_argument", "not a list"),
        ({"payload": {"base64": "A"}}, "bad_argument", "Invalid base64"),
        ({"payload": {"base64": "x" * 100_000 + "!"}}, "bad_argument", "Invalid base64"),
        ({"payload": {"x" * 100_000: 1}}, "bad_argument", "missing|unknown"),
        ({"payload": ROWS}, "bad_argument", "not a buffer"),
        ({"payload": {"dtype": "uint8", "shape": [1], "base64": "YQ=="}}, "bad_argument", "not a buffer"),
        ({"payload": bytes(17)}, "too_large", "has 17 bytes; at most 16 are allowed: send it in pieces"),
        ({"picture": 3}, "bad_argument", 'must be a buffer, in JSON {"dtype": "uint8", "shape": [...], "base64": "..."}, not'),
        ({"picture": "abc"}, "bad_argument", "not a text"),
        ({"picture": b"abcd"}, "bad_argument", "needs 3 bytes, but there are 4"),
        ({"picture": np.zeros((2, 3), np.int64)}, "bad_argument", "no buffer of int64"),
        ({"picture": Buffer(dtype="int8", shape=(2, 3), data=b"abcdef")}, "bad_shape", "must be uint8 nx3, not int8 [2, 3]"),
        ({"picture": Buffer(dtype="uint8", shape=(3, 2), data=b"abcdef")}, "bad_shape", "must be uint8 nx3, not uint8 [3, 2]"),
        ({"picture": Buffer(dtype="uint8", shape=(6,), data=b"abcdef")}, "bad_shape", "not uint8 [6]"),
        ({"picture": {"dtype": "uint8", "shape": [-1, 3], "base64": "YWJj"}}, "bad_argument", "whole numbers from 0"),
        ({"picture": {"dtype": "uint8", "shape": [2**31, 2**31], "base64": "YWJj"}}, "bad_argument", "here are 3"),
        ({"picture": bytes(15)}, "too_large", "has 15 bytes; at most 12 are allowed"),
        ({"wave": np.array([0.0, NAN], np.float32)}, "not_finite", "not a finite number"),
        ({"wave": {"dtype": "float32", "shape": [2], "base64": "AADAfwAAwH8="}}, "not_finite", "not a finite number"),
        ({"gain": b"abc"}, "bad_shape", "must be a number, not bytes"),
        ({"gain": {"base64": "YQ=="}}, "bad_shape", "must be a number, not a map"),
    ],
)  # fmt: skip
def test_refused_texts_bytes_and_buffers(value, code, text):
    fault = refusal(checked_command, MODEM, value)
    assert (fault.code, fault.where) == (code, next(iter(value)))
    assert any(part in fault.text for part in text.split("|")), fault.text
    assert len(fault.text) < 500


def test_what_a_field_holds_where_it_says_nothing():
    port = Port("a/b", "actuator", "x", (Field("t", "1", "x", type="str"), Field("b", "1", "x", type="bytes")), "X.")
    assert checked_command(port, {"t": "x" * 65536, "b": bytes(65536)}) == ("x" * 65536, Buffer(data=bytes(65536)))
    assert refusal(checked_command, port, {"t": "x" * 65537}).code == "too_large"
    assert refusal(checked_command, port, {"b": bytes(65537)}).code == "too_large"


@pytest.mark.parametrize("value", [b"x", [b"x"], {"a": {"b": [1, b"x"]}}, {b"k": 1}])
def test_no_bytes_hide_in_the_arguments_of_a_call(value):
    service = Service("world/echo", "Echo.", (Argument("value", "json", "anything"),))
    assert (
        refusal(checked_args, service, {"value": value}).text
        == '"value" must not hold bytes: send them as a text in base64'
    )
    assert checked_args(service, {"value": {"a": ["x"]}}) == {"value": {"a": ["x"]}}


def test_json_is_copied_and_has_a_form_in_json():
    """Whoever asked in the same process may change what he gave before its tick."""
    service = Service("world/echo", "Echo.", (Argument("value", "json", "anything"),))
    given = {"a": [1, {"b": None}], "nan": float("nan"), "long": 10**400}
    checked = checked_args(service, {"value": given})["value"]
    assert checked == given
    given["a"][1]["b"] = object()
    assert checked["a"][1]["b"] is None
    fault = refusal(checked_args, service, {"value": given})
    assert (fault.code, fault.where) == ("bad_argument", "value")
    assert '"value" cannot be written as JSON' in fault.text


@pytest.mark.parametrize("numbers", [np.zeros(3), np.float64(1.0), np.ones((2, 3))])
def test_arrays_of_numbers_come_from_the_same_process(numbers):
    name = {0: "gain", 1: "force_B", 2: "matrix"}[numbers.ndim]
    assert checked_command(PUSH, {name: numbers}) == checked_command(PUSH, {name: numbers.tolist()})


SONAR = (Field("range", "m", "distance"), Field("confidence", "1", "in it"), Field("gain", "dB", "of this ping"))


def test_positions_of_fields_come_in_the_order_of_the_names():
    assert bind("rov/sonar", SONAR, "gain", "range") == (2, 0)
    assert bind("rov/sonar", SONAR) == ()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("ranges", '"rov/sonar" has no field "ranges" (did you mean "range"?); it has: range, confidence, gain'),
        ("salinity", '"rov/sonar" has no field "salinity"; it has: range, confidence, gain'),
    ],
)
def test_an_unknown_field_is_not_bound(name, told):
    with pytest.raises(ValueError) as refused:
        bind("rov/sonar", SONAR, "range", name)
    assert str(refused.value) == told


def test_a_similar_name_is_looked_for_among_few(monkeypatch):
    """Letter by letter it takes 35 us for each that is compared, and a large world has thousands of services."""
    known = [
        f"rov{n:03d}/{part}/{verb}"
        for n in range(300)
        for part in ("autopilot", "imu")
        for verb in ("arm", "get", "set_mission")
    ]
    known += [f"rov{n:03d}/thrusters" for n in range(300)]
    compared = []
    close = difflib.get_close_matches
    monkeypatch.setattr(
        difflib,
        "get_close_matches",
        lambda word, names, **more: compared.append(len(names)) or close(word, names, **more),
    )
    for word, hint in {
        "rov007/autopilot/set_misson": ' (did you mean "rov007/autopilot/set_mission"?)',
        "rov007/thruster": ' (did you mean "rov007/thrusters"?)',
        "rov07/imu/get": "rov",
        "rov007/autopilt/arm": "/autopilot/arm",
        "thrusters": "/thrusters",
        "rov007/autopilot/set_mission" * 9: "",
        "qqq": "",
    }.items():
        assert hint in suggestion(word, known), word
    assert suggestion("x" * 257, ["x" * 257]) == ""
    assert max(compared) <= COMPARED
