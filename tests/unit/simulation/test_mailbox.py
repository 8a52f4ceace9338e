"""The order in which clients are served, the limits of their queues, and the pause that comes before other requests."""

from __future__ import annotations

import threading

import pytest
from lock_rig import Keeper

from uwserver.ports import Refused
from uwserver.simulation.mailbox import FREE_PLACES, MAX_BYTES, MAX_WAITING, MAX_WAITING_OF_ALL, FairQueue, Steering


def taken(queue: FairQueue[str]) -> list[str]:
    return [item for _ in range(len(queue)) if (item := queue.take()) is not None]


def fill(queue: FairQueue[str]) -> None:
    for client in range(MAX_WAITING_OF_ALL // MAX_WAITING):
        for _ in range(MAX_WAITING):
            queue.put(f"crowd {client}", "")


def test_clients_take_turns_and_each_keeps_its_order() -> None:
    queue: FairQueue[str] = FairQueue(threading.Event())
    for client, count in (("a", 4), ("b", 1), ("c", 2)):
        for n in range(count):
            queue.put(client, f"{client}{n}")
    assert queue.take() == "a0"
    queue.put("b", "b1")
    assert taken(queue) == ["b0", "c0", "a1", "b1", "c1", "a2", "a3"]
    assert (queue.take(), len(queue)) == (None, 0)


def test_queues_are_touched_under_the_lock_alone() -> None:
    """Else a request could go into a queue that is just taken away as an empty one, and be lost."""
    queue: FairQueue[str] = FairQueue(threading.Event())
    queue._lock = Keeper(queue, "_queues", "_bytes")  # type: ignore[assignment]
    queue.put("a", "a0")
    assert queue.overtake("a", "a-stop", lambda item: True) == ["a0"]
    queue.put("b", "b0", first=True)
    assert (queue.take(), queue.take(), queue.take()) == ("b0", "a-stop", None)


def test_whose_turn_is_next_still_keeps_its_own_order() -> None:
    queue: FairQueue[str] = FairQueue(threading.Event())
    for item in ("a0", "a1", "b0"):
        queue.put(item[0], item)
    queue.put("c", "c0", first=True)
    queue.put("b", "b1", first=True)
    assert taken(queue) == ["b0", "c0", "a0", "b1", "a1"]


def test_a_client_has_a_limit_of_its_own_and_is_told_which() -> None:
    queue: FairQueue[str] = FairQueue(threading.Event())
    for _ in range(MAX_WAITING):
        queue.put("a", "")
    with pytest.raises(Refused, match="1024 requests of this client wait") as caught:
        queue.put("a", "")
    assert caught.value.fault.code == "overload"
    queue.put("a", "", always=True)
    queue.put("b", "")
    assert len(queue) == MAX_WAITING + 2


def test_many_cannot_shut_out_one_who_asks_little() -> None:
    queue: FairQueue[str] = FairQueue(threading.Event())
    fill(queue)
    for _ in range(FREE_PLACES):
        queue.put("a", "")
    with pytest.raises(
        Refused, match="4096 requests of all clients wait for their tick already, 16 of them of this one"
    ):
        queue.put("a", "")
    queue.put("a", "", always=True)


def test_a_stop_is_done_before_all_that_its_client_asked_and_takes_back_what_it_must() -> None:
    queue: FairQueue[str] = FairQueue(threading.Event())
    for item in ("b0", "a-go", "a1", "a-go too", "a2"):
        queue.put(item[0], item)
    assert queue.overtake("a", "a-stop", lambda item: "go" in item) == ["a-go", "a-go too"]
    assert len(queue) == 4
    queue.put("a", "a-go again")
    assert taken(queue) == ["a-stop", "b0", "a1", "a2", "a-go again"]


def test_a_stop_is_taken_though_its_client_has_used_up_its_limit_but_not_for_ever() -> None:
    queue: FairQueue[str] = FairQueue(threading.Event())
    fill(queue)
    for _ in range(FREE_PLACES):
        assert queue.overtake("crowd 0", "stop", lambda item: False) == []
    with pytest.raises(Refused, match="1040 requests of this client wait") as caught:
        queue.overtake("crowd 0", "stop", lambda item: False)
    assert caught.value.fault.code == "overload"
    assert len(queue) == MAX_WAITING_OF_ALL + FREE_PLACES
    assert queue.overtake("nobody", "stop", lambda item: True) == []
    assert queue.take() == "stop"


def test_what_waits_is_bounded_in_bytes_too() -> None:
    """A thousand missions are a gigabyte, and a million objects for each collection to look at."""
    queue: FairQueue[str] = FairQueue(threading.Event())
    for size in (4 * MAX_BYTES, 0, 0):
        queue.put("a", "", size=size)  # the first is taken whatever it is
    with pytest.raises(
        Refused, match="of this client with 8388608 bytes wait for their tick already; at most 2097152 bytes may wait"
    ):
        queue.put("a", "", size=1)
    queue.put("b", "", size=MAX_BYTES // 2)
    with pytest.raises(Refused, match="of all clients with 9437184 bytes wait"):
        queue.put("b", "", size=MAX_BYTES // 2)
    queue.put("b", "", size=1, always=True)
    queue.put("c", "", size=MAX_BYTES)
    queue.take()
    for _ in range(1000):
        queue.take()
    assert (len(queue), queue._bytes.total()) == (0, 0)
    for n in range(2):
        queue.put("a", f"{n}", size=MAX_BYTES // 2)
    with pytest.raises(Refused):
        queue.put("a", "", size=1)
    assert queue.overtake("a", "stop", lambda item: item == "0") == ["0"]
    queue.put("a", "", size=MAX_BYTES // 2)


def test_a_pause_overtakes_and_withdraws_the_requests_of_its_client_alone() -> None:
    wake, done, told = threading.Event(), [], []
    steering = Steering(wake)
    steering.add(lambda: done.append("other"), "robots:2", lambda _: told.append("other"))
    steering.add(lambda: done.append("resume"), "robots:1", lambda _: told.append("resume"))
    steering.add(lambda: done.append("cancel"), "robots:1 (name)", always=True)
    assert wake.is_set()
    withdrawn = steering.stop(lambda: done.append("pause"), "robots:1 (name)", lambda _: told.append("pause"))
    for on_reply in withdrawn:
        on_reply(None)  # type: ignore[arg-type]
    while (each := steering.take()) is not None:
        each.action()
    assert done == ["pause", "other", "cancel"], "what nobody waits for is carried out"
    assert told == ["resume"]
