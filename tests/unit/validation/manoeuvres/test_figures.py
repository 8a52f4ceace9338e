"""Tables of figures, and how they are read from a series."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.validation.manoeuvres.figures import Column, Row, Trial, ahead, first_time, steady_mean, turn_told

TRIAL = Trial(
    "turn",
    "Turn",
    "",
    (Column("a", "a", "m"), Column("b", "b", "s")),
    (Row("one", (1.0, None)), Row("two", (3.0, 4.0))),
)


@pytest.mark.parametrize(
    ("condition", "key", "value"), [("one", "a", 1.0), ("two", "b", 4.0), ("one", "b", None), ("three", "a", None), ("one", "c", None)]
)  # fmt: skip
def test_a_figure_is_found_by_condition_and_key(condition: str, key: str, value: float | None) -> None:
    assert TRIAL.value(condition, key) == value


def test_what_still_changes_has_no_steady_value() -> None:
    assert steady_mean(np.full(10, 2.0)) == 2.0
    assert steady_mean(np.linspace(1.0, 2.0, 10)) is None


def test_the_first_time_of_something() -> None:
    t = np.arange(5.0)
    assert first_time(t, t > 2.5) == 3.0
    assert first_time(t, t > 9.0) is None


def test_runs_are_called_by_what_is_asked() -> None:
    assert (ahead(0.3), ahead(-1.0)) == ("ahead 30 %", "astern 100 %")
    assert turn_told(0.55, math.radians(12.5)) == "ahead 55 %, rudder 12.5 degrees"
