"""Fields by name: where they stand, and what is told of one that is not there."""

from __future__ import annotations

import pytest

from uwserver.ports import Field
from uwserver.ports.binding import bind

FIELDS = (Field("range", "m", "distance"), Field("confidence", "1", "in it"), Field("gain", "dB", "of this ping"))


def test_positions_come_in_the_order_of_the_names():
    assert bind("rov/sonar", FIELDS, "gain", "range") == (2, 0)
    assert bind("rov/sonar", FIELDS) == ()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("ranges", '"rov/sonar" has no field "ranges" (did you mean "range"?); it has: range, confidence, gain'),
        ("salinity", '"rov/sonar" has no field "salinity"; it has: range, confidence, gain'),
    ],
)
def test_an_unknown_one_is_refused(name, told):
    with pytest.raises(ValueError) as refused:
        bind("rov/sonar", FIELDS, "range", name)
    assert str(refused.value) == told
