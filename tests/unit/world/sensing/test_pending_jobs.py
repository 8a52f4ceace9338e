"""Sensors that take time in a world: same bits whoever computes, drops, failures, states, and what becomes of jobs when sensors go."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from slow_rig import kind_of, slow_resolved

from uwserver.ports import Refused, Sample
from uwserver.scenario.build.world import build
from uwserver.world import World
from uwserver.world.state import snapshot

PORT, LATE = "rov/slow", "rov/slow/late"


@pytest.fixture
def slow(tmp_path: Path) -> Iterator[Callable[..., World]]:
    made: list[tuple[World, Any]] = []

    def make(keys: str = "") -> World:
        world = build(slow_resolved(tmp_path, keys))
        made.append((world, kind_of(world)))
        return world

    yield make
    for world, kind in made:
        kind.gate.set()
        world.end("the test is over")


def pictures(samples: list[Sample], port: str = PORT) -> list[tuple[int, int, Any]]:
    return [(s.seq, s.t_sent_ns, s.value) for s in samples if s.port == port]


def test_a_reading_is_begun_and_delivered_when_it_is_due(slow: Callable[..., World]) -> None:
    world = slow()
    assert pictures(world.step(14)) == []
    ((seq, sent, (depth, image)),) = pictures(world.step())
    assert (seq, sent) == (0, 61_666_667)
    assert depth < 5.0  # of its begin, five ticks ago
    assert image.shape == (4,)
    ((_, late, value),) = pictures(world.step(2), LATE)
    assert (late, value) == (69_666_667, (depth, image))
    assert len(kind_of(world).runs) == 1  # for both streams
    assert {name for _, name in kind_of(world).runs} <= {"uwserver-computing", "MainThread"}


def test_the_tick_waits_for_it_and_what_ran_when_changes_no_bit(slow: Callable[..., World]) -> None:
    early, held = slow(), slow()
    gate = kind_of(held).gate
    gate.clear()
    first = held.step(14)
    threading.Timer(0.05, gate.set).start()
    first += held.step(60)
    assert early.step(74) == first
    assert snapshot.take(early).hash() == snapshot.take(held).hash()


def test_nobody_computes_what_nobody_reads(slow: Callable[..., World]) -> None:
    world = slow()
    world.subscribe(())
    world.step(40)
    assert kind_of(world).runs == []
    found = world.read(PORT)
    assert found is not None
    assert found.image.shape == (4,)
    assert len(kind_of(world).runs) == 1


def test_a_dropped_reading_shifts_no_other(slow: Callable[..., World]) -> None:
    world, whole = slow(), slow()
    world.step(31)  # reading 2 is under way
    world.call("world/drop_reading", port=PORT, number=2)
    world.call("world/drop_reading", port=PORT, number=3)  # begins in tick 40
    lost = world.step(60)
    kept = [picture for picture in pictures(whole.step(91)) if picture[0] >= 2]
    assert pictures(lost) == [picture for picture in kept if picture[0] not in (2, 3)]
    assert [seq for seq, *_ in pictures(lost, LATE)] == [4, 5, 6, 7]
    assert world.sensor_arrays.computing.dropped == {PORT: 2}


def test_only_what_is_under_way_or_next_can_be_dropped(slow: Callable[..., World]) -> None:
    world = slow()
    world.step(31)
    for args, told in (
        ({"port": "rov/imu", "number": 0}, "there are: rov/slow"),
        ({"port": PORT, "number": 0}, "reading 0 is not under way; the next is 3"),
        ({"port": PORT, "number": 4}, "reading 4 is not under way"),
    ):
        with pytest.raises(Refused, match=told):
            world.call("world/drop_reading", **args)


def test_what_cannot_be_ready_is_told_to_who_must_not_wait(slow: Callable[..., World]) -> None:
    world = slow("delay_s = 0.06")
    pending_jobs, at = world.sensing.pending_jobs, world.ticks.time_of
    kind_of(world).gate.clear()
    world.step(10)
    assert pending_jobs.late(11, at(11)) == []
    world.step(9)
    (begins,) = pending_jobs.late(20, at(20))  # the one before is still computed
    assert (begins.service, dict(begins.args)) == ("world/drop_reading", {"port": PORT, "number": 1})
    world.call(begins.service, **begins.args)
    world.step(5)
    (due,) = pending_jobs.late(25, at(25))
    assert dict(due.args) == {"port": PORT, "number": 0}
    world.call(due.service, **due.args)
    assert pictures(world.step(4)) == []  # waits for nothing
    kind_of(world).gate.set()


def test_a_job_that_fails_makes_its_reading_invalid_and_is_told_once(
    slow: Callable[..., World], caplog: pytest.LogCaptureFixture
) -> None:
    world = slow("fails = true")
    found = [s for s in world.step(60) if s.port in (PORT, LATE)]
    assert len(found) == 10
    assert not any(s.valid for s in found)
    assert all(s.value[0] is not None and s.value[1] is None for s in found)
    (told,) = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert told == '"rov/slow": reading 0 could not be computed, and is invalid: RuntimeError: the film is torn'
    assert world.sensor_arrays.computing.failed == {PORT: 5}


@pytest.mark.parametrize("keys", ["", "metered = true", "fails = true"])
def test_a_state_goes_on_bit_for_bit(slow: Callable[..., World], keys: str) -> None:
    one, other, third = slow(keys), slow(keys), slow(keys)
    one.step(33)  # one is under way
    data = snapshot.to_bytes(one, snapshot.take(one))
    snapshot.from_bytes(other, data)
    snapshot.restore(third, snapshot.take(one))  # with its job
    assert snapshot.take(one).hash() == snapshot.take(other).hash() == snapshot.take(third).hash()
    expected = one.step(50)
    assert other.step(50) == expected
    assert third.step(50) == expected
    assert snapshot.take(one).hash() == snapshot.take(other).hash()


def test_a_hash_waits_for_no_job(slow: Callable[..., World]) -> None:
    world, free = slow(), slow()
    kind_of(world).gate.clear()
    world.step(12)
    taken = snapshot.take(world)
    free.step(12)
    assert taken.hash() == snapshot.take(free).hash()


def test_what_was_metered_acts_on_the_next_reading_though_nobody_reads(slow: Callable[..., World]) -> None:
    read, unread = slow("metered = true"), slow("metered = true")
    unread.subscribe(())
    read.step(60)
    unread.step(60)
    levels = [world.sensors[PORT].sensor.memory.level for world in (read, unread)]
    assert levels[0] == levels[1] != 0.0
    assert snapshot.take(read).hash() == snapshot.take(unread).hash()


def test_reset_in_the_middle_begins_anew(slow: Callable[..., World]) -> None:
    world = slow()
    first = world.step(40)
    kind_of(world).gate.clear()
    world.step(2)
    world.call("world/reset")
    kind_of(world).gate.set()
    assert world.step(40) == first


def test_a_vehicle_that_goes_leaves_nothing_behind(slow: Callable[..., World]) -> None:
    world = slow()
    kind_of(world).gate.clear()
    world.step(12)
    kind = kind_of(world)
    world.dismiss("rov")
    assert world.sensing.pending_jobs.is_idle
    assert world.step(40) == []  # waits for nothing
    kind.gate.set()
    world.end("over")


def test_the_thread_ends_with_the_world(slow: Callable[..., World]) -> None:
    world = slow()
    before = threading.active_count()
    world.step(9)
    assert threading.active_count() == before  # begins with the first job
    world.step(1)
    assert threading.active_count() == before + 1
    world.end("over")
    assert threading.active_count() == before
