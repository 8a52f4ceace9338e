"""Actions that one client offers to the others: their goals are passed to it, and its feedback and results are passed back."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from uwserver_adapters.ros.messages.actions import ABORTED
from uwserver_adapters.rosbridge.hub import Hub
from uwserver_adapters.rosbridge.wishes import BadRequest, Map, action_name, offered_type

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
            name, args: of the goal.
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
