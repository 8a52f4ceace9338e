"""The conformance suite for actuators passes those that keep the contract, and names what the others break."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from msgspec import Struct

from uwserver.actuators import ActuatorTable, Body, ForceTorqueConfig, Given
from uwserver.ports import Field
from uwserver.testing import check_actuator

COMMANDS: list[Given] = [((0.5,),), ((1.0,),), ((0.25,),), ((0.0,),)]


class Count(Struct):
    """How often it was commanded."""

    n: int = 0


class Push:
    """Pushes, the stronger the more often it was commanded; keeps the contract."""

    doc = "A push."
    fields: tuple[Field, ...] = (Field("u", "1", "part of full command"),)

    def __init__(self, body: Body) -> None:
        self.body = body
        self.memory: Any = Count()

    def apply(self, value: Given) -> None:
        ((u,),) = value  # type: ignore[misc]
        self.memory.n += 1
        self.body.push((u * self.memory.n, 0.0, 0.0))

    def neutral(self) -> None:
        self.body.push((0.0, 0.0, 0.0))


class PushConfig(ActuatorTable, tag="push", kw_only=True, frozen=True):
    """Of the class that a test sets."""

    made: ClassVar[type[Push]] = Push

    def build(self, body: Body) -> Push:
        return self.made(body)


def told(monkeypatch: pytest.MonkeyPatch, made: type[Push]) -> str:
    monkeypatch.setattr(PushConfig, "made", made)
    with pytest.raises(AssertionError) as error:
        check_actuator(PushConfig(), COMMANDS)
    return str(error.value)


def test_good_actuators_pass() -> None:
    check_actuator(PushConfig(), COMMANDS)
    check_actuator(ForceTorqueConfig(), [((1.0, 0.0, 0.0), None), (None, (0.0, 0.1, 0.0)), ((2.0, 0.0, 0.0), None)])


def test_what_is_remembered_beside_the_memory_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    class Secret(Push):
        def apply(self, value: Given) -> None:
            self.secret = getattr(self, "secret", 0) + 1
            self.body.push((float(self.secret), 0.0, 0.0))

    assert 'actuator "push": with the rows and the memory of another run' in told(monkeypatch, Secret)


def test_a_memory_that_cannot_be_saved_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Lists(Push):
        def __init__(self, body: Body) -> None:
            super().__init__(body)
            self.memory = [0]

    assert "its memory must be a msgspec Struct of plain typed values, not [0]" in told(monkeypatch, Lists)


def test_chance_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = iter(range(100))

    class Moody(Push):
        def apply(self, value: Given) -> None:
            self.body.push((float(next(drawn)), 0.0, 0.0))

    assert "the same commands do something else" in told(monkeypatch, Moody)


def test_a_neutral_that_goes_on_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    class Restless(Push):
        def neutral(self) -> None:
            self.body.hydro.wrenches["bias"][self.body.wrench] += 1.0

    assert "neutral is not the same the second time" in told(monkeypatch, Restless)


@pytest.mark.parametrize(
    ("fields", "text"),
    [((), "has no fields"), ((Field("u", "", "part of full command"),), 'field "u": no unit')],
)
def test_its_fields_are_checked(monkeypatch: pytest.MonkeyPatch, fields: tuple[Field, ...], text: str) -> None:
    assert text in told(monkeypatch, type("Odd", (Push,), {"fields": fields}))


def test_a_table_without_build_is_told() -> None:
    with pytest.raises(AssertionError, match="needs build"):
        check_actuator(ActuatorTable(), COMMANDS)
