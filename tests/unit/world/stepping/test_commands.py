"""Commands on their way to an actuator: who wins, who is told, and when silence ends in neutral."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec import structs
from sensing_rig import FIELDS, Counted

from uwserver.ports import Command, Fault, Field, Port, Refused
from uwserver.world.stepping.commands import NEVER, ActuatorSlot, Commands

PATH = "rov/lights"


class Lights:
    fields = (Field("level", "1", "brightness"),)
    doc = "Lights."

    def __init__(self) -> None:
        self.got: list[Any] = []

    def apply(self, value: tuple[Any, ...]) -> None:
        self.got.append(value[0])

    def neutral(self) -> None:
        self.got.append("neutral")


class Rig:
    """One actuator at 10 ticks a second, and what is told."""

    def __init__(self, timeout: int = 0) -> None:
        self.lights, self.told = Lights(), list[tuple[str, str]]()
        port = Port(PATH, "actuator", "lights", Lights.fields, Lights.doc, timeout_s=timeout / 10)
        self.slot = ActuatorSlot(port, self.lights, Fraction(10), timeout)
        self.slots = {PATH: self.slot}
        self.commands = Commands(self.slots, Fraction(10), lambda event, text: self.told.append((event, text)))

    def send(self, level: float, tick: int, source: str = "a") -> bool:
        return self.commands.accept(Command(PATH, ((level,),), source), tick)


def test_the_last_of_a_tick_acts_once() -> None:
    rig = Rig()
    rig.send(0.1, 0)
    rig.send(0.2, 0)
    rig.commands.apply(0)
    rig.commands.apply(1)
    assert rig.lights.got == [(0.2,)]
    assert rig.slot.last_value == ((0.2,),)


def test_actuators_are_told_in_the_order_of_their_last_commands() -> None:
    """As set points of one autopilot: position, attitude, position again is position in the end, as if each had come between two ticks."""
    rig, order = Rig(), list[str]()

    class Told(Lights):
        def __init__(self, path: str) -> None:
            super().__init__()
            self.path = path

        def apply(self, value: tuple[Any, ...]) -> None:
            order.append(self.path)

    for path in ("rov/autopilot/position", "rov/autopilot/attitude"):
        port = Port(path, "actuator", "lights", Lights.fields, Lights.doc, timeout_s=0)
        rig.slots[path] = ActuatorSlot(port, Told(path), Fraction(10), 0)
    for path in ("rov/autopilot/position", "rov/autopilot/attitude", "rov/autopilot/position"):
        rig.commands.accept(Command(path, ((0.5,),), "a"), 0)
    rig.commands.apply(0)
    assert order == ["rov/autopilot/attitude", "rov/autopilot/position"]


def test_two_sources_within_a_second_are_in_conflict_and_told_once() -> None:
    rig = Rig()
    assert not rig.send(0.1, 0, "a")
    assert rig.send(0.2, 10, "b")
    assert rig.send(0.3, 11, "a")
    assert [event for event, _ in rig.told] == ["conflict"]
    assert "a and b" in rig.told[0][1]
    assert rig.slot.conflicts == 2


def test_who_comes_after_a_second_of_silence_is_in_no_conflict() -> None:
    rig = Rig()
    rig.send(0.1, 0, "a")
    assert not rig.send(0.2, 11, "b")
    assert not rig.told
    assert rig.slot.source == "b"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda rig: rig.slots.clear(), "unknown_port"),
        (lambda rig: setattr(rig.slot, "active", False), "denied"),
        (lambda rig: setattr(rig.slot, "refusal", "is held"), "denied"),
    ],
)
def test_who_may_not_command_changes_nothing(change: Any, code: str) -> None:
    rig = Rig()
    change(rig)
    with pytest.raises(Refused) as caught:
        rig.send(0.5, 3)
    assert caught.value.fault.code == code
    rig.commands.apply(3)
    assert not rig.lights.got
    assert rig.slot.last_tick == -1


def test_an_actuator_that_went_meanwhile_gets_nothing() -> None:
    rig = Rig()
    rig.send(0.5, 0)
    del rig.slots[PATH]
    rig.commands.apply(0)
    assert not rig.lights.got


def test_the_watchdog_waits_for_its_tick_and_barks_once() -> None:
    rig = Rig(timeout=5)
    rig.send(0.5, 2)
    rig.commands.apply(2)
    assert rig.commands.next_tick == 7
    rig.send(0.6, 4)
    rig.commands.apply(4)
    rig.commands.before(7, 0)
    assert rig.lights.got == [(0.5,), (0.6,)]
    assert rig.commands.next_tick == 9
    rig.commands.before(9, 0)
    assert rig.lights.got[-1] == "neutral"
    assert rig.commands.next_tick is None
    assert (rig.slot.timeouts, [event for event, _ in rig.told]) == (1, ["watchdog"])
    rig.commands.before(20, 0)
    assert rig.slot.timeouts == 1


def test_the_newest_commands_of_a_vehicle_in_words() -> None:
    rig = Rig()
    assert rig.commands.newest("rov") == []
    rig.send(0.5, 3, "sockets:1")
    rig.commands.apply(3)
    assert rig.commands.newest("rov") == [f"last command to {PATH} in tick 3 by sockets:1: ((0.5,),)"]
    assert rig.commands.newest("ro") == []


def test_what_the_device_objects_to_is_refused_and_nothing_is_taken_over() -> None:
    class Choosy(Lights):
        def objection(self, value: tuple[Any, ...]) -> Fault | None:
            return Fault("busy", "is choosy") if value[0] == (2.0,) else None

    rig = Rig()
    rig.slot.actuator = Choosy()
    with pytest.raises(Refused, match=f'"{PATH}" is choosy') as refused:
        rig.commands.accept(Command(PATH, ((2.0,),), "one"), 5)
    assert refused.value.fault.code == "busy"
    assert rig.slot.source == ""
    rig.commands.accept(Command(PATH, ((1.0,),), "one"), 5)
    rig.commands.apply(5)
    assert rig.slot.actuator.got == [(1.0,)]


def test_a_command_is_checked_again_only_by_an_actuator_of_other_fields() -> None:
    """Whose very fields it was checked against asks no more; all others do, though theirs have the same names."""
    rig, wrong = Rig(), Command(PATH, ((0.1, 0.2),), "a")
    for fields in ((), (Field("level", "1", "another one"),)):
        with pytest.raises(Refused, match="level"):
            rig.commands.accept(wrong, 0, fields)
    rig.commands.apply(0)
    assert rig.lights.got == []
    rig.commands.accept(wrong, 0, rig.slot.port.fields)
    rig.commands.apply(0)
    assert rig.lights.got == [(0.1, 0.2)]


PORT = Port("rov/x", "sensor", "x", FIELDS, "", 24.0)


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
