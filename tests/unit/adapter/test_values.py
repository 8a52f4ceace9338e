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
