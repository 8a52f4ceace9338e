"""Actuators of an extension are built once, on a body of their own, before a world needs them."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from msgspec import Struct
from msgspec.structs import replace

from uwserver.actuators import ActuatorTable, Body, ThrustersConfig
from uwserver.ports import Field
from uwserver.scenario.vehicle.actuator_checks import check_actuators, check_memory
from uwserver.scenario.water.tables import Environment


class Count(Struct):
    """A memory."""

    n: int = 0


class Good:
    fields = (Field("u", "1", "part of full command"),)
    doc = "Something."

    def __init__(self, body: Body) -> None:
        self.body, self.memory = body, Count()

    def apply(self, value: Any) -> None:
        self.body.push((value, 0.0, 0.0))

    def neutral(self) -> None:
        self.apply(0.0)


class OwnConfig(ActuatorTable, tag="own", kw_only=True, frozen=True):
    """Makes what a test says."""

    made: ClassVar[Any] = Good
    bodies: ClassVar[list[Body]] = []

    def build(self, body: Body) -> Any:
        self.bodies.append(body)
        return self.made(body)


@pytest.fixture
def told(tiny, motor, report, monkeypatch):
    monkeypatch.setattr(OwnConfig, "bodies", [])

    def check(made: Any = Good, **actuators: ActuatorTable) -> list[str]:
        monkeypatch.setattr(OwnConfig, "made", staticmethod(made))
        vehicle = replace(tiny, actuators={"thrusters": ThrustersConfig(), **actuators})
        check_actuators(vehicle, {"left": motor}, Environment(), report)
        lines: list[str] = report.lines
        return lines

    return check


def test_a_good_one_is_built_once_with_the_rows_of_its_vehicle(told) -> None:
    assert told(jet=OwnConfig()) == []
    (body,) = OwnConfig.bodies
    assert body.thrusters == {"left": 0}
    assert body.wrench == 1


def test_shipped_kinds_are_not_built(told) -> None:
    assert told() == []
    assert OwnConfig.bodies == []


class Listed(Good):
    fields = [Good.fields[0]]  # type: ignore[assignment]  # noqa: RUF012


class Forgetful(Good):
    def __init__(self, body: Body) -> None:
        super().__init__(body)
        self.memory = [0]  # type: ignore[assignment]


class Restless(Good):
    def neutral(self) -> None:
        raise RuntimeError("never")


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (lambda body: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda body: None, "AttributeError: 'NoneType' object has no attribute 'fields'"),
        (Listed, "ValueError: its fields must be a tuple of uwserver.ports.Field"),
        (Forgetful, "ValueError: its memory must be a msgspec Struct of plain typed values, not [0]"),
        (Restless, "RuntimeError: never"),
        (lambda body: body.thrusters["t9"], "KeyError: 't9'"),
    ],
)
def test_one_that_cannot_be_built_is_told(made: Any, reason: str, told) -> None:
    (line,) = told(made, jet=OwnConfig())
    assert line.startswith('actuators.jet: a component of kind "own" cannot be built (')
    assert line.endswith(reason)


def test_one_does_not_hide_the_other(told) -> None:
    lines = told(lambda body: 1 / 0, one=OwnConfig(), two=OwnConfig())
    assert [line.split(":")[0] for line in lines] == ["actuators.one", "actuators.two"]


class Loose(Struct):
    """Two that look alike as bytes."""

    value: Any = (1, 2)


@pytest.mark.parametrize("memory", [None, Count(), Count(n=7)])
def test_a_memory_that_can_be_saved(memory: object) -> None:
    check_memory(memory)


@pytest.mark.parametrize("memory", [[], {}, 0, "x", Loose()])
def test_a_memory_that_cannot_be_saved(memory: object) -> None:
    with pytest.raises(ValueError, match="its memory must be a msgspec Struct of plain typed values"):
        check_memory(memory)
