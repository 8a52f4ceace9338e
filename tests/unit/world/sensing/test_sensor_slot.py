"""Sensors in a world: readings with their errors, times and streams, and what is saved of them."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from msgspec import structs
from sensing_rig import (
    RATE_HZ,
    Adds,
    Counter,
    Rig,
    Speaker,
    gained,
    side,
    slot_of,
    stream,
    told,
)

from uwserver.modifiers import Bias, WhiteNoise
from uwserver.ports import Port
from uwserver.sensors import GpsConfig, Pose
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot


def test_a_sample_has_its_number_its_truth_and_its_delivery() -> None:
    slot = slot_of(latency_ns=20)
    slot.sensor.lag = 7  # type: ignore[attr-defined]
    rig = Rig(slot)
    assert told(rig, 100) == []
    assert told(rig, 103) == [("rov/x", 0, 993, 1016, (1.0,))]
    assert (slot.held, slot.held_ns, slot.number) == ((True, (2.0,)), 1023, 2)


def test_one_that_is_not_ready_counts_nothing() -> None:
    slot = slot_of()
    slot.sensor.ready = False  # type: ignore[attr-defined]
    assert told(Rig(slot)) == []
    assert (slot.number, slot.held) == (0, None)


def test_a_reading_that_is_lost_is_counted_and_not_held() -> None:
    modifier = Adds(stream())
    slot = slot_of(modifier, latency_ns=-3)
    rig = Rig(slot)
    told(rig)
    modifier.drops = True
    assert told(rig, 2) == []
    assert (slot.number, slot.held, slot.held_ns) == (2, (True, (101.0,)), 10)


def test_what_is_frozen_repeats_its_value_and_goes_on_in_time() -> None:
    slot = slot_of(latency_ns=-3)
    rig = Rig(slot)
    told(rig)
    slot.fault = "frozen"
    assert told(rig, 5) == [("rov/x", 1, 50, 50, (1.0,))]
    slot.fault = ""
    assert told(rig, 6)[0][-1] == (3.0,)


def test_a_fault_is_there_after_coming_back() -> None:
    slot = slot_of(latency_ns=-3)
    rig = Rig(slot)
    told(rig)
    slot.fault = "frozen"
    del rig.slots[slot.path]
    rig.sensors_changed()
    with pytest.raises(RuntimeError, match="in no world"):
        slot.save()
    rig.slots[slot.path] = slot
    rig.sensors_changed()
    assert told(rig, 2) == [("rov/x", 1, 20, 20, (1.0,))]


def test_a_further_stream_has_the_numbers_of_the_reading_and_errors_of_its_own() -> None:
    slot = slot_of(Adds(stream()), sides=(side("rov/x", "raw"),), latency_ns=-3)
    rig = Rig(slot)
    assert told(rig) == [("rov/x", 0, 10, 10, (101.0,)), ("rov/x/raw", 0, 10, 10, (1.0,))]
    assert [each.port.path for each in slot.streams] == ["rov/x", "rov/x/raw"]


def test_an_ideal_stream_is_that_of_the_twin_with_the_settings_of_the_device() -> None:
    twin = Counter()
    slot = slot_of(sides=(side("rov/x", "ideal", ideal=True),), twin=twin, noisy=True, latency_ns=-3)
    gained(slot, 5.0)
    noisy, ideal = told(Rig(slot))
    assert ideal[-1] == (5.0,)
    assert noisy[-1] != (5.0,)


def test_another_rate_is_known_to_all_who_need_the_time_between_readings() -> None:
    modifiers = [Adds(stream()) for _ in range(2)]
    slot = slot_of(modifiers[0], sides=(side("rov/x", "raw", modifiers[1]),), twin=Counter())
    rig = Rig(slot)
    slot.set_divisor(10**7)
    assert (RATE_HZ, slot.divisor) == (10**8, 10**7)
    assert {each.port.rate_hz for each in slot.streams} == {10.0}
    assert {part.dt for part in (slot.sensor, slot.twin, *(m.stream for m in modifiers))} == {0.1}  # type: ignore[union-attr]
    arrays = rig.sensor_arrays
    assert {arrays.heads.rows["dt"][slot.head], *arrays.streams.rows["dt"][list(slot.stream_numbers)]} == {0.1}


def noisy_slot(kind: type[Counter] = Counter) -> SensorSlot:
    errors = Adds(stream(kind.fields)), Bias(field="x", sigma=1.0).build(stream(kind.fields))
    noise = WhiteNoise(field="x", sigma=1.0).build(stream())
    return slot_of(
        *errors, kind=kind, sides=(side("rov/x", "raw", noise),) * (kind is Counter), noisy=True, latency_ns=-3
    )


@pytest.mark.parametrize("kind", [Counter, Speaker])
def test_a_sensor_goes_on_from_its_state(kind: type[Counter]) -> None:
    slots = [noisy_slot(kind) for _ in range(2)]
    (first, other), rigs = slots, [Rig(slot) for slot in slots]
    gained(first, 2.0)
    first.set_divisor(2)
    rigs[0].sensors_changed()
    told(rigs[0], 2)
    state = first.save()
    other.check(state)
    other.load(state)
    rigs[1].sensors_changed()
    assert (other.number, other.divisor, other.port.rate_hz, other.held) == (1, 2, 0.5e8, first.held)
    assert told(rigs[1], 4) == told(rigs[0], 4) != []
    first.load(state)
    assert first.save() == state, "a state must not change with the sensor that it was taken of"


def test_a_compiled_sensor_measures_with_the_settings_of_the_state_that_it_goes_on_from() -> None:
    """A receiver in the air tells how many satellites it sees: that is its setting."""
    sensor = GpsConfig(rate_hz=10, satellites=12).build(Pose((0.0, 0.0, -1.0)))
    sensor.start(1)
    port = Port("rov/gps", "sensor", "gps", sensor.fields, "", float(RATE_HZ))
    slot = SensorSlot(sensor, (SensorStream(port, ()),), 0, RATE_HZ, 1, latency_ns=-3)
    rig = Rig(slot)
    state = slot.save()
    seen = [told(rig, 1)[0][-1][7]]
    sensor.change({"satellites": 7})
    seen += [told(rig, 2)[0][-1][7]]
    slot.load(state)
    seen += [told(rig, 3)[0][-1][7]]
    assert seen == [12, 7, 12]


def test_who_goes_and_comes_back_goes_on() -> None:
    slot, other = noisy_slot(), noisy_slot()
    rig, stays = Rig(slot), Rig(other)
    told(rig)
    told(stays)
    del rig.slots[slot.path]
    rig.sensors_changed()
    rig.slots |= {"other": slot_of(path="other", divisor=3), slot.path: slot}
    rig.sensors_changed()
    assert told(rig, 2) == told(stays, 2) != []


TWO_STREAMS = struct.pack("=6q", 1, 1, 10, 1, 1, 10)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"modifiers": ()}, "other modifiers"),
        ({"held": bytes(24)}, "streams"),
        ({"held": struct.pack("=6q", 1, 1, 10, 2, 1, 10)}, "not possible"),
        ({"held": struct.pack("=6q", 1, 1, 10, 1, -1, 10)}, "not possible"),
        ({"held": struct.pack("=6q", 1, 1, 10, 1, 1, -10)}, "not possible"),
        ({"numbers": bytes(8)}, "8 bytes of readings"),
        ({"loose": (("x",),)}, "other streams"),
        ({"settings": b"\x81\xa4gain\xcb\xc0\x00\x00\x00\x00\x00\x00\x00"}, ">= 0"),
        ({"memory": b"\x81\xa1n\xff"}, ">= 0"),
        ({"modifiers": (b"\x80", b"\xff")}, "Expected"),
    ],
)
def test_a_state_that_cannot_be_this_sensors_is_refused(change: dict[str, Any], text: str) -> None:
    slot = noisy_slot()
    rig = Rig(slot)
    told(rig)
    slot.check(structs.replace(slot.save(), held=TWO_STREAMS))
    with pytest.raises(ValueError, match=text):
        slot.check(structs.replace(slot.save(), **change))


@pytest.mark.parametrize(
    ("loose", "text"), [((), "other streams"), ((("a", "b"),), "values"), (((),), "values"), (((3,),), "wrong type")]
)
def test_words_that_cannot_be_its_are_refused(loose: Any, text: str) -> None:
    slot = slot_of(kind=Speaker)
    rig = Rig(slot)
    slot.check(slot.save())
    told(rig)
    slot.check(slot.save())
    with pytest.raises(ValueError, match=text):
        slot.check(structs.replace(slot.save(), loose=loose))
