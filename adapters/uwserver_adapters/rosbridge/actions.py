"""Actions: goals that one client has sent to the simulator or to other clients, and actions that one client offers to the others.

The goals of an offered action are passed to its client, and its feedback and results are passed back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

from uwserver.adapter import Conversation, did_you_mean
from uwserver.ports import Progress, Reply
from uwserver_adapters.ros.messages import Action, end_of, full_name
from uwserver_adapters.ros.messages.actions import ABORTED
from uwserver_adapters.ros.messages.plain import plain
from uwserver_adapters.rosbridge.hub import Hub
from uwserver_adapters.rosbridge.wishes import Asked, BadRequest, Map, action_name, arguments, asked_of, offered_type

Answer = Callable[[Asked, Map], None]
"""Sends the answer to a request, with its id and in the form that it asked for."""


class Goals:
    """The goals of one client.

    Args:
        hub: what all clients share.
        conversation: conversation of the client.
        send: sends a message to the client.
        answer: see there.
    """

    def __init__(self, hub: Hub, conversation: Conversation, send: Callable[[Map], None], answer: Answer) -> None:
        self._hub, self._conversation, self._send, self._answer = hub, conversation, send, answer
        self._cancelled: set[object] = set()
        self._passed: dict[object, Callable[[], None]] = {}

    def begin(self, message: Map) -> None:
        """Carry out ``send_action_goal``.

        Raises:
            BadRequest, BadMessage, Refused: the goal is not accepted.
        """
        name, key, args = action_name(message), message.get("id"), message.get("args", {})
        if key is None:
            raise BadRequest("send_action_goal needs an id, which its result will have")
        actions = self._hub.feed.catalogue.actions
        action = actions.get(name)
        known = action.type if action is not None else self._hub.acting.get(name, ("",))[0]
        if not known:
            near = did_you_mean(name, actions) or f"; there are: {', '.join(sorted(actions)) or 'none'}"
            raise BadRequest(f'no action "{name[:100]}"{near}')
        kind = message.get("action_type")
        if isinstance(kind, str) and kind and full_name(kind, "action") != known:
            raise BadRequest(f'"{name}" is of type {known}, not {kind[:100]}')
        if self._conversation.is_running(("goal", key)) or key in self._passed:
            raise BadRequest("a goal of this id is under way")
        if action is None:
            self._pass_on(message, name)
            return
        goal = arguments(self._hub.types, f"{action.type}_Goal", args)
        call, asked = action.ask(goal), asked_of(message)
        progress = partial(self._progress, asked, action, goal) if message.get("feedback") is True else None
        self._conversation.call(
            call.service, call.args, partial(self._end, asked, action), key=("goal", key), progress=progress
        )

    def cancel(self, message: Map) -> None:
        """Carry out ``cancel_action_goal``; the result of the goal tells whether it came in time.

        Raises:
            BadRequest: no goal of this id is under way.
        """
        passed = self._passed.get(message.get("id"))
        if passed is not None:
            passed()
            return
        key = ("goal", message.get("id"))
        if not self._conversation.is_running(key):
            raise BadRequest(f"{action_name(message)}: no goal of this id is under way")
        self._cancelled.add(key)
        self._conversation.cancel(key)

    def _pass_on(self, message: Map, name: str) -> None:
        """Give a goal to the client that offers its action."""
        _, performer = self._hub.acting[name]
        key, asked = message["id"], asked_of(message)
        if len(self._passed) >= self._hub.config.max_unanswered:
            raise BadRequest(f"{len(self._passed)} goals of other clients' actions are under way already")

        def feedback(values: object) -> None:
            if key in self._passed:
                self._feedback(name, key, values)

        def end(status: int, values: object, result: bool) -> None:
            if self._passed.pop(key, None) is not None:
                self._result(asked, name, status, values, result)

        wants_feedback = message.get("feedback") is True
        self._passed[key] = performer.perform(name, message.get("args", {}), wants_feedback, feedback, end)

    def close(self) -> None:
        """Cancel the goals that other clients carry out for this one, which has gone."""
        passed, self._passed = self._passed, {}
        for cancel in passed.values():
            cancel()

    def refuse(self, message: Map, text: str) -> None:
        """Answer a goal that was not accepted."""
        try:
            name = action_name(message)
        except BadRequest:
            name = ""
        self._result(asked_of(message), name, 0, text, False)

    def _progress(self, asked: Asked, action: Action, goal: object, progress: Progress) -> None:
        self._feedback(action.name, asked.id, plain(self._hub.types, action.feedback(goal, progress.fraction)))

    def _feedback(self, name: str, key: object, values: object) -> None:
        self._send({"op": "action_feedback", "action": name, "id": key, "values": values})

    def _end(self, asked: Asked, action: Action, reply: Reply) -> None:
        key = ("goal", asked.id)
        status = end_of(reply.fault, key in self._cancelled)
        self._cancelled.discard(key)
        if reply.fault is not None:
            self._hub.refusals.note("goal", f"{action.name}: {reply.fault.text}")
        # As in rosbridge, a goal that failed or was cancelled has a result too, and `status` tells how it ended.
        values = plain(self._hub.types, action.result(reply.result, reply.fault))
        self._result(asked, action.name, status, values, True)

    def _result(self, asked: Asked, name: str, status: int, values: object, result: bool) -> None:
        told = {"op": "action_result", "action": name, "values": values, "status": status, "result": result}
        self._answer(asked, told)


Feedback = Callable[[object], None]
End = Callable[[int, object, bool], None]
"""Gets the status of a goal that has ended, its result or a text, and whether there is a result."""


class _Goal(NamedTuple):
    action: str
    feedback: Feedback
    end: End


class Offers:
    """The actions that one client offers.

    Args:
        hub: what all clients share.
        send: sends a message to the client.
    """

    def __init__(self, hub: Hub, send: Callable[[Map], None]) -> None:
        self._hub, self._send = hub, send
        self._goals: dict[str, _Goal] = {}
        self._last = 0

    def advertise(self, message: Map) -> None:
        """Carry out ``advertise_action``.

        Raises:
            BadRequest: the action cannot be offered.
        """
        name, kind = action_name(message), offered_type(message, "action")
        if name in self._hub.feed.catalogue.actions:
            raise BadRequest(f'"{name}" is an action of the simulator')
        known, count = self._hub.acting.get(name), len(self._names())
        if known is not None and known[1] is not self:
            raise BadRequest(f'"{name}" is offered by another client')
        if known is None and count >= self._hub.config.max_subscriptions:
            raise BadRequest(f"there are {count} actions: unadvertise_action, or raise max_subscriptions")
        self._hub.acting[name] = (kind, self)

    def _names(self) -> list[str]:
        return [name for name, (_, offers) in self._hub.acting.items() if offers is self]

    def unadvertise(self, message: Map) -> None:
        """Carry out ``unadvertise_action``; goals that are under way end."""
        self._withdraw({action_name(message)}.intersection(self._names()))

    def perform(
        self, name: str, args: object, wants_feedback: bool, feedback: Feedback, end: End
    ) -> Callable[[], None]:
        """Pass a goal to the client.

        Args:
            name, args: those of the goal.
            wants_feedback: whether `feedback` is to be called meanwhile.
            feedback: gets the values of each feedback.
            end: is called once.

        Returns:
            A function that asks the client to cancel the goal.

        Raises:
            BadRequest: too many goals wait for the client.
        """
        if len(self._goals) >= self._hub.config.max_unanswered:
            raise BadRequest(f"{name}: too many goals wait for its client")
        self._last += 1
        key = f"send_action_goal:{name}:{self._last}"
        self._goals[key] = _Goal(name, feedback, end)
        goal: Map = {"op": "send_action_goal", "id": key, "action": name, "action_type": self._hub.acting[name][0]}
        self._send({**goal, "args": args, "feedback": wants_feedback})

        def cancel() -> None:
            if key in self._goals:
                self._send({"op": "cancel_action_goal", "id": key, "action": name})

        return cancel

    def feedback(self, message: Map) -> None:
        """Carry out ``action_feedback``.

        Raises:
            BadRequest: no such goal is under way.
        """
        self._goal(message).feedback(message.get("values", {}))

    def result(self, message: Map) -> None:
        """Carry out ``action_result``.

        Raises:
            BadRequest: no such goal is under way, or its status is no status.
        """
        goal, status = self._goal(message), message.get("status", ABORTED)
        if isinstance(status, bool) or not isinstance(status, int) or not 0 <= status <= ABORTED:
            text = f"action_result: status is a whole number from 0 to {ABORTED}, as of action_msgs/GoalStatus"
            raise BadRequest(text)
        del self._goals[str(message.get("id"))]
        goal.end(status, message.get("values", {}), message.get("result") is not False)

    def _goal(self, message: Map) -> _Goal:
        goal = self._goals.get(str(message.get("id")))
        if goal is None:
            raise BadRequest(f"{message.get('op')}: no goal of this id is under way")
        return goal

    def _withdraw(self, names: Iterable[str]) -> None:
        """Offer these actions no more, and abort their goals."""
        for name in names:
            del self._hub.acting[name]
            for key in [key for key, goal in self._goals.items() if goal.action == name]:
                self._goals.pop(key).end(ABORTED, f"{name} is not offered any more", False)

    def close(self) -> None:
        """Withdraw all actions of the client, which has gone."""
        self._withdraw(self._names())
