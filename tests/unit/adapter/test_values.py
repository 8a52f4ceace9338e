"""Long values in pieces are the bytes of the whole."""

from __future__ import annotations

import math

import msgspec
import pytest

from uwserver.adapter import SampleForm, in_pieces
from uwserver.adapter.values import LONG
from uwserver.ports import Field, Port, Sample

ENCODE = msgspec.json.Encoder().encode


@pytest.mark.parametrize(
    "shape",
    [
        (1,),
        (LONG,),
        (LONG + 1,),
        (3 * LONG,),
        (3 * LONG + 7,),
        (2, LONG + 1),
        (LONG + 1, 2),
        (LONG + 5, 1),
        (3, 2, LONG),
    ],
)
def test_pieces_join_to_the_same_json(shape):
    field = Field("image", "1", "numbers", shape=shape)
    port = Port("rov/image", "sensor", "image", (field, Field("gain", "1", "one number")), "Image.")
    numbers = tuple(math.nan if k == 1 else k / 7.0 for k in range(field.size))
    form = SampleForm(port)
    for value in (numbers, None):
        shaped = form.value(Sample("rov/image", 0, 0, 0, True, (value, 1.5)))
        assert ENCODE(in_pieces(shaped, ENCODE)) == ENCODE(shaped)
    assert form.is_long == (field.size > LONG)


def test_no_call_of_the_encoder_gets_more_than_its_share():
    sizes: list[int] = []

    def counting(value: object) -> bytes:
        sizes.append(len(value) if isinstance(value, tuple | list) else 0)
        return ENCODE(value)

    in_pieces({"image": tuple(float(k) for k in range(10 * LONG + 1))}, counting)
    assert sizes == [LONG] * 10 + [1]


FIELDS = (
    Field("depth", "m", "Depth."),
    Field("mode", "1", "Mode.", type="str"),
    Field("q", "1", "Rotation.", shape=(4,)),
    Field("covariance", "1", "Covariance.", shape=(2, 3)),
    Field("one", "1", "One row.", shape=(1, 2)),
    Field("cube", "1", "Cube.", shape=(2, 2, 2)),
)
VALUES = (1.5, "hold", (1.0, 0.0, math.nan, None), tuple(map(float, range(6))), (1.0, 2.0), tuple(range(8)))


@pytest.mark.parametrize("encode", [ENCODE, msgspec.msgpack.Encoder().encode])
@pytest.mark.parametrize("selected", [None, ("depth", "covariance")])
@pytest.mark.parametrize("name", ["depth", 'de"pth', "de pth", "class"])
def test_what_an_encoder_is_given_becomes_the_bytes_of_the_map(encode, selected, name):
    fields = (Field(name, "m", "Depth."), *FIELDS[1:])
    form = SampleForm(Port("rov/x", "sensor", "x", fields, "x"), selected)
    for values in (VALUES, (None,) * len(VALUES)):
        sample = Sample("rov/x", 0, 0, 0, True, values)
        assert encode(form.encodable(sample)) == encode(form.value(sample))


def test_a_map_is_made_only_where_it_must_be(monkeypatch):
    """The map costs twice as much."""
    form = SampleForm(Port("rov/x", "sensor", "x", FIELDS, "x"))
    monkeypatch.setattr(SampleForm, "value", None)
    assert msgspec.json.decode(ENCODE(form.encodable(Sample("rov/x", 0, 0, 0, True, VALUES))))["mode"] == "hold"


def test_another_number_of_values_than_fields_is_refused():
    form = SampleForm(Port("rov/x", "sensor", "x", FIELDS[:2], "x"))
    for values in ((1.0,), (1.0, "hold", 2.0)):
        with pytest.raises(TypeError):
            form.encodable(Sample("rov/x", 0, 0, 0, True, values))
