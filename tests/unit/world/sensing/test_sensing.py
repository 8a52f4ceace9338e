"""Which sensors measure in a tick, in which order samples are delivered, and those that are on their way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from msgspec import structs
from sensing_rig import Adds, Counter, Listener, Repeater, Rig, Shouts, Speaker, slot_of, stream

from uwserver.modifiers import Measurement
from uwserver.ports import Buffer, Field, Port, Sample, sample_batch
from uwserver.sensors import Sensor
from uwserver.world.sensing.sensing import IN_FLIGHT, InFlightSamples
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot


def slot(path: str, divisor: int = 1, late: int = 0, kind: type[Counter] = Counter) -> SensorSlot:
    """A sensor that delivers `late` ns after it has measured, and 3 more."""
    return slot_of(path=path, divisor=divisor, kind=kind, latency_ns=late - 3)


def test_each_is_due_every_divisor_ticks() -> None:
    rig = Rig(slot("a", 2), slot("b", 3))
    assert [[port for port, _ in rig.tick(n)] for n in (1, 2, 3, 6)] == [[], ["a"], ["b"], ["a", "b"]]


def test_one_that_repeats_others_reads_after_them() -> None:
    assert [port for port, _ in Rig(slot("a", 4, kind=Repeater), slot("b", 4)).tick(4)] == ["b", "a"]


def test_the_inactive_and_the_silent_do_not_measure() -> None:
    off, silent = slot("off"), slot("silent")
    off.active, silent.fault = False, "silent"
    assert Rig(off, silent).tick(1) == []
    assert (off.number, silent.number) == (0, 0)


def test_the_delayed_come_first_oldest_first_and_never_early() -> None:
    rig = Rig(slot("slow", 2, late=25), slot("now", 4))
    assert rig.tick(2) == []
    assert rig.tick(4) == [("now", 40)]
    assert rig.tick(5) == [("slow", 20)]
    assert rig.tick(8) == [("slow", 40), ("now", 80)]


def test_one_that_is_called_measures_before_those_that_are_due() -> None:
    listener = slot("ear", 100, kind=Listener)
    rig = Rig(slot("due"), listener)
    assert rig.tick(1) == [("due", 10)]
    listener.sensor.called = True  # type: ignore[attr-defined]
    assert rig.tick(2) == [("ear", 20), ("due", 20)]


def test_samples_of_what_went_are_lost() -> None:
    rig = Rig(slot("a", late=25), slot("b", late=25), slot("c", late=15, kind=Speaker))
    rig.tick(1)
    del rig.slots["a"]
    rig.sensors_changed()
    for each in rig.slots.values():
        each.active = False
    rig.sensing.schedule()
    assert rig.sensing.save().ports == ("c", "b")
    assert [(s.port, s.value) for s in rig.samples(4)] == [("c", (1.0, "reading 1")), ("b", (1.0,))]


def test_samples_on_their_way_go_on_in_their_order() -> None:
    rig, other = (Rig(slot("a", late=25), slot("b", late=15), slot("c", late=35, kind=Speaker)) for _ in range(2))
    other.tick(1)  # other numbers, other rows
    for n in (1, 2):
        rig.tick(n)
    state = rig.sensing.save()
    other.sensing.check(state)
    other.sensing.load(state)
    for each in rig.slots.values():
        kept = each.save()
        other.slots[each.path].load(kept)
    assert other.sensing.save() == state
    assert [other.samples(n) for n in (3, 4, 5)] == [rig.samples(n) for n in (3, 4, 5)]


def test_a_state_holds_nothing_of_where_others_have_been() -> None:
    """Rows that were used before, and wider ones, leave no trace in it."""
    used, fresh = Rig(slot("a", late=25)), Rig(slot("a", late=25))
    used.slots |= {"wide": slot("wide", late=25, kind=Speaker)}
    used.sensors_changed()
    used.tick(1)
    del used.slots["wide"]
    used.sensors_changed()
    start = fresh.sensing.save(), fresh.slots["a"].save()
    for rig in (used, fresh):
        rig.sensing.load(start[0])
        rig.slots["a"].load(start[1])
        rig.tick(1)
    assert used.sensing.save() == fresh.sensing.save()
    assert used.slots["a"].save() == fresh.slots["a"].save()


def way(*entry: int, ports: tuple[str, ...] = ("a",), numbers: Any = (1.0,), loose: Any = ()) -> InFlightSamples:
    entries = np.array([entry[k : k + 6] for k in range(0, len(entry), 6)]).astype(np.int64)
    return InFlightSamples(5, ports, entries.tobytes(), np.array(numbers, float).tobytes(), loose)


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (way(1, 1, 0, 0, 0, 1, ports=("none",)), "none"),
        (way(1, 9, 0, 0, 0, 1), "not possible"),
        (way(1, 1, 1, 0, 0, 1), "not possible"),
        (way(1, 1, -1, 0, 0, 1), "not possible"),
        (way(1, 1, 0, -1, 0, 1), "not possible"),
        (way(1, 1, 0, 0, 2**62 + 1, 1), "not possible"),
        (way(1, 1, 0, 0, 0, 2), "not possible"),
        (way(2, 1, 0, 0, 0, 1, 1, 2, 0, 1, 0, 1, numbers=(1.0, 2.0)), "order"),
        (way(1, 1, 0, 0, 0, 1, numbers=(1.0, 2.0)), "fields"),
        (way(1, 1, 0, 0, 0, 1, loose=(("x",),)), "fields"),
        (way(1, 1, 0, 0, 0, 1, ports=("words",)), "fields"),
        (way(1, 1, 0, 0, 0, 1, ports=("words",), loose=((3,),)), "wrong type"),
        (structs.replace(way(1, 1, 0, 0, 0, 1), entries=bytes(7)), "within a record"),
    ],
)
def test_samples_that_cannot_be_are_refused(state: InFlightSamples, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Rig(slot("a"), slot("words", kind=Speaker)).sensing.check(state)


def test_two_of_one_number_on_their_way_do_no_harm() -> None:
    """No sensor sends them, but a state from outside can hold them."""
    rig = Rig(slot("words", kind=Speaker))
    state = way(1, 1, 0, 7, 0, 1, 2, 2, 0, 7, 0, 1, ports=("words",), numbers=(1.0, 2.0), loose=(("x",), ("y",)))
    rig.sensing.check(state)
    rig.sensing.load(state)
    assert len(rig.sensing.save().loose) == 2
    assert [sample.value[0] for sample in rig.samples(1)][:2] == [1.0, 2.0]
    assert IN_FLIGHT.itemsize * 2 == len(state.entries)


# -- on demand -----------------------------------------------------------------------------------------------------------------------------


def test_nobody_is_told_what_nobody_wants() -> None:
    rig = Rig(slot("a"), slot("b", late=15))
    rig.sensing.subscribe(("b",))
    assert [rig.tick(n) for n in (1, 2, 3)] == [[], [], [("b", 10)]]
    assert rig.slots["a"].number == 3
    newest = rig.sensing.newest("a")
    assert newest is not None
    assert (newest.seq, newest.t_ns, newest.value) == (2, 30, (3.0,))


def test_words_are_there_for_who_comes_later() -> None:
    rig, all_of_it = (Rig(slot("words", late=15, kind=Speaker)) for _ in range(2))
    rig.sensing.subscribe(())
    everything = [all_of_it.samples(n) for n in range(1, 9)]
    for n in (1, 2, 3, 4):
        assert rig.samples(n) == []
        assert rig.sensing.newest("words") == next(iter(everything[n - 1]), rig.sensing.newest("words"))
    rig.sensing.subscribe(("words",))
    assert [rig.samples(n) for n in range(5, 9)] == everything[4:]
    assert len(rig.slots["words"].streams[0].coming) == len(rig.sensing.save().loose), "what was lost is not kept"


def test_the_newest_is_the_one_that_was_delivered_not_the_last_that_was_read() -> None:
    rig = Rig(slot("words", late=15, kind=Speaker))
    for n in (1, 2, 3):
        rig.tick(n)
    newest = rig.sensing.newest("words")
    assert newest is not None
    assert (newest.seq, newest.value) == (0, (1.0, "reading 1"))


def test_words_of_what_is_dropped_are_not_kept_nor_held() -> None:
    drops = Adds(stream())
    words = slot_of(drops, path="words", kind=Speaker)
    rig = Rig(words)
    rig.tick(1)
    drops.drops = True
    rig.tick(2)
    assert words.held == (True, (101.0, "reading 1"))
    assert words.streams[0].coming == {}
    words.fault, drops.drops = "frozen", False
    rig.tick(3)
    rig.samples(4)
    assert words.held == (True, (101.0, "reading 1"))


def test_of_those_that_speak_together_each_keeps_its_own_words() -> None:
    """One has two streams, one loses what it says, one is stuck, one is silent, one not ready; the ones around them are not touched."""
    drops = Adds(stream())
    shouts = SensorStream(Port("two/loud", "sensor", "x", Speaker.fields, ""), (Shouts(stream()),))
    two, lost = slot_of(path="two", kind=Speaker, sides=[shouts]), slot_of(drops, path="lost", kind=Speaker)
    rig = Rig(
        slot("first", kind=Speaker),
        two,
        lost,
        *(slot(name, kind=Speaker) for name in ("stuck", "mute", "idle", "last")),
    )
    rig.samples(1)
    drops.drops, rig.slots["stuck"].fault, rig.slots["mute"].fault = True, "frozen", "silent"
    rig.slots["idle"].sensor.ready = False  # type: ignore[attr-defined]
    rig.samples(2)
    said = {sample.port: sample.value[1] for sample in rig.samples(3)}
    assert said == {
        "first": "reading 3", "two": "reading 2", "two/loud": "READING 2", "stuck": "reading 1", "last": "reading 3",
    }  # fmt: skip


class Writer(Speaker):
    """Writes what it counts, without looking at the world."""

    writes = True

    def begin(self, number: int) -> None:
        raise AssertionError("it draws nothing")

    def sense(self, scope: Any) -> Measurement | None:
        raise AssertionError("it sees nothing")

    def write(self, row: Any) -> tuple[Any, ...]:
        self.memory.n += 1
        row[0] = 10.0 * self.memory.n
        return (f"written {self.memory.n}",)


def test_those_that_write_do_so_together_but_for_who_is_silent() -> None:
    rig = Rig(*(slot(name, divisor, kind=Writer) for name, divisor in (("a", 1), ("b", 1), ("c", 2))))
    assert [(s.port, s.value) for s in rig.samples(1)] == [("a", (10.0, "written 1")), ("b", (10.0, "written 1"))]
    rig.slots["b"].fault = "silent"
    assert [(s.port, s.seq, s.value) for s in rig.samples(2)] == [
        ("a", 1, (20.0, "written 2")), ("c", 0, (10.0, "written 1")),
    ]  # fmt: skip
    rig.slots["b"].fault = ""
    assert [(s.port, s.seq, s.value) for s in rig.samples(3)] == [
        ("a", 2, (30.0, "written 3")), ("b", 1, (20.0, "written 2")),
    ]  # fmt: skip


def test_a_modifier_in_python_may_change_words() -> None:
    rig = Rig(slot_of(Shouts(stream()), kind=Speaker, latency_ns=-3))
    assert [sample.value for sample in rig.samples(1)] == [(1.0, "READING 1")]


def test_a_kind_in_python_draws_the_same_whoever_reads() -> None:
    def values(wanted: Any) -> list[Any]:
        noisy = slot_of(path="a", noisy=True, latency_ns=-3)
        rig = Rig(noisy, slot("b"))
        rig.sensing.subscribe(wanted)
        for n in range(1, 6):
            rig.tick(n)
        assert isinstance(noisy.sensor, Sensor)
        return [rig.sensing.newest("a"), noisy.save(), rig.sensing.save()]

    assert values(None) == values(()) == values(("b",))


class Seeing(Speaker):
    """Has a picture."""

    fields = (*Counter.fields, Field("seen", "1", "a picture", type="bytes"))

    def values(self) -> list[Any]:
        return [*Counter.values(self), Buffer(data=bytes([self.memory.n]))]


def swarm(*kinds: type[Counter]) -> Rig:
    return Rig(*(slot(f"s{k}", kind=kind) for k, kind in enumerate((*kinds, *(Counter,) * 6))))


def test_many_samples_stay_rows_until_somebody_looks_at_them(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, other = swarm(Speaker), swarm(Speaker)
    expected = [sample for n in (1, 2) for sample in other.samples(n)]
    assert len(expected) == 14
    made: list[Sample] = []
    with monkeypatch.context() as patch:
        patch.setattr(sample_batch, "Sample", None)
        rig.make(1, made)
        first = rig.sensing.take_batch()
        rig.make(2, made)
        second = rig.sensing.take_batch()
    assert made == []
    assert rig.sensing.take_batch() is None
    assert first is not None
    assert second is not None
    assert [*first, *second] == expected, "the next tick writes where the first one has its rows, or its texts"


def test_a_picture_is_not_kept_by_what_was_delivered_with_it() -> None:
    rig, made = swarm(Seeing), list[Sample]()
    rig.make(1, made)
    assert (len(made), rig.sensing.take_batch()) == (7, None)


def test_texts_that_nobody_reads_are_no_samples() -> None:
    rig, other = swarm(Speaker, Counter, Speaker), swarm(Speaker, Counter, Speaker)
    paths = [path for path in rig.slots if path != "s0"]
    rig.sensing.subscribe(paths)
    for n in (1, 2):
        assert rig.samples(n) == [sample for sample in other.samples(n) if sample.port != "s0"]
    assert not rig.slots["s0"].streams[0].coming
