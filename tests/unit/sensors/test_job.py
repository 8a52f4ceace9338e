"""Readings that are begun: finished by who reads a sensor alone."""

from __future__ import annotations

import pytest

from uwserver.modifiers import Measurement
from uwserver.ports import Field, Value
from uwserver.sensors.job import Job, PendingMeasurement, Pieces, finished, whole

FIELDS = (Field("name", "1", "", type="str"), Field("x", "m", ""), Field("image", "1", "", type="buffer"))


class Gives(Job):
    def __init__(self, *values: Value) -> None:
        self.values = values

    def run(self) -> tuple[Value, ...]:
        return self.values


def test_values_go_where_they_belong_and_the_job_is_gone() -> None:
    reading = finished(PendingMeasurement([None, 2.0, None], True, delay_ns=7, job=Gives("a", "b")), FIELDS)
    assert (reading.values, reading.valid, reading.delay_ns) == (["a", 2.0, "b"], True, 7)
    assert isinstance(reading, PendingMeasurement)
    assert reading.job.run() == ()


def test_pieces_are_done_in_their_order_with_something_between_them() -> None:
    notes: list[str] = []

    def pieces() -> Pieces[str]:
        for name in "ab":
            notes.append(name)
            yield
        return "c"

    assert whole(pieces(), lambda: notes.append("-")) == "c"
    assert notes == ["a", "-", "b", "-"]
    assert whole(Gives(1.0).pieces()) == (1.0,)


def test_a_reading_without_a_job_is_finished() -> None:
    reading = Measurement(["a", 2.0, None], True)
    assert finished(reading, FIELDS) is reading


def test_a_job_that_gives_too_few_is_a_fault() -> None:
    with pytest.raises(ValueError, match="shorter"):
        finished(PendingMeasurement([None, 2.0, None], True, job=Gives("a")), FIELDS)
