"""A reading as a row of numbers comes back as it was, of whatever types its fields are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.modifiers.columns import WIDEST, Columns, columns_of
from uwserver.ports import Buffer, Field, Layout

FIELDS = (
    Field("depth", "m", "a scalar"),
    Field("v_S", "m/s", "a vector", "S", (3,)),
    Field("name", "1", "a text", type="str"),
    Field("ok", "1", "a flag", type="bool"),
    Field("locks", "1", "flags", shape=(2,), type="bool"),
    Field("time", "ns", "a whole number", type="int"),
    Field("counts", "1", "whole numbers", shape=(3,), type="int"),
    Field("picture", "1", "too many of them", shape=(WIDEST + 1,), type="int"),
    Field("image", "1", "a buffer", type="buffer", buffer=Layout("uint8", (-1,))),
)
IMAGE = Buffer(dtype="uint8", shape=(2,), data=b"ab")
PICTURE = tuple(range(WIDEST + 1))
FULL = (1.5, (0.1, -0.2, 0.3), "n", True, (False, True), 7, (1, 2, 3), PICTURE, IMAGE)
EMPTY = (None, (None,) * 3, None, None, (None,) * 2, None, (None,) * 3, None, None)


def there_and_back(fields, values):
    columns = Columns(fields)
    row = np.full(columns.width, 99.0)
    columns.pack(values, row)
    return columns.unpack(row, [values[k] for k in columns.loose])


def kinds(values):
    return [[type(part) for part in value] if isinstance(value, tuple) else type(value) for value in values]


def test_each_component_of_a_number_has_a_place_and_the_rest_is_loose():
    columns = Columns(FIELDS)
    assert columns.first == (0, 1, -1, 4, 5, 7, 8, -1, -1)
    assert columns.width == 11
    assert columns.loose == (2, 7, 8)


@pytest.mark.parametrize("values", [FULL, EMPTY], ids=["full", "empty"])
def test_a_reading_comes_back_with_its_types(values):
    back = there_and_back(FIELDS, values)
    assert back == values
    assert kinds(back) == kinds(values)


def test_whole_numbers_that_are_no_floats_come_back():
    fields = (Field("x", "m", "a number"), Field("times", "ns", "whole numbers", shape=(3,), type="int"))
    for times in ((2**62 + 1, -(2**62) - 1, 2**63 - 1), (None, -1, 2**53 + 1)):
        assert there_and_back(fields, (0.5, times)) == (0.5, times)


def test_parts_of_a_vector_may_be_missing():
    fields = (Field("ranges", "m", "of beams", shape=(3,)), Field("n", "1", "a number", type="int"))
    assert there_and_back(fields, ((1.0, None, 3.0), 4)) == ((1.0, None, 3.0), 4)


def test_a_missing_vector_is_one_of_missing_components():
    assert there_and_back((Field("v_S", "m/s", "a vector", "S", (3,)),), (None,)) == ((None,) * 3,)


@pytest.mark.parametrize(
    "number", [0, -1, 1 << 53, (1 << 53) + 1, (1 << 63) - 1, 1 - (1 << 63), 0x7FF8 << 48, -(1 << 51)]
)
def test_whole_numbers_keep_all_their_bits(number):
    """Also those whose bits are a NaN as a float."""
    fields = (Field("time", "ns", "a whole number", type="int"), Field("depth", "m", "a scalar"))
    assert there_and_back(fields, (number, 1.0)) == (number, 1.0)
    assert there_and_back(fields, (number, None)) == (number, None)


@pytest.mark.parametrize("number", [0.0, -0.0, math.inf, -math.inf, 5e-324, 0.1])
def test_floats_keep_all_their_bits(number):
    (back,) = there_and_back((Field("depth", "m", "a scalar"),), (number,))
    assert math.copysign(1.0, back) == math.copysign(1.0, number)
    assert back == number


def test_what_has_no_floats_at_all_needs_no_row():
    assert Columns((FIELDS[2],)).width == 0
    assert there_and_back((FIELDS[2],), ("text",)) == ("text",)


def test_sensors_of_equal_fields_have_the_same_columns():
    again = tuple(Field(f.name, f.unit, f.doc, f.frame, f.shape, f.type) for f in FIELDS[:4])
    assert columns_of(again) is columns_of(FIELDS[:4])
