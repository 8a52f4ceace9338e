"""Datagrams are taken at once until a turn is used up; then senders are served in turn, each in its order, with rests between."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from uwserver.adapter import DatagramTurns, TurnTimes, turns
from uwserver.adapter.turns import OVERHEAD, WAITING, WAITING_OF_ALL

TURN_S, REST_S = 2.0, 4.0


class Clockwork:
    """A loop whose time passes only when work is done, or a test lets it."""

    def __init__(self) -> None:
        self.now = 100.0
        self.due: list[tuple[float, Callable[[], None]]] = []

    def time(self) -> float:
        return self.now

    def call_at(self, when: float, function: Callable[[], None]) -> Clockwork:
        self.due.append((when, function))
        return self

    def cancel(self) -> None:
        self.due.clear()

    def go_on(self) -> None:
        self.now, function = self.due.pop()
        function()


class Rig:
    def __init__(self) -> None:
        self.loop = Clockwork()
        self.turns = TurnTimes()
        self.done: list[tuple[float, str]] = []

    def make(self) -> DatagramTurns:
        return DatagramTurns(self.turns, TURN_S, REST_S)

    def work(self, name: str, *costs: float) -> Callable[[], Iterator[None]]:
        def steps() -> Iterator[None]:
            for cost in costs:
                self.loop.now += cost
                self.done.append((self.loop.now - 100.0, name))
                yield

        return steps


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Rig:
    rig = Rig()
    monkeypatch.setattr(turns.asyncio, "get_running_loop", lambda: rig.loop)
    return rig


def test_what_is_not_much_is_taken_at_once(rig: Rig) -> None:
    taken = rig.make()
    for n in range(50):
        assert taken.put("a", 100, rig.work(str(n), 0.1))
        rig.loop.now += 1.0
    assert [name for _, name in rig.done] == [str(n) for n in range(50)]
    assert rig.loop.due == []


def test_what_comes_at_once_is_spread_over_turns_and_nobody_keeps_another_waiting(rig: Rig) -> None:
    taken = rig.make()
    for n in range(6):
        taken.put("flood", 100, rig.work(f"f{n}", 1.0))
    taken.put("other", 100, rig.work("o0", 1.0))
    while rig.loop.due:
        rig.loop.go_on()
    assert [name for _, name in rig.done] == ["f0", "f1", "f2", "o0", "f3", "f4", "f5"]
    assert [at for at, _ in rig.done] == [1.0, 2.0, 7.0, 8.0, 13.0, 14.0, 19.0]


def test_one_that_costs_much_is_taken_in_pieces(rig: Rig) -> None:
    taken = rig.make()
    taken.put("a", 100, rig.work("long", *[1.0] * 5))
    assert [at for at, _ in rig.done] == [1.0, 2.0]
    taken.put("b", 100, rig.work("short", 1.0))
    while rig.loop.due:
        rig.loop.go_on()
    assert [at for at, _ in rig.done] == [1.0, 2.0, 7.0, 8.0, 13.0, 14.0]
    assert rig.done[-1][1] == "short"


def test_sockets_of_one_adapter_have_their_turns_one_after_the_other(rig: Rig) -> None:
    one, two = rig.make(), rig.make()
    for taken, name in ((one, "1"), (two, "2")):
        for _ in range(3):
            taken.put("a", 100, rig.work(name, 2.0))
    assert [when for when, _ in rig.loop.due] == [106.0, 112.0]


def test_what_cannot_wait_is_dropped(rig: Rig) -> None:
    taken = rig.make()
    taken.put("a", 0, rig.work("first", TURN_S))
    assert taken.put("a", 10 * WAITING, rig.work("large", 0.0)), "one of any size may wait"
    assert not taken.put("a", 0, rig.work("", 0.0))
    size = WAITING // 2 - OVERHEAD
    assert [taken.put("b", size, rig.work("", 0.0)) for _ in range(3)] == [True, True, False]
    kept = sum(taken.put(n, size, rig.work("", 0.0)) for n in range(1000))
    assert kept <= WAITING_OF_ALL // (size + OVERHEAD)
    while rig.loop.due:
        rig.loop.go_on()
    assert len(rig.done) == 4 + kept
    assert taken.put("a", WAITING, rig.work("", 0.0)), "nothing waits any more"


def test_a_fault_of_ours_costs_one_datagram(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    def broken() -> Iterator[None]:
        yield
        raise ZeroDivisionError

    taken = rig.make()
    taken.put("a", 0, broken)
    taken.put("a", 0, rig.work("next", 0.1))
    assert [name for _, name in rig.done] == ["next"]
    assert "a fault of the adapter" in caplog.text


def test_at_the_end_nothing_is_taken_any_more(rig: Rig) -> None:
    taken = rig.make()
    for _ in range(3):
        taken.put("a", 0, rig.work("a", TURN_S))
    taken.close()
    assert rig.loop.due == []
    assert len(rig.done) == 1
