"""Actions of the node. Each consists of three services and two topics, as rcl_action lays them out. Loop thread."""

from __future__ import annotations

from functools import partial
from typing import Any

from uwserver.ports import Progress, Refused, Reply
from uwserver_adapters.ros.messages import CANCELING, EXECUTING, Action, BadMessage, end_of
from uwserver_adapters.ros2.carrier import Answer, Host, serve

GOALS = 64
"""Most goals of an action that are under way at once. As many that have ended are remembered; the oldest is forgotten first."""
WAITERS = 16
"""Most clients that wait for the result of one goal."""
_NONE, _REJECTED, _UNKNOWN, _TERMINATED = 0, 1, 2, 3
"""Return codes of action_msgs/CancelGoal."""
_CANCEL = "action_msgs/srv/CancelGoal"
_STATUS = "action_msgs/msg/GoalStatusArray"


class _Goal:
    """One goal.

    Attributes:
        info: action_msgs/GoalInfo.
        goal: the message.
        status: status of action_msgs/GoalStatus.
        result: the result message; None until the goal has ended.
        waiters: answer clients that wait for the result.
    """

    def __init__(self, info: Any, goal: Any) -> None:
        self.info, self.goal = info, goal
        self.status = EXECUTING
        self.result: object | None = None
        self.waiters: list[Answer] = []


class ActionServer:
    """Serves one action.

    Args:
        node: its node.
        action: its name and type.
    """

    def __init__(self, node: Host, action: Action) -> None:
        self._node, self._name, self._type = node, action.name, action.type
        self._goals: dict[bytes, _Goal] = {}
        self._is_heard = False
        below, carrier = f"{action.name}/_action/", node.carrier
        self._feedback_topic, self._status_topic = below + "feedback", below + "status"
        self._feedback = carrier.advertise(self._feedback_topic, f"{action.type}_FeedbackMessage", False, self._hearing)
        self._status = carrier.advertise(self._status_topic, _STATUS, True, lambda *_: None)
        self._ends = [
            serve(node, below + "send_goal", f"{action.type}_SendGoal", self._send_goal),
            serve(node, below + "get_result", f"{action.type}_GetResult", self._get_result),
            serve(node, below + "cancel_goal", _CANCEL, self._cancel_goal, return_code=_REJECTED),
        ]

    def _hearing(self, _: str, is_heard: bool) -> None:
        self._is_heard = is_heard

    # -- goals ------------------------------------------------------------------------------------------------------------------------------

    def _send_goal(self, request: Any, answer: Answer) -> None:
        stamp, key = self._node.types.stamp(self._node.feed.now_ns()), request.goal_id.uuid.tobytes()
        try:
            self._begin(key, request, stamp)
        except (BadMessage, Refused) as wrong:
            self._node.refuse("goal", f"{self._name}: {wrong}")
            answer(accepted=False, stamp=stamp)
            return
        answer(accepted=True, stamp=stamp)
        self._tell_status()

    def _begin(self, key: bytes, request: Any, stamp: Any) -> None:
        """Start a goal in the world.

        Raises:
            BadMessage, Refused: it is not started.
        """
        node, action = self._node, self._node.feed.catalogue.actions.get(self._name)
        if action is None:
            raise BadMessage("it is not there any more")
        if key in self._goals:
            raise BadMessage("a goal of this id was sent before")
        if sum(goal.result is None for goal in self._goals.values()) >= GOALS:
            raise BadMessage(f"{GOALS} goals are under way")
        asked = action.ask(request.goal)
        info = node.types.make("action_msgs/msg/GoalInfo", goal_id=request.goal_id, stamp=stamp)
        goal = self._goals[key] = _Goal(info, request.goal)
        try:
            node.conversation.call(
                asked.service, asked.args, partial(self._end, action, goal), key=(self._name, key),
                progress=partial(self._progress, action, goal),
            )  # fmt: skip
        except Refused:
            del self._goals[key]
            raise

    def _progress(self, action: Action, goal: _Goal, progress: Progress) -> None:
        if self._is_heard:
            types = self._node.types
            told = types.make(
                f"{self._type}_FeedbackMessage", goal_id=goal.info.goal_id, feedback=action.feedback(goal.goal, progress.fraction)
            )  # fmt: skip
            self._node.send(self._feedback_topic, self._feedback, types.cdr(told))

    def _end(self, action: Action, goal: _Goal, reply: Reply) -> None:
        goal.status = end_of(reply.fault, goal.status == CANCELING)
        goal.result = action.result(reply.result, reply.fault)
        waiters, goal.waiters = goal.waiters, []
        for answer in waiters:
            answer(status=goal.status, result=goal.result)
        over = [key for key, one in self._goals.items() if one.result is not None]
        for key in over[: max(len(over) - GOALS, 0)]:
            del self._goals[key]
        self._tell_status()

    def _get_result(self, request: Any, answer: Answer) -> None:
        goal = self._goals.get(request.goal_id.uuid.tobytes())
        if goal is None or len(goal.waiters) >= WAITERS:
            answer()  # status unknown
        elif goal.result is None:
            goal.waiters.append(answer)
        else:
            answer(status=goal.status, result=goal.result)

    def _cancel_goal(self, request: Any, answer: Answer) -> None:
        """Cancel as action_msgs/CancelGoal defines it: one goal, all that were accepted until a time, or all.

        An id of zeros names no goal, and a stamp of 0 gives no time.
        """
        key, until = request.goal_info.goal_id.uuid.tobytes(), _ns(request.goal_info.stamp)
        named = self._goals.get(key)
        if any(key):
            chosen = [(key, named)] if named is not None else []
        else:
            chosen = list(self._goals.items()) if not until else []
        if until:
            chosen += [(k, g) for k, g in self._goals.items() if g is not named and _ns(g.info.stamp) <= until]
        running = [(k, goal) for k, goal in chosen if goal.result is None]
        code = _NONE
        if not running and any(key):
            code = _UNKNOWN if named is None else _TERMINATED
        for _, goal in running:
            goal.status = CANCELING
        answer(return_code=code, goals_canceling=[goal.info for _, goal in running])
        if running:
            self._tell_status()
        for k, _ in running:
            self._node.conversation.cancel((self._name, k))

    def _tell_status(self) -> None:
        types = self._node.types
        told = [
            types.make("action_msgs/msg/GoalStatus", goal_info=goal.info, status=goal.status)
            for goal in self._goals.values()
        ]
        self._node.send(self._status_topic, self._status, types.cdr(types.make(_STATUS, status_list=told)))

    def close(self) -> None:
        """End the action. Goals that it has started go on to their end, which is not published."""
        for end in (*self._ends, self._feedback.close, self._status.close):
            end()


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
