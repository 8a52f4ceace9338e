"""Actions that one client offers to the others: goals are passed to it, and what it tells of them is passed back."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from uwserver_adapters.ros.messages.actions import ABORTED
from uwserver_adapters.ros.messages.types import full_name
from uwserver_adapters.rosbridge.hub import Hub
from uwserver_adapters.rosbridge.wishes import LONGEST_NAME, Map, Wrong, action_name

Feedback = Callable[[object], None]
End = Callable[[int, object, bool], None]
"""Gets the status with which a goal has ended, its result or a text, and whether there is a result."""


class _Goal(NamedTuple):
    action: str
    feedback: Feedback
    end: End


class Offers:
    """Of one client.

    Args:
        hub: what all clients share.
        send: sends a message to the client.
    """

    def __init__(self, hub: Hub, send: Callable[[Map], None]) -> None:
        self._hub, self._send = hub, send
        self._goals: dict[str, _Goal] = {}
        self._last = 0

    def advertise(self, message: Map) -> None:
        """An operation ``advertise_action``.

        Raises:
            Wrong: it cannot be offered.
        """
        name, kind = action_name(message), message.get("type")
        if not isinstance(kind, str) or not 0 < len(kind) <= LONGEST_NAME:
            raise Wrong(f'advertise_action needs a "type" of at most {LONGEST_NAME} characters')
        if name in self._hub.feed.catalogue.actions:
            raise Wrong(f'"{name}" is an action of the simulator')
        known = self._hub.acting.get(name)
        if known is not None and known[1] is not self:
            raise Wrong(f'"{name}" is offered by another client')
        if known is None and self._count() >= self._hub.config.max_subscriptions:
            raise Wrong(f"there are {self._count()} actions: unadvertise_action, or raise max_subscriptions")
        self._hub.acting[name] = (full_name(kind, "action"), self)

    def _count(self) -> int:
        return sum(offers is self for _, offers in self._hub.acting.values())

    def unadvertise(self, message: Map) -> None:
        """An operation ``unadvertise_action``; goals that are under way end."""
        name = action_name(message)
        _, offers = self._hub.acting.get(name, ("", None))
        if offers is self:
            del self._hub.acting[name]
            self._abort([key for key, goal in self._goals.items() if goal.action == name])

    def perform(
        self, name: str, args: object, wants_feedback: bool, feedback: Feedback, end: End
    ) -> Callable[[], None]:
        """Pass a goal to the client; gives what asks it to cancel that.

        Args:
            name, args: of the goal.
            wants_feedback: whether `feedback` is to be called meanwhile.
            end: is called once.

        Raises:
            Wrong: too many goals wait for it.
        """
        if len(self._goals) >= self._hub.config.max_unanswered:
            raise Wrong(f"{name}: too many goals wait for its client")
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
        """An operation ``action_feedback``.

        Raises:
            Wrong: no such goal is under way.
        """
        self._goal(message).feedback(message.get("values", {}))

    def result(self, message: Map) -> None:
        """An operation ``action_result``.

        Raises:
            Wrong: no such goal is under way, or its status is no number.
        """
        goal, status = self._goal(message), message.get("status", ABORTED)
        if isinstance(status, bool) or not isinstance(status, int) or not 0 <= status <= ABORTED:
            raise Wrong(f"action_result: status is a whole number from 0 to {ABORTED}, as of action_msgs/GoalStatus")
        del self._goals[str(message.get("id"))]
        goal.end(status, message.get("values", {}), message.get("result") is not False)

    def _goal(self, message: Map) -> _Goal:
        goal = self._goals.get(str(message.get("id")))
        if goal is None:
            raise Wrong(f"{message.get('op')}: no goal of this id is under way")
        return goal

    def _abort(self, keys: list[str]) -> None:
        for key in keys:
            goal = self._goals.pop(key)
            goal.end(ABORTED, f"{goal.action} is not offered any more", False)

    def close(self) -> None:
        """The client has gone, and all that it offered."""
        for name in [name for name, (_, offers) in self._hub.acting.items() if offers is self]:
            del self._hub.acting[name]
        self._abort(list(self._goals))
