"""Which sensors measure in a tick, in which order samples are delivered, and those that are on their way."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from uwserver.ports import Field, Port, Sample
from uwserver.world.sensing import OnTheirWay, Sensing

FIELDS = (Field("x", "m", "a number"),)


class Slot:
    """A sensor that reads the time in ticks, and delivers it `late` ns later."""

    def __init__(
        self, path: str, divisor: int = 1, late: int = 0, repeats: bool = False, listens: bool = False
    ) -> None:
        self.port = Port(path, "sensor", "x", FIELDS, "")
        self.divisor, self.late, self.active, self.fault = divisor, late, True, ""
        self.sensor = SimpleNamespace(repeats=repeats, listens=listens, needs_rates=False)
        self.called, self.seq = False, 0

    def is_called(self, now: float) -> bool:
        return self.called

    def streams(self) -> list[Any]:
        return [self]

    def samples(self, t_ns: Any) -> list[Sample]:
        self.seq += 1
        return [Sample(self.port.path, self.seq, t_ns, t_ns + self.late, True, (float(t_ns),))]


class Rig:
    def __init__(self, *slots: Slot) -> None:
        self.slots: Any = {slot.port.path: slot for slot in slots}
        self.t = 0
        self.sensing = Sensing(self.slots, lambda: self.t / 1e9, lambda _: lambda _: self.t)  # type: ignore[arg-type, return-value]
        self.sensing.schedule()

    def tick(self, n: int) -> list[tuple[str, int]]:
        self.t, samples = 10 * n, list[Sample]()
        self.sensing.after(n, self.t, samples)
        return [(sample.port, sample.t_ns) for sample in samples]


def test_each_is_due_every_divisor_ticks() -> None:
    rig = Rig(Slot("a", 2), Slot("b", 3))
    assert [[port for port, _ in rig.tick(n)] for n in (1, 2, 3, 6)] == [[], ["a"], ["b"], ["a", "b"]]


def test_one_that_repeats_others_reads_after_them() -> None:
    assert [port for port, _ in Rig(Slot("a", 4, repeats=True), Slot("b", 4)).tick(4)] == ["b", "a"]


def test_the_inactive_and_the_silent_do_not_measure() -> None:
    off, silent = Slot("off"), Slot("silent")
    off.active, silent.fault = False, "silent"
    assert Rig(off, silent).tick(1) == []
    assert (off.seq, silent.seq) == (0, 0)


def test_the_delayed_come_first_oldest_first_and_never_early() -> None:
    rig = Rig(Slot("slow", 2, late=25), Slot("now", 4))
    assert rig.tick(2) == []
    assert rig.tick(4) == [("now", 40)]
    assert rig.tick(5) == [("slow", 20)]
    assert rig.tick(8) == [("slow", 40), ("now", 80)]


def test_one_that_is_called_measures_before_those_that_are_due() -> None:
    listener = Slot("ear", 100, listens=True)
    rig = Rig(Slot("due"), listener)
    assert rig.tick(1) == [("due", 10)]
    listener.called = True
    assert rig.tick(2) == [("ear", 20), ("due", 20)]


def test_samples_of_what_went_are_lost() -> None:
    rig = Rig(Slot("a", late=25), Slot("b", late=25))
    rig.tick(1)
    rig.sensing.keep({"b": rig.slots["b"].port})
    rig.slots.clear()
    rig.sensing.schedule()
    assert rig.tick(4) == [("b", 10)]


def test_samples_on_their_way_go_on_in_their_order() -> None:
    rig, other = (Rig(Slot("a", late=25), Slot("b", late=15)) for _ in range(2))
    for n in (1, 2):
        rig.tick(n)
    state = rig.sensing.save()
    other.sensing.check(state)
    other.sensing.load(state)
    assert [other.tick(n) for n in (3, 4, 5)] == [rig.tick(n) for n in (3, 4, 5)]


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ((1, 1, "none", 0, 0, True, (1.0,)), "none"),
        ((1, 9, "a", 0, 0, True, (1.0,)), "cannot be"),
        ((1, 1, "a", 0, 0, True, (1.0, 2.0)), "fields"),
        ((1, 1, "a", 0, 0, True, ("x",)), "another type"),
    ],
)
def test_samples_that_cannot_be_are_refused(entry: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Rig(Slot("a")).sensing.check(OnTheirWay(5, (entry,)))
