"""The crossings: order, bounds, and that one receiver's fault stays with it. Also of uwserver.simulation.mailbox."""

from __future__ import annotations

import logging
import weakref
from types import SimpleNamespace
from typing import Any

import pytest
from lock_rig import Keeper
from msgspec.structs import replace
from unit.ports.test_sample_batch import SAMPLES, batch, full

from uwserver.ports import Buffer, Call, Command, Event, Field, Port, Progress, Refused, Reply, Sample
from uwserver.ports.crossing import TickOutput
from uwserver.ports.decimation import EVERY_SAMPLE, Decimation
from uwserver.ports.sample_batch import SampleBatch
from uwserver.simulation.bus import MAX_TICKS, Bus, Newest, Subscriptions, merged, merged_decimations
from uwserver.simulation.mailbox import MAX_WAITING, Mailbox
from uwserver.testing import MockTime


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
    bus = Bus(wakes.append, MockTime())
    notes = Notes()
    bus.attach(notes)
    for k in range(5):
        bus.publish(tick(k))
    assert len(wakes) == 1
    wakes.pop()()
    assert notes.seen == [[0], [1], [2], [3], [4]]
    bus.publish(tick(5))
    assert len(wakes) == 1


@pytest.mark.parametrize("answer", [{"replies": [(print, Reply(1, 1))]}, {"events": [Event("reset", 1, 1, "")]}])
def test_an_answer_wakes_the_loop_also_in_a_tick_that_wakes_nobody(answer: dict):
    """Nobody knows when the next tick comes that does: the world may wait for who asked."""
    wakes: list = []
    bus = Bus(wakes.append, MockTime())
    bus.publish(tick(0), wake=False)
    assert wakes == []
    bus.publish(tick(1, **answer), wake=False)
    assert wakes == [bus.dispatch]


def test_what_waits_is_touched_under_the_lock_alone():
    """Else the loop could deliver a tick while the simulation lets it take in the next, which would be lost."""
    wakes: list = []
    bus, notes = Bus(wakes.append, MockTime()), Notes()
    bus.attach(notes)
    lock = bus._lock = Keeper(bus, "_crossing", "_waiting_ticks", "_awake")
    bus.publish(tick(0), wake=False)
    bus.flush()
    bus.publish(tick(1))
    bus.reply(notes.seen.append, Progress(0.5, 0))
    bus.say(Event("paused", 1, 1, ""))
    wakes.pop()()
    assert notes.seen == [[0], [1], Progress(0.5, 0), "paused"]
    with lock:
        assert (wakes, bus.backlog()) == ([], 0)


def test_an_empty_tick_wakes_nobody():
    wakes: list = []
    Bus(wakes.append, MockTime()).publish(TickOutput(0, 0, []))
    assert wakes == []


def test_what_waits_goes_with_the_next_tick_that_may_wake_also_an_empty_one():
    """Else the sample of a slow sensor would wait until one meets such a tick by chance."""
    wakes: list = []
    bus = Bus(wakes.append, MockTime())
    bus.publish(tick(0), wake=False)
    bus.publish(TickOutput(1, 1, []), wake=False)
    assert wakes == []
    bus.publish(TickOutput(2, 2, []), wake=True)
    assert len(wakes) == 1


class Wanting(Notes):
    def __init__(self, *paths: str) -> None:
        super().__init__()
        self.subscriptions = paths


PORTS = {path: Port(path, "sensor", "x", (Field("x", "1", "x"),), "x", 10.0) for path in ("a", "b", "c")}


def made(bus: Bus) -> str:
    return "".join(path for path in PORTS if bus.subscriptions is None or path in bus.subscriptions)


def test_what_is_wanted_is_what_all_readers_want_together():
    bus = Bus(lambda _: None, MockTime())
    bus.expect(PORTS)
    assert made(bus) == ""
    one, two = Wanting("a"), Wanting("a", "b")
    leave_one, leave_two = bus.attach(one), bus.attach(two)
    assert made(bus) == "ab"
    two.subscriptions = ("c",)
    assert made(bus) == "ab"
    bus.subscriptions_changed()
    assert made(bus) == "ac"
    leave_all = bus.attach(Notes())
    assert made(bus) == "abc"
    leave_all()
    leave_one()
    assert made(bus) == "c"
    leave_two()
    assert made(bus) == ""


def test_a_second_reader_of_the_same_gives_the_world_nothing_to_do():
    """Which would mark all its streams anew: somebody may come and go in every tick."""
    bus = Bus(lambda _: None, MockTime())
    bus.expect(PORTS)
    bus.attach(Wanting("a"))
    subscriptions = bus.subscriptions
    leave = bus.attach(Wanting("a"))
    leave()
    assert bus.subscriptions is subscriptions
    bus.expect(dict(PORTS))
    assert bus.subscriptions is not subscriptions


def test_what_readers_have_not_heard_of_is_wanted_until_they_have():
    bus, heard = Bus(lambda _: None, MockTime()), Wanting("a")
    assert made(bus) == "abc"
    bus.attach(heard)
    assert made(bus) == "abc"
    bus.expect({path: PORTS[path] for path in "ab"})
    assert made(bus) == "ac"
    seen: list[str] = []
    heard.put_event = lambda event: seen.append(made(bus))
    bus.publish(TickOutput(1, 1, [], ports=PORTS, events=[Event("ports_changed", 1, 1, "")]))
    bus.drain()
    assert seen == ["ac"]
    assert made(bus) == "a"


def test_what_was_not_wanted_meanwhile_is_not_the_newest():
    bus, reader = Bus(lambda _: None, MockTime()), Wanting("a", "b")
    bus.attach(reader)
    both = [Sample(path, 1, 1, 1, True, (1.0,)) for path in "ab"]
    bus.publish(TickOutput(1, 1, both, ports=PORTS))
    bus.drain()
    assert sorted(bus.last) == ["a", "b"]
    for wanted in (("a",), ("a", "b")):
        reader.subscriptions = wanted
        bus.subscriptions_changed()
        assert sorted(bus.last) == ["a"]
        if wanted == ("a",):
            bus.publish(TickOutput(2, 2, both, ports=PORTS))  # it was under way
            bus.drain()


def test_a_reader_that_cannot_say_what_it_wants_harms_no_other(caplog: pytest.LogCaptureFixture):
    class Confused(Notes):
        @property
        def subscriptions(self):
            raise ValueError("confused")

    bus, notes = Bus(lambda _: None, MockTime()), Wanting("a")
    bus.attach(notes)
    leave = bus.attach(Confused())
    bus.expect(PORTS)
    assert made(bus) == "abc"
    assert "it gets all" in caplog.text
    leave()
    assert made(bus) == "a"


def test_ports_are_those_of_what_is_delivered():
    """The world may have taken a vehicle out, and put another kind under its name, while samples of the old one still wait."""
    old = Port("rov/imu", "sensor", "imu", (Field("f", "1", "x"),), "x", 10.0)
    faster, other = replace(old, rate_hz=20.0), replace(old, fields=(Field("depth", "m", "x"),))
    bus, seen = Bus(lambda _: None, MockTime()), []

    class Look(Notes):
        def put_samples(self, samples) -> None:
            seen.append((bus.ports["rov/imu"], sorted(bus.last)))

        def put_event(self, event) -> None:
            seen.append((bus.ports["rov/imu"], sorted(bus.last)))

    bus.attach(Look())
    for k, port in enumerate((old, old, faster, other)):
        bus.publish(tick(k, ports={"rov/imu": port}, events=[Event("ports_changed", k, k, "")] if k > 1 else []))
    assert bus.ports is None
    bus.drain()
    there = ["rov/imu"]
    assert seen == [(old, there), (old, there), (faster, there), (faster, there), (other, []), (other, there)]


def test_order_is_that_of_the_simulation():
    bus, notes, answers = Bus(lambda _: None, MockTime()), Notes(), []
    bus.attach(notes)
    bus.reply(answers.append, Progress(0.5, 0))
    bus.publish(tick(1, replies=[(answers.append, Reply(1, 1))], events=[Event("reset", 1, 1, "")]))
    bus.say(Event("paused", 1, 1, ""))
    bus.dispatch()
    assert notes.seen == ["reset", [1], "paused"]
    assert [type(a).__name__ for a in answers] == ["Progress", "Reply"]


def test_a_loop_that_stalls_costs_samples_but_no_reply_and_no_event():
    bus, notes, answers = Bus(lambda _: None, MockTime()), Notes(), []
    bus.attach(notes)
    for k in range(MAX_TICKS + 10):
        bus.publish(tick(k, replies=[(answers.append, Reply(k, k))], events=[Event("reset", k, k, "")]))
    assert bus.dropped == 10
    assert bus.backlog() == MAX_TICKS + 10
    bus.drain()
    assert len(answers) == MAX_TICKS + 10
    assert notes.seen.count("reset") == MAX_TICKS + 10
    assert bus.backlog() == 0


def test_a_tick_that_lost_all_it_held_does_not_wait():
    bus = Bus(lambda _: None, MockTime())
    for k in range(MAX_TICKS + 10):
        bus.publish(tick(k))
    assert bus.dropped == 10
    assert bus.backlog() == MAX_TICKS


def test_a_broken_sink_and_a_broken_asker_hurt_nobody(caplog):
    def fails(_: object) -> None:
        raise RuntimeError("broken asker")

    bus, notes, answers = Bus(lambda _: None, MockTime()), Notes(), []
    bus.attach(Broken())
    bus.attach(notes)
    bus.publish(tick(1, replies=[(fails, Reply(1, 1)), (answers.append, Reply(1, 1))]))
    with caplog.at_level(logging.ERROR):
        bus.drain()
    assert notes.seen == [[1]]
    assert len(answers) == 1
    assert "broken sink" in caplog.text
    assert "broken asker" in caplog.text


def test_a_detached_sink_hears_no_more():
    bus, notes = Bus(lambda _: None, MockTime()), Notes()
    detach = bus.attach(notes)
    detach()
    bus.publish(tick(1))
    bus.dispatch()
    assert notes.seen == []
    assert bus.last["rov/imu"].seq == 1


def test_the_mailbox_is_bounded_tells_the_sender_and_wakes_the_simulation():
    mailbox = Mailbox()
    for _ in range(MAX_WAITING):
        mailbox.post(Call("world/reset", {}, "tcp:1"), None)
    with pytest.raises(Refused, match="wait for their tick") as caught:
        mailbox.post(Call("world/reset", {}, "tcp:1"), None)
    assert caught.value.fault.code == "overload"
    mailbox.post(Call("world/reset", {}, "tcp:2"), None)
    assert len(mailbox.posted) == MAX_WAITING + 1
    assert mailbox.wake.is_set()


def test_a_client_that_has_said_its_name_is_still_the_same():
    mailbox = Mailbox()
    for source in ("tcp:1", "tcp:1 (helm)", "tcp:1 (helm)", "tcp:2"):
        mailbox.post(Call("world/reset", {}, source), None)
    taken = [mailbox.posted.take() for _ in range(4)]
    assert [posted.item.source for posted in taken] == ["tcp:1", "tcp:2", "tcp:1 (helm)", "tcp:1 (helm)"]


class Slow:
    """A sink that needs its time for a tick."""

    def __init__(self, time: MockTime, seconds: float) -> None:
        self._time, self._seconds = time, seconds
        self.ticks = 0

    def put_samples(self, samples) -> None:
        self.ticks += 1
        self._time.pass_time(self._seconds)

    def put_event(self, event) -> None:
        pass


def test_a_long_delivery_is_cut_so_that_the_loop_can_look_at_its_sockets():
    wakes, time = [], MockTime()
    bus, slow = Bus(wakes.append, time), Slow(time, 0.004)
    bus.attach(slow)
    for k in range(8):
        bus.publish(tick(k))
    seen = []
    while wakes:
        wakes.pop()()
        seen.append((slow.ticks, bus.backlog()))
    assert seen == [(2, 6), (4, 4), (6, 2), (8, 0)]
    bus.publish(tick(9))
    assert len(wakes) == 1
    bus.publish(tick(10))
    bus.drain()
    assert (slow.ticks, bus.backlog()) == (10, 0)


def test_how_far_a_world_may_be_ahead_follows_what_the_loop_needs_for_a_tick():
    """Also what it still writes to its sockets when it is called again; and nothing of the time in which nobody calls it."""
    wakes, time = [], MockTime()
    bus, slow = Bus(wakes.append, time), Slow(time, 0.001)
    bus.attach(slow)
    assert MAX_TICKS // 2 < bus.ahead < MAX_TICKS

    def turns(count: int, writing_s: float, idle_s: float = 0.0, answers: int = 0) -> int:
        for _ in range(count):
            time.pass_time(idle_s)
            for _ in range(answers):
                bus.publish(TickOutput(0, 0, [], [(lambda reply: None, Reply(0, 0))]))
            bus.publish(tick(0))
            bus.publish(tick(1))
            time.pass_time(writing_s)
            wakes.pop()()
        return bus.ahead

    assert turns(40, writing_s=0.0) == pytest.approx(10, abs=1)
    assert turns(40, writing_s=0.0, idle_s=0.1) == pytest.approx(10, abs=1), "nobody waited for it meanwhile"
    assert turns(40, writing_s=0.002) == pytest.approx(5, abs=1)
    assert turns(40, writing_s=0.0, answers=2) == pytest.approx(10, abs=1), "answers by themselves are no ticks"
    assert turns(40, writing_s=10.0) == 2, "at least one is made while another is delivered"
    assert turns(40, writing_s=0.0) == pytest.approx(10, abs=1)


def test_the_loop_is_woken_before_a_world_that_nothing_paces_has_to_wait_for_it():
    wakes: list = []
    bus = Bus(wakes.append, MockTime())
    bus.attach(Notes())
    while not wakes:
        bus.publish(tick(0), wake=False)
    assert 2 * bus.ahead < 3 * bus.backlog() < 3 * bus.ahead


class Sending(Notes):
    def send_samples(self) -> None:
        self.seen.append("sent")


def test_what_waits_is_sent_together():
    wakes: list = []
    bus, sending, notes = Bus(wakes.append, MockTime()), Sending(), Notes()
    bus.attach(notes)
    detach = bus.attach(sending)
    for k in range(3):
        bus.publish(tick(k), wake=k == 2)
    wakes.pop()()
    assert sending.seen == [[0], [1], [2], "sent"]
    assert notes.seen == [[0], [1], [2]]
    detach()
    bus.publish(tick(3))
    wakes.pop()()
    assert len(sending.seen) == 4


def test_the_newest_of_a_decimated_port_is_not_kept_for_who_wants_all():
    """It may be older than the newest; who comes later waits for the next."""
    wakes: list = []
    bus, slow = Bus(wakes.append, MockTime()), Wanting("rov/imu")
    slow.decimations = {"rov/imu": (Decimation(10.0, 0),)}
    bus.attach(slow)
    bus.publish(tick(1))
    wakes.pop()()
    bus.attach(Wanting("rov/imu"))
    assert bus.subscriptions.decimations == {}
    assert bus.last == {}
    bus.publish(tick(2))
    wakes.pop()()
    assert bus.last["rov/imu"].seq == 2


def places(item) -> int:
    """How many of a request may wait."""
    mailbox = Mailbox()
    for count in range(2000):
        try:
            mailbox.post(item, None)
        except Refused:
            return count
    return 2000


def test_requests_that_keep_much_are_few():
    """Of small ones a thousand may wait."""
    mission = {"items": [{"kind": "waypoint", "position_ned_m": [1.0, 2.0, 3.0]}] * 700}
    nested = {"parameters": {"members": ["t1"] * 4000}}
    picture = Buffer(dtype="uint8", shape=(1 << 20,), data=bytes(1 << 20))
    goto = {"position_ned_m": [1.0, 2.0, 3.0], "radius_m": 1.0}
    assert 4 < places(Call("rov/autopilot/set_mission", mission, "tcp:1")) < 20
    assert 4 < places(Call("world/set_fault", nested, "tcp:1")) < 30
    assert places(Call("world/load", {"data": "x" * 500_000}, "tcp:1")) == 4
    assert places(Command("rov/display", (picture, None), "tcp:1")) == 2
    assert places(Call("rov/autopilot/goto", goto, "tcp:1")) == MAX_WAITING
    assert places(Command("rov/thrusters", ((1.0,) * 8,), "tcp:1")) == MAX_WAITING


def test_rows_become_samples_once_where_several_read_them_and_not_before_where_one_does():
    bus = Bus(lambda call: None, MockTime())
    seen: list[object] = []
    sinks = [Notes(), Notes()]
    for sink in sinks:
        sink.put_samples = seen.append  # type: ignore[method-assign]
    first = bus.attach(sinks[0])
    bus.publish(TickOutput(1, 1, [], batch=batch()))
    bus.drain()
    bus.attach(sinks[1])
    bus.publish(TickOutput(2, 2, [], batch=batch()))
    bus.drain()
    assert isinstance(seen[0], SampleBatch)
    assert seen[1] is seen[2] == SAMPLES
    assert bus.last["rov/imu"] == SAMPLES[2]
    first()
    bus.publish(TickOutput(3, 3, [SAMPLES[0]], batch=batch()))
    bus.drain()
    assert seen[3] == [*SAMPLES, SAMPLES[0]]


def test_rows_for_which_there_is_no_room_are_counted():
    bus = Bus(lambda call: None, MockTime())
    for k in range(MAX_TICKS):
        bus.publish(tick(k))
    bus.publish(TickOutput(1, 1, [], batch=batch()))
    assert bus.dropped == len(SAMPLES)


class Rows(Notes):
    """Takes rows as they are."""

    def put_batch(self, batch: SampleBatch) -> None:
        self.seen.append((batch.ticks, [s.seq for s in batch]))


def rows_of_ticks(count: int, **parts) -> list[TickOutput]:
    """One sample each, which follow each other."""
    log, origins, ports = full(), batch().origins, {}
    return [
        TickOutput(k, k, [], batch=SampleBatch(origins, log, 2 + k, 3 + k), ports=ports, **parts) for k in range(count)
    ]


def test_who_is_alone_gets_the_rows_of_some_ticks_at_once():
    bus = Bus(lambda dispatch: None, MockTime())
    rows = Rows()
    bus.attach(rows)
    for output in rows_of_ticks(3):
        bus.publish(output)
    assert bus.backlog() == 3
    bus.dispatch()
    assert rows.seen == [(3, [7, 2, 8])]
    assert bus.backlog() == 0
    assert bus.last["rov/imu"] == SAMPLES[2]


def test_who_comes_while_some_ticks_wait_as_one_misses_none_of_them():
    """They were put together for who takes rows; a sink that takes samples gets each once, tick by tick."""
    bus = Bus(lambda dispatch: None, MockTime())
    rows, notes = Rows(), Notes()
    bus.attach(rows)
    first, second, third = rows_of_ticks(3)
    bus.publish(first)
    bus.publish(second)
    bus.attach(notes)
    bus.publish(third)
    bus.dispatch()
    assert rows.seen == [(1, [7]), (1, [2]), (1, [8])]
    assert notes.seen == [[7], [2], [8]]
    assert bus.backlog() == 0


def test_ticks_that_were_made_in_one_go_count_and_are_told_one_by_one():
    """A world that is ahead waits by ticks; and who takes samples gets those of one tick at a time."""
    bus = Bus(lambda dispatch: None, MockTime())
    rows, notes = Rows(), Notes()
    bus.attach(rows)
    bus.attach(notes)
    together = SampleBatch(batch().origins, full(), 2, 5, 3, (3, 4))
    bus.publish(TickOutput(3, 3, [], batch=together, ports={}))
    assert bus.backlog() == 3
    bus.dispatch()
    assert notes.seen == [[7], [2], [8]]
    assert rows.seen == [(1, [7]), (1, [2]), (1, [8])]
    assert bus.backlog() == 0


@pytest.mark.parametrize("what", ["made", "events", "replies", "jumps", "ports"])
def test_a_tick_that_gives_more_is_by_itself(what: str):
    bus = Bus(lambda dispatch: None, MockTime())
    rows = Rows()
    bus.attach(rows)
    replied: list = []
    first, second, third = rows_of_ticks(3)
    more = {
        "made": [Sample("rov/gps", 9, 1, 1, True, (1.0,))],
        "events": [Event("paused", 1, 1, "")],
        "replies": [(replied.append, Reply(1, 1))],
        "jumps": 1,
        "ports": {},
    }
    for output in (first, replace(second, **{what: more[what]}), third):
        bus.publish(output)
    bus.dispatch()
    told_in = [entry for entry in rows.seen if entry != "paused"]
    assert told_in == [(1, [7]), [2, 9] if what == "made" else (1, [2]), (1, [8])]
    assert rows.seen.index("paused") == 1 if what == "events" else "paused" not in rows.seen
    assert len(replied) == (what == "replies")


def test_who_wants_nothing_is_told_of_events_alone_and_another_is_alone():
    bus = Bus(lambda dispatch: None, MockTime())
    rows, idle = Rows(), Notes()
    idle.subscriptions = set()
    bus.attach(rows)
    bus.attach(idle)
    first, second, third = rows_of_ticks(3)
    bus.publish(replace(first, events=[Event("paused", 1, 1, "")]))
    bus.dispatch()
    assert rows.seen == ["paused", (1, [7])]
    assert idle.seen == ["paused"]
    idle.subscriptions.add("rov/imu")
    bus.subscriptions_changed()
    bus.publish(second)
    bus.dispatch()
    assert (rows.seen[2:], idle.seen[1:]) == ([(1, [2])], [[2]])
    idle.subscriptions.clear()
    bus.subscriptions_changed()
    bus.publish(third)
    bus.dispatch()
    assert (rows.seen[3:], idle.seen[2:]) == ([(1, [8])], [])


def test_where_others_read_too_it_is_tick_by_tick():
    bus = Bus(lambda dispatch: None, MockTime())
    rows, *notes = Rows(), Notes(), Notes()
    leave = [bus.attach(sink) for sink in (rows, *notes)][1:]
    for output in rows_of_ticks(2):
        bus.publish(output)
    bus.dispatch()
    assert rows.seen == [(1, [7]), (1, [2])]
    assert [sink.seen for sink in notes] == [[[7], [2]]] * 2
    assert bus.last["rov/state"] == SAMPLES[1]
    leave[0]()
    leave[1]()
    for output in rows_of_ticks(2):
        bus.publish(output)
    bus.dispatch()
    assert rows.seen[2:] == [(2, [7, 2])]


def test_the_newest_counts_made_or_not():
    newest = Newest()
    newest.put([Sample("rov/imu", 6, 90, 90, True, ((0.0, 0.0, 0.0), 1)), Sample("rov/depth", 1, 90, 90, True, (1.0,))])
    newest.put(batch())
    assert dict(newest) == {
        "rov/imu": SAMPLES[2], "rov/state": SAMPLES[1], "rov/depth": Sample("rov/depth", 1, 90, 90, True, (1.0,)),
    }  # fmt: skip
    last = Sample("rov/imu", 9, 120, 120, True, ((0.0, 0.0, 0.0), 1))
    newest.put([SAMPLES[0], last])
    assert newest["rov/imu"] == last
    assert newest.get("rov/gps") is None


def test_what_is_not_kept_is_forgotten():
    newest = Newest()
    newest.put(batch())
    newest.keep(lambda path: path == "rov/state")
    assert list(newest) == ["rov/state"]
    assert len(newest) == 1
    newest.clear()
    assert "rov/state" not in newest


def test_a_slow_port_does_not_keep_all_that_was_told_with_its_newest():
    newest, origins = Newest(), batch().origins
    logs = [full() for _ in range(3)]
    kept = [weakref.ref(log.entries) for log in logs]
    newest.put(batch(logs[0]))
    for log in logs[1:]:
        newest.put(SampleBatch(origins, log, 2, 3))  # one port alone goes on
    del log
    logs.clear()
    assert newest["rov/state"] == SAMPLES[1]
    assert newest["rov/imu"] == SAMPLES[0]
    assert [array() is None for array in kept] == [True, True, False]


SLOW, SLOWER = Decimation(10.0, 0), Decimation(1.0, 5)


def reader(*subscriptions: str, **decimations: tuple[Decimation, ...]) -> Any:
    return SimpleNamespace(subscriptions=subscriptions, decimations=decimations)


def test_who_says_nothing_wants_all() -> None:
    assert merged([reader("a"), object()]) is None
    assert merged([reader("a"), reader("b", "a")]) == {"a", "b"}
    assert merged([]) == frozenset()


def test_what_one_wants_whole_is_not_decimated_and_of_others_all_count() -> None:
    readers = [reader("a", "b", "c", a=(SLOW,), b=(SLOW,), c=(SLOW,)), reader("b", "c", c=(SLOW, SLOWER))]
    assert merged_decimations(readers, {"a", "b", "c"}) == {"a": {SLOW}, "c": {SLOW, SLOWER}}


def test_what_nobody_wants_is_not_told_of() -> None:
    assert merged_decimations([reader("a", a=(SLOW,), z=(SLOW,))], {"a"}) == {"a": {SLOW}}
    assert merged_decimations([reader("a", "b", a=())], {"a", "b"}) == {}, "without any, all are needed"


def test_one_that_cannot_tell_gets_all(caplog: pytest.LogCaptureFixture) -> None:
    class Broken:
        subscriptions = ("a", "b")

        @property
        def decimations(self) -> Any:
            raise ValueError("broken")

    assert merged_decimations([Broken(), reader("a", "c", a=(SLOW,), c=(SLOW,))], {"a", "b", "c"}) == {"c": {SLOW}}
    assert "it gets all" in caplog.text
    assert {record.levelno for record in caplog.records} == {logging.ERROR}


def test_ports_that_readers_have_not_heard_of_are_wanted() -> None:
    subscriptions = Subscriptions({"a"}, {"a", "b"})
    assert "a" in subscriptions
    assert "b" not in subscriptions
    assert "new" in subscriptions
    assert (subscriptions.jumps, subscriptions.decimations) == (0, EVERY_SAMPLE)


def test_a_panic_of_a_library_in_a_sink_costs_others_nothing(caplog):
    """pyo3 raises a panic in Rust as an error that is no Exception."""

    class Panic(BaseException):
        pass

    class Sink:
        subscriptions = None

        def __init__(self, fails: bool) -> None:
            self.fails, self.count = fails, 0

        def put_samples(self, samples):
            self.count += len(samples)
            if self.fails:
                raise Panic("poisoned lock")

        def put_event(self, event):
            pass

    bus = Bus(lambda _: None, MockTime())
    broken, sound = Sink(True), Sink(False)
    bus.attach(broken)
    bus.attach(sound)
    for number in range(1, 4):
        bus.publish(tick(number))
    bus.drain()
    assert (broken.count, sound.count) == (3, 3)
    assert "poisoned lock" in caplog.text
