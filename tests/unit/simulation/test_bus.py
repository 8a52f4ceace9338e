"""The crossings: order, bounds, and that one receiver's fault stays with it."""

from __future__ import annotations

import logging

import pytest

from uwserver.ports import Call, Event, Progress, Refused, Reply, Sample
from uwserver.ports.crossing import TickOutput
from uwserver.simulation.bus import MAX_POSTED, MAX_TICKS, Bus, Mailbox


class Notes:
    def __init__(self) -> None:
        self.seen: list = []

    def put_samples(self, samples) -> None:
        self.seen.append([s.seq for s in samples])

    def put_event(self, event) -> None:
        self.seen.append(event.event)


class Broken(Notes):
    def put_samples(self, samples) -> None:
        raise ValueError("broken sink")


def tick(seq: int, **parts) -> TickOutput:
    return TickOutput(seq, seq, [Sample("rov/imu", seq, seq, seq, True, (1.0,))], **parts)


def test_one_wake_up_however_many_ticks_wait():
    wakes: list = []
    bus = Bus(wakes.append)
    notes = Notes()
    bus.attach(notes)
    for k in range(5):
        bus.publish(tick(k))
    assert len(wakes) == 1
    wakes.pop()()
    assert notes.seen == [[0], [1], [2], [3], [4]]
    bus.publish(tick(5))
    assert len(wakes) == 1


def test_an_empty_tick_wakes_nobody():
    wakes: list = []
    Bus(wakes.append).publish(TickOutput(0, 0, []))
    assert wakes == []


def test_order_is_that_of_the_simulation():
    bus, notes, answers = Bus(lambda _: None), Notes(), []
    bus.attach(notes)
    bus.reply(answers.append, Progress(0.5, 0))
    bus.publish(tick(1, replies=[(answers.append, Reply(1, 1))], events=[Event("reset", 1, 1, "")]))
    bus.say(Event("paused", 1, 1, ""))
    bus.dispatch()
    assert notes.seen == ["reset", [1], "paused"]
    assert [type(a).__name__ for a in answers] == ["Progress", "Reply"]


def test_a_loop_that_stalls_costs_samples_but_no_reply_and_no_event():
    bus, notes, answers = Bus(lambda _: None), Notes(), []
    bus.attach(notes)
    for k in range(MAX_TICKS + 10):
        bus.publish(tick(k, replies=[(answers.append, Reply(k, k))], events=[Event("reset", k, k, "")]))
    assert bus.dropped == 10
    assert bus.backlog() == MAX_TICKS + 10
    bus.dispatch()
    assert len(answers) == MAX_TICKS + 10
    assert notes.seen.count("reset") == MAX_TICKS + 10
    assert bus.backlog() == 0


def test_a_tick_that_lost_all_it_held_does_not_wait():
    bus = Bus(lambda _: None)
    for k in range(MAX_TICKS + 10):
        bus.publish(tick(k))
    assert bus.dropped == 10
    assert bus.backlog() == MAX_TICKS


def test_a_broken_sink_and_a_broken_asker_hurt_nobody(caplog):
    def fails(_: object) -> None:
        raise RuntimeError("broken asker")

    bus, notes, answers = Bus(lambda _: None), Notes(), []
    bus.attach(Broken())
    bus.attach(notes)
    bus.publish(tick(1, replies=[(fails, Reply(1, 1)), (answers.append, Reply(1, 1))]))
    with caplog.at_level(logging.ERROR):
        bus.dispatch()
    assert notes.seen == [[1]]
    assert len(answers) == 1
    assert "broken sink" in caplog.text
    assert "broken asker" in caplog.text


def test_a_detached_sink_hears_no_more():
    bus, notes = Bus(lambda _: None), Notes()
    detach = bus.attach(notes)
    detach()
    bus.publish(tick(1))
    bus.dispatch()
    assert notes.seen == []
    assert bus.last["rov/imu"].seq == 1


def test_the_mailbox_is_bounded_and_tells_the_sender():
    mailbox = Mailbox()
    for _ in range(MAX_POSTED):
        mailbox.post(Call("world/reset", {}), None)
    with pytest.raises(Refused, match="wait for the next tick") as caught:
        mailbox.post(Call("world/reset", {}), None)
    assert caught.value.fault.code == "overload"
    assert len(mailbox.take()) == MAX_POSTED
    assert mailbox.take() == []
    assert mailbox.wake.is_set()
