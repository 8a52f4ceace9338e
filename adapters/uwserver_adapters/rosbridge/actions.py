"""Goals that one client has sent: to actions of the simulator, and to those of other clients."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial

from uwserver.adapter import Conversation, did_you_mean
from uwserver.ports import Progress, Reply
from uwserver_adapters.ros.messages.actions import Action, end_of
from uwserver_adapters.ros.messages.plain import built, plain
from uwserver_adapters.ros.messages.types import full_name
from uwserver_adapters.rosbridge.hub import Hub
from uwserver_adapters.rosbridge.subscriptions import Wish
from uwserver_adapters.rosbridge.wishes import Map, Wrong, action_name, answerable, wish_of

Send = Callable[[Map, Wish], None]
"""Sends a message in the form that was wished for."""


class Goals:
    """Of one client.

    Args:
        hub: what all clients share.
        conversation: of the client.
        send: see there.
    """

    def __init__(self, hub: Hub, conversation: Conversation, send: Send) -> None:
        self._hub, self._conversation, self._send = hub, conversation, send
        self._cancelled: set[object] = set()
        self._passed: dict[object, Callable[[], None]] = {}

    def begin(self, message: Map) -> None:
        """An operation ``send_action_goal``.

        Raises:
            Wrong, BadMessage, Refused: the goal is not taken.
        """
        name, key, args = action_name(message), message.get("id"), message.get("args", {})
        if key is None:
            raise Wrong("send_action_goal needs an id, which its result will have")
        actions = self._hub.feed.catalogue.actions
        action = actions.get(name)
        known = action.type if action is not None else self._hub.acting.get(name, ("",))[0]
        if not known:
            near = did_you_mean(name, actions) or f"; there are: {', '.join(sorted(actions)) or 'none'}"
            raise Wrong(f'no action "{name[:100]}"{near}')
        kind = message.get("action_type")
        if isinstance(kind, str) and kind and full_name(kind, "action") != known:
            raise Wrong(f'"{name}" is of type {known}, not {kind[:100]}')
        if self._conversation.is_running(("goal", key)) or key in self._passed:
            raise Wrong("a goal of this id is under way")
        if action is None:
            self._pass_on(message, name)
            return
        types, what = self._hub.types, f"{action.type}_Goal"
        if isinstance(args, list):
            args = dict(zip((field for field, _ in types.fields(what)), args, strict=False))
        goal = built(types, what, args or {})
        asked = action.ask(goal)
        kept = {**answerable(message), "action": name}
        progress = partial(self._progress, kept, action, goal) if message.get("feedback") is True else None
        self._conversation.call(
            asked.service, asked.args, partial(self._end, kept, action), key=("goal", key), progress=progress
        )

    def cancel(self, message: Map) -> None:
        """An operation ``cancel_action_goal``; the result of the goal tells whether it came in time.

        Raises:
            Wrong: no goal of this id is under way.
        """
        passed = self._passed.get(message.get("id"))
        if passed is not None:
            passed()
            return
        key = ("goal", message.get("id"))
        if not self._conversation.is_running(key):
            raise Wrong(f"{action_name(message)}: no goal of this id is under way")
        self._cancelled.add(key)
        self._conversation.cancel(key)

    def _pass_on(self, message: Map, name: str) -> None:
        """Give a goal to the client that offers its action."""
        _, performer = self._hub.acting[name]
        key, kept = message["id"], {**answerable(message), "action": name}
        if len(self._passed) >= self._hub.config.max_unanswered:
            raise Wrong(f"{len(self._passed)} goals of other clients' actions are under way already")

        def feedback(values: object) -> None:
            if key in self._passed:
                self._send({"op": "action_feedback", "action": name, "id": key, "values": values}, Wish())

        def end(status: int, values: object, result: bool) -> None:
            if self._passed.pop(key, None) is not None:
                self._result(kept, status, values, result)

        wants_feedback = message.get("feedback") is True
        self._passed[key] = performer.perform(name, message.get("args", {}), wants_feedback, feedback, end)

    def close(self) -> None:
        """The client has gone: whoever works for it is asked to stop."""
        passed, self._passed = self._passed, {}
        for cancel in passed.values():
            cancel()

    def refuse(self, message: Map, text: str) -> None:
        """Tell that a goal was not taken."""
        name = ""
        with contextlib.suppress(Wrong):
            name = action_name(message)
        self._result({**answerable(message), "action": name}, 0, text, False)

    def _progress(self, message: Map, action: Action, goal: object, progress: Progress) -> None:
        told = plain(self._hub.types, action.feedback(goal, progress.fraction))
        self._send({"op": "action_feedback", "action": message["action"], "id": message["id"], "values": told}, Wish())

    def _end(self, message: Map, action: Action, reply: Reply) -> None:
        key = ("goal", message["id"])
        status = end_of(reply.fault, key in self._cancelled)
        self._cancelled.discard(key)
        if reply.fault is not None:
            self._hub.refusals.note("goal", f"{action.name}: {reply.fault.text}")
        # As rosbridge has it: a goal that failed or was cancelled has a result, too, and `status` tells how it ended.
        self._result(message, status, plain(self._hub.types, action.result(reply.result, reply.fault)), True)

    def _result(self, message: Map, status: int, values: object, result: bool) -> None:
        wish = Wish()
        with contextlib.suppress(Wrong):
            wish = wish_of(message)
        told: Map = {
            "op": "action_result",
            "action": message["action"],
            "values": values,
            "status": status,
            "result": result,
        }
        if message.get("id") is not None:
            told["id"] = message["id"]
        self._send(told, wish)
