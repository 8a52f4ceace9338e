"""Buffers: what they refuse, how they become arrays and back, and their forms for text and binary wires."""

from __future__ import annotations

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from uwserver.ports import Command, Field, Sample
from uwserver.ports.buffer import ITEM_BYTES, Buffer, Layout, binary_form, unpacked

PICTURE = Buffer(dtype="uint8", shape=(2, 3), data=b"abcdef")
ONE = b"\0\0\x80\x3f"


@pytest.mark.parametrize("dtype", ITEM_BYTES)
def test_an_array_comes_back_the_same(dtype):
    array = np.arange(6).reshape(2, 3).astype(dtype)
    buffer = Buffer.of(array)
    assert (buffer.dtype, buffer.shape, len(buffer.data)) == (dtype, (2, 3), 6 * ITEM_BYTES[dtype])
    assert buffer.array().dtype == array.dtype
    np.testing.assert_array_equal(buffer.array(), array)


@given(
    arrays.arrays(
        st.sampled_from(list(ITEM_BYTES)), arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)
    )
)
def test_every_array_comes_back_from_both_forms(array):
    buffer = Buffer.of(array)
    text = msgspec.json.decode(msgspec.json.encode({"x": buffer}))["x"]
    binary = msgpack.unpackb(msgspec.msgpack.encode(binary_form(buffer)))
    assert unpacked(text) == unpacked(binary) == buffer
    assert buffer.array().tobytes() == array.tobytes()


def test_the_order_of_bytes_and_of_items_is_that_of_the_wire():
    array = np.array([[1, 2], [3, 4]], dtype=">u2", order="F")
    assert Buffer.of(array).data == b"\1\0\2\0\3\0\4\0"
    assert Buffer.of(array[:, 1]).data == b"\2\0\4\0"


def test_a_buffer_shares_and_never_changes():
    array = np.zeros(3, np.float32)
    buffer = Buffer.of(array)
    array[0] = 1.0
    assert buffer.array()[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        buffer.array()[0] = 1.0
    with pytest.raises(AttributeError):
        buffer.data = b""  # type: ignore[misc]
    assert buffer.array().base is not None
    assert {buffer: 1}[Buffer(dtype="float32", shape=(3,), data=bytes(12))] == 1


@pytest.mark.parametrize(
    "array",
    [np.zeros(2, bool), np.zeros(2, "U3"), np.zeros(2, complex), np.zeros(2, np.int64), np.zeros((1,) * 5, "u1")],
)
def test_arrays_that_are_no_buffers(array):
    with pytest.raises(ValueError, match=r"no buffer of|at most 4"):
        Buffer.of(array)


BAD = [
    ({}, "missing required field `base64`"),
    ({"dtype": "uint8", "base64": "AAA="}, r"shape \[\] needs 1 bytes, but there are 2"),
    ({"shape": [1], "base64": "YQ=="}, "no dtype ''"),
    ({"dtype": "uint8", "shape": [1]}, "missing required field `base64`"),
    ({"base64": 3}, "Expected `bytes`, got `int`"),
    ({"base64": "?"}, "Invalid base64"),
    ({"base64": "YQ="}, "Invalid base64"),
    ({"base64": "YWI\n"}, "Invalid base64"),
    ({"base64": "YQ==YQ=="}, "Invalid base64"),
    ({"base64": "\u00e9\u00e9\u00e9\u00e9"}, "Invalid base64"),
    ({"dtype": "uint9", "shape": [1], "base64": "YQ=="}, "uint9"),
    ({"dtype": "object", "shape": [1], "base64": "YQ=="}, "object"),
    ({"dtype": [1], "shape": [1], "base64": "YQ=="}, "Expected `str`"),
    ({"dtype": "uint8", "shape": [-1], "base64": "YQ=="}, "from 0 to 4294967295"),
    ({"dtype": "uint8", "shape": [1 << 32], "base64": "YQ=="}, "from 0 to 4294967295"),
    ({"dtype": "uint8", "shape": [10**300], "base64": "YQ=="}, "from 0 to 4294967295"),
    ({"dtype": "uint8", "shape": [2**31] * 4, "base64": "YQ=="}, "here are 1"),
    ({"dtype": "uint8", "shape": [1] * 5, "base64": "YQ=="}, "at most 4"),
    ({"dtype": "uint8", "shape": [1] * 100_000, "base64": "YQ=="}, "at most 4"),
    ({"dtype": "uint8", "shape": [True], "base64": "YQ=="}, "Expected `int`, got `bool`"),
    ({"dtype": "uint8", "shape": [1.0], "base64": "YQ=="}, "Expected `int`, got `float`"),
    ({"dtype": "uint8", "shape": [float("nan")], "base64": "YQ=="}, "Expected `int`, got `float`"),
    ({"dtype": "uint8", "shape": 1, "base64": "YQ=="}, "Expected `array`"),
    ({"dtype": "uint8", "shape": [2], "base64": "YQ=="}, r"shape \[2\] needs 2 bytes, but there are 1"),
    ({"dtype": "float32", "shape": [], "base64": "YQ=="}, "needs 4 bytes, but there are 1"),
    ({"dtype": "uint8", "shape": [1], "base64": "YQ==", "order": "C"}, "unknown field `order`"),
    ({"dtype": "uint8", "shape": [1], "data": "YQ=="}, "unknown field `data`|missing"),
    ({"dtype": "uint8", "shape": [1], "data": b"a", "base64": "YQ=="}, "unknown field `data`"),
    ({"data": 5}, "unknown field|missing"),
    ({1: 2}, "Expected `str`"),
    ({b"base64": "YQ=="}, "Expected `str`"),
]  # fmt: skip


@pytest.mark.parametrize(("packed", "text"), BAD)
def test_what_is_no_buffer_says_why(packed, text):
    with pytest.raises(ValueError, match=text):
        unpacked(packed)


@pytest.mark.parametrize(
    ("dtype", "shape", "data"),
    [("uint9", (1,), b"a"), ("uint8", (-1,), b"a"), ("uint8", (1.0,), b"a"), ("uint8", (2,), b"a")],
)
def test_made_by_hand_it_is_checked_too(dtype, shape, data):
    with pytest.raises(ValueError, match=r"dtype|whole numbers|bytes"):
        Buffer(dtype=dtype, shape=shape, data=data)


def test_only_bytes_are_data():
    with pytest.raises(TypeError, match="not bytearray"):
        Buffer(dtype="uint8", shape=(1,), data=bytearray(b"a"))  # type: ignore[arg-type]


def test_the_forms_to_the_byte():
    plain = Buffer(data=b"hi")
    assert msgspec.json.encode(PICTURE) == b'{"dtype":"uint8","shape":[2,3],"base64":"YWJjZGVm"}'
    assert msgspec.json.encode(plain) == b'{"base64":"aGk="}'
    assert msgspec.json.encode(Buffer(data=b"")) == b'{"base64":""}'
    assert msgpack.unpackb(msgspec.msgpack.encode(binary_form(PICTURE))) == {"dtype": "uint8", "shape": [2, 3], "data": b"abcdef"}  # fmt: skip
    assert binary_form(plain) == b"hi"
    for other in (1.5, "text", None, (1.0, None), [1]):
        assert binary_form(other) is other
    assert unpacked({"base64": "aGk="}) == unpacked({"data": b"hi"}) == plain
    assert plain.array().tolist() == [104, 105]


@pytest.mark.parametrize("type_", [Sample, Command])
def test_samples_and_commands_can_be_written_and_read_back(type_):
    value = ("text", PICTURE, Buffer(data=b"hi"), None, (1.0, 2.0))
    whole = Sample("a/b", 1, 2, 3, True, value) if type_ is Sample else Command("a/b", value, "me")
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(whole), type=type_) == whole
    assert msgspec.json.decode(msgspec.json.encode(whole), type=type_) == whole


@pytest.mark.parametrize(
    ("layout", "data", "shape"),
    [
        (Layout("uint8", (-1,)), b"abc", (3,)),
        (Layout("uint8", (-1, 3)), b"abcdef", (2, 3)),
        (Layout("float32", (1, -1)), ONE * 5, (1, 5)),
        (Layout("uint8", (-1, 3)), b"", (0, 3)),
        (Layout("uint8", (2, 3)), b"abcdef", (2, 3)),
        (Layout("float32", ()), ONE, ()),
    ],
)
def test_a_shape_that_follows_from_the_number_of_bytes(layout, data, shape):
    assert layout.shaped(data).shape == shape
    assert layout.fits(layout.shaped(data))


@pytest.mark.parametrize(
    ("layout", "data"),
    [
        (Layout("uint8", (-1, -1)), b"abcd"),
        (Layout("uint8", (-1, 0)), b""),
        (Layout("uint8", (-1, 3)), b"abcd"),
        (Layout("float32", (-1,)), b"abcde"),
        (Layout("uint8", (2, 3)), b"abcde"),
    ],
)
def test_a_shape_that_does_not(layout, data):
    with pytest.raises(ValueError, match="bytes"):
        layout.shaped(data)


def test_layouts_as_people_read_them():
    assert [str(Layout("uint8", shape)) for shape in ((-1, 512), (3,), ())] == [
        "uint8 nx512",
        "uint8 3",
        "uint8 scalar",
    ]


def test_a_repr_is_short_and_tells_other_bytes_apart():
    big = Buffer(dtype="uint8", shape=(1 << 20,), data=bytes(1 << 20))
    assert len(repr(big)) < 80
    assert repr(big) != repr(Buffer(dtype="uint8", shape=(1 << 20,), data=bytes((1 << 20) - 1) + b"\1"))


def test_what_is_finite():
    assert Buffer(dtype="uint8", shape=(1,), data=b"\xff").is_finite()
    assert Buffer(dtype="float32", shape=(1,), data=ONE).is_finite()
    assert not Buffer.of(np.array([0.0, np.nan], np.float32)).is_finite()
    assert not Buffer.of(np.array([[np.inf]])).is_finite()


def test_what_a_field_holds():
    picture = Field("picture", "1", "x", type="buffer", buffer=Layout("uint8", (-1, 3)))
    payload = Field("payload", "1", "x", type="bytes")
    assert picture.holds(PICTURE)
    assert payload.holds(Buffer(data=b"ab"))
    assert not payload.holds(PICTURE)
    assert not picture.holds(Buffer(data=b"abcdef"))
    for dtype, shape in (("uint8", (3, 2)), ("uint8", (6,)), ("int8", (2, 3)), ("uint8", (1, 2, 3))):
        assert not picture.holds(Buffer(dtype=dtype, shape=shape, data=b"abcdef"))
    assert not Field("u", "1", "x").holds(Buffer(data=b""))
    assert [field.form for field in (picture, payload, Field("u", "1", "x", shape=(2, 3)), Field("v", "1", "x"))] == [
        "uint8 nx3", "bytes", "2x3", "scalar",
    ]  # fmt: skip
