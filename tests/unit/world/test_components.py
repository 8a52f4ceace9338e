"""Slots of actuators and streams of sensors: what is saved of them, and which numbers are kept."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec import structs
from sensing_rig import FIELDS, WORDS, Adds, Counted, stream

from uwserver.modifiers import Bias
from uwserver.ports import Port, Refused
from uwserver.world.components import NEVER, ActuatorSlot, SensorStream

PORT = Port("rov/x", "sensor", "x", FIELDS, "", 24.0)


def test_a_stream_is_made_in_python_where_one_of_its_errors_is() -> None:
    bias = Bias(field="x", value=1.0).build(stream())
    assert SensorStream(PORT, (bias,)).operations == (bias,)
    mixed = SensorStream(PORT, (bias, Adds(stream())))
    assert (mixed.operations, mixed.is_ready_made) == ((), True)


def test_what_is_no_number_is_not_kept_as_one() -> None:
    words = SensorStream(structs.replace(PORT, fields=WORDS))
    assert (words.kept, words.columns.loose) == (1, (1,))


class Lamp:
    fields, doc = FIELDS, ""

    def __init__(self) -> None:
        self.memory = Counted(3)

    def apply(self, value: Any) -> None: ...

    def neutral(self) -> None: ...


def actuator(device: Any) -> ActuatorSlot:
    return ActuatorSlot(structs.replace(PORT, direction="actuator"), device, Fraction(240), 0)


def test_an_actuator_goes_on_from_its_state_with_what_it_remembers() -> None:
    first, other = actuator(Lamp()), actuator(Lamp())
    first.source, first.last_tick, first.last_value = "me", 7, ((0.5,),)
    first.active, first.conflicts, first.timeouts, first.other_tick = False, 2, 3, 5
    first.set_timeout(120)
    first.actuator.memory = Counted(9)  # type: ignore[attr-defined]
    state = first.save()
    other.check(state)
    other.load(state)
    assert other.save() == state
    assert (other.port.timeout_s, other.actuator.memory.n) == (0.5, 9)  # type: ignore[attr-defined]


def test_who_commanded_decides_nothing() -> None:
    slot = actuator(Lamp())
    before = slot.save().deciding()
    slot.source, slot.conflicts, slot.timeouts, slot.other_tick = "me", 2, 3, 5
    assert slot.save().deciding() == before
    slot.last_tick = 1
    assert slot.save().deciding() != before
    assert slot.other_tick > NEVER


@pytest.mark.parametrize(
    ("device", "change", "text"),
    [
        (Lamp(), {"memory": b"\x81\xa1n\xff"}, ">= 0"),
        (SimpleNamespace(fields=FIELDS), {"memory": b"\x80"}, "has none"),
        (Lamp(), {"last_value": ((1.0, 2.0),)}, "must be a list of 1"),
    ],
)
def test_a_state_that_cannot_be_this_actuators_is_refused(device: Any, change: dict[str, Any], text: str) -> None:
    slot = actuator(device)
    with pytest.raises((ValueError, Refused), match=text):
        slot.check(structs.replace(slot.save(), **change))
