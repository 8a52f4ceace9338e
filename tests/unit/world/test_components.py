"""Slots of sensors and actuators: readings with their errors, times and streams, and what is saved of them."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
import pytest
from msgspec import Meta, structs

import uwserver
from uwserver.modifiers import Measurement, Modifier, Stream
from uwserver.modifiers.base import Memory
from uwserver.ports import Argument, Field, Port, Refused
from uwserver.sensors import Sensor
from uwserver.sensors.base import Settings
from uwserver.world.components import NEVER, ActuatorSlot, Member, SensorSlot, SideStream

FIELDS = (Field("x", "m", "a number"),)
PORT = Port("rov/x", "sensor", "x", FIELDS, "", 24.0)


class Gain(Settings, frozen=True):
    gain: Annotated[float, Meta(ge=0, le=10)] = 1.0


class Counted(Memory):
    n: Annotated[int, Meta(ge=0)] = 0


class Counter(Sensor):
    """Counts its readings; each is `lag` ns old, and none while `ready` is False."""

    fields = FIELDS
    arguments = (Argument("gain", "float", ""),)
    settings: Any = Gain()
    memory: Any
    ready, lag = True, 0
    noisy = True

    def turn_on(self) -> Memory:
        return Counted()

    def sense(self, scope: Any) -> Measurement | None:
        if not self.ready:
            return None
        self.memory.n += 1
        noise = self.rng.standard_normal() if self.noisy else 0.0
        return Measurement([self.settings.gain * self.memory.n + noise], True, delay_ns=3, since_ns=self.lag)


class Adds(Modifier):
    """Adds 100, and drops what is asked for."""

    drops = False

    def apply(self, reading: Measurement) -> None:
        reading.values[0] += 100.0  # type: ignore[operator]
        reading.dropped = self.drops


def slot_of(*modifiers: Modifier, seed: int = 1, **more: Any) -> SensorSlot:
    sensor = Counter()
    sensor.start(np.random.default_rng(seed))
    sensor.noisy = more.pop("noisy", False)
    return SensorSlot(PORT, 0, sensor, modifiers, Fraction(240), 10, more.pop("latency_ns", 0), **more)


def stream() -> Stream:
    return Stream(FIELDS, 0.1, np.random.default_rng(2))


def scope(t_ns: int = 1000) -> Any:
    return SimpleNamespace(t_ns=t_ns, wiring=None)


def told(slot: SensorSlot, t_ns: int = 1000) -> list[tuple[Any, ...]]:
    return [(s.port, s.seq, s.t_ns, s.t_sent_ns, s.value) for s in slot.samples(scope(t_ns))]


def test_a_sample_has_its_number_its_truth_and_its_delivery() -> None:
    slot = slot_of(latency_ns=20)
    slot.sensor.lag = 100  # type: ignore[attr-defined]
    assert told(slot) == [("rov/x", 0, 900, 923, (1.0,))]
    assert told(slot, 2000) == [("rov/x", 1, 1900, 1923, (2.0,))]
    assert (slot.held, slot.held_ns) == ((True, (2.0,)), 1900)


def test_one_that_is_not_ready_counts_nothing() -> None:
    slot = slot_of()
    slot.sensor.ready = False  # type: ignore[attr-defined]
    assert told(slot) == []
    assert (slot.seq, slot.held) == (0, None)


def test_a_reading_that_is_lost_is_counted_and_not_held() -> None:
    modifier = Adds(stream())
    slot = slot_of(modifier)
    told(slot)
    modifier.drops = True
    assert told(slot) == []
    assert (slot.seq, slot.held) == (2, (True, (101.0,)))


def test_what_is_frozen_repeats_its_value_and_goes_on_in_time() -> None:
    slot = slot_of()
    told(slot)
    slot.fault = "frozen"
    assert told(slot, 5000) == [("rov/x", 1, 5000, 5003, (1.0,))]
    slot.fault = ""
    assert told(slot, 6000)[0][-1] == (3.0,)


def test_a_further_stream_has_the_numbers_of_the_reading_and_errors_of_its_own() -> None:
    side = SideStream(structs.replace(PORT, path="rov/x/raw"), False, ())
    slot = slot_of(Adds(stream()), sides=(side,))
    assert told(slot) == [("rov/x", 0, 1000, 1003, (101.0,)), ("rov/x/raw", 0, 1000, 1003, (1.0,))]
    assert [each.port.path for each in slot.streams()] == ["rov/x", "rov/x/raw"]


def test_an_ideal_stream_is_that_of_the_twin_with_the_settings_of_the_device() -> None:
    twin = Counter()
    twin.noisy, side = False, SideStream(structs.replace(PORT, path="rov/x/ideal"), True, ())
    slot = slot_of(sides=(side,), twin=twin, noisy=True)
    slot.sensor.settings = Gain(5.0)
    noisy, ideal = told(slot)
    assert ideal[-1] == (5.0,)
    assert noisy[-1] != (5.0,)


def test_another_rate_is_known_to_all_who_need_the_time_between_readings() -> None:
    modifiers = [Adds(stream()) for _ in range(2)]
    side = SideStream(structs.replace(PORT, path="rov/x/raw"), False, (modifiers[1],))
    slot = slot_of(modifiers[0], sides=(side,), twin=Counter())
    slot.set_divisor(24)
    assert slot.divisor == 24
    assert {slot.port.rate_hz, side.port.rate_hz} == {10.0}
    assert {part.dt for part in (slot.sensor, slot.twin, *(m.stream for m in modifiers))} == {0.1}  # type: ignore[union-attr]


def test_a_sensor_goes_on_from_its_state() -> None:
    slots = [slot_of(Adds(stream()), seed=seed, noisy=True) for seed in (1, 1)]
    first, other = slots
    first.sensor.settings = Gain(2.0)
    first.set_divisor(24)
    told(first)
    state = first.save()
    other.check(state)
    other.load(state)
    assert (other.seq, other.divisor, other.port.rate_hz, other.held) == (1, 24, 10.0, first.held)
    assert told(other, 9000) == told(first, 9000)
    first.load(state)
    assert first.save() == state, "a state must not change with the sensor that it was taken of"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"records": ()}, "other modifiers"),
        ({"draws": ()}, "other modifiers"),
        ({"draws": (bytes(16), b"")}, "random stream"),
        ({"sides": (None,)}, "streams"),
        ({"held": (True, (1.0, 2.0))}, "2 values for 1 fields"),
        ({"held": (True, ("x",))}, "another type"),
        ({"records": (b"\x81\xa4gain\xcb\xc0\x00\x00\x00\x00\x00\x00\x00", b"\x80")}, ">= 0"),
        ({"records": (b"\x80", b"\x81\xa1n\xff")}, ">= 0"),
    ],
)
def test_a_state_that_cannot_be_this_sensors_is_refused(change: dict[str, Any], text: str) -> None:
    slot = slot_of(Adds(stream()))
    with pytest.raises(ValueError, match=text):
        slot.check(structs.replace(slot.save(), **change))


def test_whoever_says_that_it_draws_nothing_draws_nothing() -> None:
    """Its random stream is not saved."""
    world = uwserver.load("one_of_everything")
    quiet = [
        (slot.path, owner.rng)
        for slot in world.sensors.values()
        for owner in (slot.sensor, *(m.stream for each in slot.streams() for m in each.modifiers if not m.draws))
        if not getattr(owner, "draws", False)
    ]
    before = [rng.bit_generator.state for _, rng in quiet]
    world.step(480)
    moved = [path for (path, rng), state in zip(quiet, before, strict=True) if rng.bit_generator.state != state]
    assert len(quiet) > 5
    assert not moved


# -- actuators -----------------------------------------------------------------------------------------------------------------------------


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


def test_the_parts_of_a_member_are_all_that_comes_and_goes_with_it() -> None:
    sensor, lamp, pilot = slot_of(), actuator(Lamp()), slot_of()
    member = Member(SimpleNamespace(name="rov"), (sensor,), (lamp,), others=(pilot,))  # type: ignore[arg-type]
    assert member.parts == (sensor, lamp, pilot)
