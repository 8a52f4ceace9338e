"""Commands and calls of one peer: one answer each, limits, cancel, time-out, and a peer that leaves in the middle."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from uwserver.adapter import Conversation, InFlightLimit
from uwserver.adapter.conversation import STOPS
from uwserver.ports import Progress, Refused, Reply
from uwserver.testing import FakeContext

LONG = "world/run_until"
U = {"u": [0.0] * 8}


class Talk:
    """A conversation and what it heard."""

    def __init__(self, in_flight: InFlightLimit | None = None) -> None:
        self.context = FakeContext(held={LONG})
        self.conversation = Conversation(self.context, "peer 1", in_flight)
        self.replies: list[Reply] = []
        self.progress: list[Progress] = []

    def call(self, service: str = LONG, **options: Any) -> None:
        args = {"t_s": 5.0} if service == LONG else {}
        self.conversation.call(service, args, self.replies.append, progress=self.progress.append, **options)

    @property
    def codes(self) -> list[str]:
        return [reply.fault.code if reply.fault is not None else "" for reply in self.replies]


def within_loop(scene: Callable[[Talk], Coroutine[Any, Any, None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(scene(Talk()), 120)

    asyncio.run(bounded())


def test_a_command_has_one_answer_and_a_source():
    async def scene(talk: Talk) -> None:
        talk.conversation.command("rov/thrusters", U, talk.replies.append)
        talk.conversation.command("rov/thrusters", U, talk.replies.append, source="another")
        talk.conversation.command("rov/thrusters", U)
        assert talk.conversation.in_flight.count == 3
        await asyncio.sleep(0)
        assert talk.codes == ["", ""]
        assert [command.source for command in talk.context.commands] == ["peer 1", "another", "peer 1"]
        assert talk.context.stats.commands == 3
        assert talk.conversation.in_flight.count == 0

    within_loop(scene)


def test_what_only_reads_is_answered_at_once():
    async def scene(talk: Talk) -> None:
        talk.call("world/status", key=1)
        assert talk.codes == [""]
        assert not talk.conversation.is_running(1)
        assert talk.conversation.in_flight.count == 0

    within_loop(scene)


@pytest.mark.parametrize("service", ["world/nothing", "world/status"])
def test_what_is_refused_or_fails_is_not_owed(service: str):
    async def scene(talk: Talk) -> None:
        talk.context.scripts["world/status"] = lambda _: 1 / 0
        with pytest.raises((Refused, ZeroDivisionError)):
            talk.call(service, key=1)
        with pytest.raises(Refused):
            talk.conversation.command("rov/imu", U, talk.replies.append)
        assert talk.conversation.in_flight.count == 0
        assert not talk.conversation.is_running(1)
        assert talk.replies == []

    within_loop(scene)


def test_a_stop_has_places_of_its_own_when_too_many_wait():
    async def scene(_: Talk) -> None:
        talk = Talk(InFlightLimit(1))
        talk.call(key=1)
        for _ in range(STOPS):
            talk.conversation.call("world/pause", {}, talk.replies.append)
        with pytest.raises(Refused) as caught:
            talk.conversation.call("world/pause", {}, talk.replies.append)
        assert caught.value.fault.code == "overload"

    within_loop(scene)


def test_too_many_wait_also_when_conversations_share_the_limit():
    async def scene(_: Talk) -> None:
        in_flight = InFlightLimit(2)
        first, second = Talk(in_flight), Talk(in_flight)
        first.call(key=1)
        second.call(key=1)
        for talk in (first, second):
            with pytest.raises(Refused) as caught:
                talk.call()
            assert caught.value.fault.code == "overload"
            with pytest.raises(Refused):
                talk.conversation.command("rov/thrusters", U)
        first.context.calls[0].finish(Reply(1, 4))
        second.call()
        assert in_flight.count == 2

    within_loop(scene)


def test_a_call_is_cancelled_by_its_key():
    async def scene(talk: Talk) -> None:
        for key in ("a", "b", "b", None):
            talk.call(key=key)
        assert talk.conversation.cancel("a")
        assert talk.codes == ["preempted"]
        assert not talk.conversation.cancel("a")
        assert not talk.conversation.cancel(None), "a call without a key cannot be cancelled"
        assert talk.conversation.cancel("b")
        assert talk.codes == ["preempted"] * 3
        assert talk.conversation.in_flight.count == 1

    within_loop(scene)


def test_progress_is_told_until_the_answer():
    async def scene(talk: Talk) -> None:
        talk.call()
        (call,) = talk.context.calls
        call.progress(0.5)
        call.finish(Reply(1, 4))
        call.progress(0.9)
        assert [progress.fraction for progress in talk.progress] == [0.5]

    within_loop(scene)


def test_a_call_that_takes_too_long_is_cancelled_and_says_so():
    async def scene(talk: Talk) -> None:
        talk.call(timeout_s=0.01, advice="ask again tomorrow")
        talk.call(timeout_s=1000.0)
        while not talk.replies:
            await asyncio.sleep(0.001)
        (fault,) = [reply.fault for reply in talk.replies]
        assert fault is not None
        assert (fault.code, fault.where) == ("timeout", LONG)
        assert fault.text == "not done within 0.01 s and therefore cancelled: ask again tomorrow"
        assert talk.context.calls[0].is_done
        assert not talk.context.calls[1].is_done

    within_loop(scene)


def test_who_cannot_be_cancelled_in_time_is_answered_all_the_same_once():
    async def scene(talk: Talk) -> None:
        real = talk.context.call

        def call(*args: Any) -> Callable[[], bool]:
            real(*args)
            return lambda: False

        talk.context.call = call  # type: ignore[method-assign]
        talk.call(timeout_s=0.0)
        while not talk.replies:
            await asyncio.sleep(0)
        talk.context.calls[0].finish(Reply(9, 9))
        assert talk.codes == ["timeout"]
        assert talk.conversation.in_flight.count == 0

    within_loop(scene)


def test_who_leaves_ends_its_long_calls_and_hears_nothing_more():
    async def scene(talk: Talk) -> None:
        talk.context.held.add("world/pause")
        talk.conversation.join("pilot")
        talk.call(timeout_s=0.0)
        talk.call("world/pause")
        talk.conversation.command("rov/thrusters", U, talk.replies.append)
        assert talk.context.joined == ["pilot"]
        talk.conversation.close()
        assert talk.context.joined == []
        assert [call.is_done for call in talk.context.calls] == [True, False], "what was commanded stands"
        talk.context.calls[1].finish(Reply(1, 4))
        await asyncio.sleep(0.01)
        assert talk.replies == []
        assert talk.progress == []
        assert talk.conversation.in_flight.count == 0

    within_loop(scene)


def test_who_grants_no_ticks_any_more_may_still_hear():
    async def scene(talk: Talk) -> None:
        talk.conversation.join("pilot")
        talk.conversation.leave()
        talk.conversation.leave()
        assert talk.context.joined == []
        assert talk.conversation.client == "pilot"
        talk.call()
        talk.conversation.end_calls()
        assert talk.codes == ["preempted"], "its calls can be ended alone; they are answered"
        talk.conversation.join("again")
        talk.conversation.join("and again")
        assert talk.context.joined == ["and again"]

    within_loop(scene)


def test_a_peer_that_sends_nothing_more_starts_nothing_that_takes_long():
    async def scene(talk: Talk) -> None:
        talk.call()
        talk.conversation.half_close()
        talk.call()
        talk.call("world/pause")
        await asyncio.sleep(0)
        assert talk.codes == ["preempted", "preempted", ""]

    within_loop(scene)


def test_several_calls_are_answered_together_in_their_order():
    async def scene(talk: Talk) -> None:
        answers: list[list[str]] = []
        calls = [(LONG, {"t_s": 5.0}), ("world/paus", {}), ("world/pause", {})]
        talk.conversation.call_all(
            calls, lambda replies: answers.append([r.fault.code if r.fault else "" for r in replies])
        )
        await asyncio.sleep(0)
        assert answers == []
        talk.context.calls[0].finish(Reply(1, 4))
        await asyncio.sleep(0)
        assert answers == [["", "unknown_service", ""]]
        talk.conversation.call_all([], lambda replies: answers.append(list(replies)))
        assert answers[1] == []

    within_loop(scene)
