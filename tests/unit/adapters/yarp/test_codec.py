"""Samples as bottles, bottles as commands and calls."""

from __future__ import annotations

import math
import struct

import pytest
from uwserver_adapters.yarp import codec
from uwserver_adapters.yarp.bottle import Vocab, from_binary

from uwserver.ports import Argument, Buffer, Field, Layout, Port, Refused, Sample, Service
from uwserver.testing.fake_context import IMU, THRUSTERS

CAMERA = Port(
    "rov/camera", "sensor", "camera",
    (
        Field("image", "1", "x", type="buffer", buffer=Layout("uint8", (-1, 2))), Field("name", "1", "x", type="str"),
        Field("cov", "1", "x", shape=(2, 2)), Field("lock", "1", "x", type="bool"),
    ), "x",
)  # fmt: skip


def test_a_sample_is_pairs_that_find_finds() -> None:
    sample = Sample("rov/imu", 5, 1_250_000_000, 1_260_000_000, True, ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 10.5))
    assert codec.bottle(IMU, sample) == [
        ["f_S", [1.0, 2.0, 3.0]],
        ["w_S", [4.0, 5.0, 6.0]],
        ["temperature", 10.5],
        ["valid", 1],
    ]
    assert codec.vector(IMU, sample) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 10.5]
    assert codec.envelope(sample) == "5 1.25"


def test_time_stamps_keep_their_nanoseconds_for_days() -> None:
    sample = Sample("rov/imu", 2**31 + 3, 259_200_123_456_789, 0, True, ())
    assert codec.envelope(sample) == "3 259200.123456789"
    assert codec.clock(12_483_333_333) == [12, 483_333_333]


def test_a_sample_without_values_says_so() -> None:
    said = codec.bottle(IMU, Sample("rov/imu", 0, 0, 0, False, ((None,) * 3, (None,) * 3, None)))
    assert said[-1] == ["valid", 0]
    assert math.isnan(said[2][1])  # type: ignore[index, arg-type]


def test_pictures_tables_texts_and_truths() -> None:
    image = Buffer(dtype="uint8", shape=(1, 2), data=b"\7\x08")
    sample = Sample("rov/camera", 0, 0, 0, True, (image, "left", (1.0, 2.0, 3.0, 4.0), True))
    assert codec.bottle(CAMERA, sample) == [
        ["image", [["dtype", "uint8"], ["shape", [1, 2]], ["data", b"\7\x08"]]], ["name", "left"], ["cov", [[1.0, 2.0], [3.0, 4.0]]],
        ["lock", 1], ["valid", 1],
    ]  # fmt: skip
    assert codec.vector(CAMERA, sample) == [1.0, 2.0, 3.0, 4.0, 1.0]
    dark = codec.bottle(CAMERA, Sample("rov/camera", 0, 0, 0, False, (None, None, (None,) * 4, None)))
    assert dark[:2] == [["image", b""], ["name", ""]]


LAMP = Port("rov/lamp", "actuator", "lamp", (Field("level", "1", "x"),), "x")
TWO = Port("rov/two", "actuator", "x", (Field("a", "1", "x", shape=(3,)), Field("b", "1", "x", type="str")), "x")


def test_bottles_command() -> None:
    assert codec.command(THRUSTERS, [0.5] * 8) == {"u": [0.5] * 8}
    assert codec.command(THRUSTERS, [[0.5] * 8]) == {"u": [0.5] * 8}
    assert codec.command(THRUSTERS, [["u", [0.5] * 8]]) == {"u": [0.5] * 8}
    assert codec.command(THRUSTERS, [["u", *[0.5] * 8]]) == {"u": [0.5] * 8}
    assert codec.command(LAMP, [1]) == codec.command(LAMP, [["level", 1]]) == {"level": 1}
    assert codec.command(TWO, [["a", 1, 2, 3], ["b", "x y"]]) == {"a": [1, 2, 3], "b": "x y"}
    for port, values in ((TWO, [1, 2, 3]), (LAMP, [1, 2]), (TWO, [])):
        with pytest.raises(Refused):
            codec.command(port, values)


SERVICES = {
    "goto": Service("rov/goto", "Go.", (Argument("p", "float", "x", shape=(3,)), Argument("fast", "bool", "x", required=False))),
    "note": Service("rov/note", "Note.", (Argument("text", "str", "x"), Argument("more", "json", "x", required=False))),
}  # fmt: skip


def test_bottles_call() -> None:
    assert codec.call(["goto", ["p", [1, 2, 3]], ["fast", Vocab("1")]], SERVICES) == (
        SERVICES["goto"],
        {"p": [1, 2, 3], "fast": True},
    )
    assert codec.call([Vocab("goto"), ["p", 1, 2, 3], ["fast", Vocab("")]], SERVICES)[1] == {
        "p": [1, 2, 3],
        "fast": False,
    }
    assert codec.call(["goto", [1, 2, 3], 0], SERVICES)[1] == {"p": [1, 2, 3], "fast": False}
    assert codec.call(["note", Vocab("hi"), '{"a": [1]}'], SERVICES)[1] == {"text": "hi", "more": {"a": [1]}}
    assert codec.call(["note", "hi", "{"], SERVICES)[1] == {"text": "hi", "more": "{"}
    assert codec.call(["note"], SERVICES)[1] == {}
    for wrong in ([], [1], ["note", 1, 2, 3]):
        with pytest.raises(Refused):
            codec.call(wrong, SERVICES)
    with pytest.raises(Refused, match='did you mean "goto"'):
        codec.call(["gotoo"], SERVICES)


@pytest.mark.parametrize(
    "text",
    ["[" * 60_000, "[" + "[]," * 20_000 + "[]]", "[" + "1e300," * 10_000 + "1]", '{"a":' * 10_000, "[" * 200_000],
)
def test_a_json_text_that_would_hold_up_the_loop_is_refused(text: str) -> None:
    with pytest.raises(Refused, match="more: "):
        codec.call(["note", "hi", text], SERVICES)


def test_of_an_argument_given_again_and_again_one_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[bytes] = []
    decode = codec.decode
    monkeypatch.setattr(codec, "decode", lambda data, form: read.append(data) or decode(data, form))
    assert codec.call(["note", *[["more", f"[{k}]"] for k in range(1000)]], SERVICES)[1] == {"more": [999]}
    assert read == [b"[999]"]


def test_answers() -> None:
    assert codec.answer(None) == [Vocab("ok")]
    assert codec.answer({"a": 1, "b": [True, None, {"c": "x"}]}) == [
        Vocab("ok"),
        ["a", 1],
        ["b", [1, Vocab("null"), [["c", "x"]]]],
    ]
    assert codec.answer([1.5]) == [Vocab("ok"), [1.5]]
    deep: object = 1
    for _ in range(40):
        deep = [deep]
    assert isinstance(codec.answer(deep), list)  # type: ignore[arg-type]
    assert codec.usage(SERVICES)[1] == "goto (p float) [(fast bool)]  # Go."


@pytest.mark.parametrize(
    ("dtype", "shape", "code", "depth"),
    [("uint8", (2, 4, 3), 6449010, 3), ("uint8", (2, 4), 0x6F6E6F6D, 1), ("uint16", (2, 4), 909209453, 2)],
)
def test_pictures_of_yarp_sig(dtype, shape, code, depth) -> None:
    """The header of `ImageNetworkHeader.h`, number for number; codes of pixels as YARP's own tests have them."""
    data = bytes(k % 256 for k in range(8 * depth))
    raw = codec.image(Buffer(dtype=dtype, shape=shape, data=data))
    assert raw is not None
    assert raw[60:] == data
    numbers = struct.unpack("<10i2h4i", raw[:56] + raw[56:60])
    assert numbers[:8] == (256, 4, 9, int.from_bytes(b"mat", "little"), 9, code, 257, 5)
    assert numbers[8:] == (depth, 8 * depth, 1, 0, 4, 2, 12, 8 * depth)
    found = from_binary(raw)  # a bottle as any other
    assert found == ["mat", Vocab(code.to_bytes(4, "little").rstrip(b"\0").decode()), [depth, len(data), 1, 4, 2], data]


@pytest.mark.parametrize(
    "value",
    [
        None,
        Buffer(dtype="float32", shape=(2, 2), data=b"\0" * 16),
        Buffer(dtype="uint8", shape=(0, 4), data=b""),
        Buffer(data=b"ab"),
        Buffer(dtype="uint8", shape=(2, 4, 4), data=b"\0" * 32),
    ],
)
def test_what_is_no_picture_is_none(value: object) -> None:
    assert codec.image(value) is None
