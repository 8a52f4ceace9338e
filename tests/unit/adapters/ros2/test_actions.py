"""The three services and two topics of an action, without a transport: goals, their ends, and what is refused."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from ros2_rig import Rig, Wire, story
from ros_rig import flying
from uwserver_adapters.ros.messages import Types
from uwserver_adapters.ros2.actions import GOALS
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.ros2.node import Node

from uwserver.adapter import Refusals
from uwserver.ports import Fault, Reply

GOTO, SEND = "uwserver_msgs/action/Goto", "uwserver_msgs/action/Goto_SendGoal"
RESULT, CANCEL = "uwserver_msgs/action/Goto_GetResult", "action_msgs/srv/CancelGoal"
EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 2, 3, 4, 5, 6


class Goals(Rig):
    """What a client does with `/rov/goto`."""

    def uuid(self, number):
        made = np.full(16, number, np.uint8)
        return self.types.make("unique_identifier_msgs/msg/UUID", uuid=made)

    def goal(self, number=1, x=1.0):
        pose = self.types.make("geometry_msgs/msg/Pose", position=self.types.point((x, 2.0, -3.0)))
        made = self.types.make("geometry_msgs/msg/PoseStamped", pose=pose)
        return {"goal_id": self.uuid(number), "goal": self.types.make(f"{GOTO}_Goal", pose=made)}

    def send(self, number=1):
        (answer,) = self.wire.call("/rov/goto/_action/send_goal", **self.goal(number))
        return answer

    def result(self, number=1):
        return self.wire.call("/rov/goto/_action/get_result", goal_id=self.uuid(number))

    def cancel(self, number=0, stamp=0):
        info = self.types.make("action_msgs/msg/GoalInfo", goal_id=self.uuid(number), stamp=self.types.stamp(stamp))
        (answer,) = self.wire.call("/rov/goto/_action/cancel_goal", goal_info=info)
        return answer

    @property
    def statuses(self):
        return [one.status for one in self.wire.of("/rov/goto/_action/status")[-1].status_list]

    @property
    def running(self):
        return [call for call in self.world.calls if call.service == "rov/autopilot/goto" and not call.is_done]


@story(Goals)
def test_a_goal_is_accepted_tells_where_it_is_and_ends(rig):
    answer = rig.send()
    assert (answer.accepted, rig.statuses) == (True, [EXECUTING])
    assert rig.running[0].args["position_ned_m"] == [2.0, 1.0, 3.0]
    waits = rig.result()
    assert waits == []
    rig.running[0].progress(0.25)
    assert rig.wire.of("/rov/goto/_action/feedback") == []  # nobody listens
    rig.wire.heard["/rov/goto/_action/feedback"]("/rov/goto/_action/feedback", True)
    rig.running[0].progress(0.5)
    (told,) = rig.wire.of("/rov/goto/_action/feedback")
    assert (told.feedback.progress, told.goal_id.uuid.tolist()) == (0.5, [1] * 16)
    rig.running[0].finish(Reply(5, 20, {"distance_m": 0.1}))
    for answers in (waits, rig.result()):  # who waited, and who comes later
        (one,) = answers
        assert (one.status, one.result.success, one.result.distance) == (SUCCEEDED, True, 0.1)
    assert rig.statuses == [SUCCEEDED]
    assert rig.result(9)[0].status == 0


@story(Goals)
def test_a_goal_that_the_world_ends_is_aborted_and_says_why(rig):
    rig.send()
    rig.running[0].finish(Reply(5, 20, fault=Fault("denied", "the autopilot is not armed")))
    (told,) = rig.result()
    assert (told.status, told.result.success, told.result.message) == (ABORTED, False, "the autopilot is not armed")


@story(Goals)
def test_goals_are_cancelled_by_id(rig):
    rig.send(1)
    rig.send(2)
    answer = rig.cancel(2)
    assert (answer.return_code, [one.goal_id.uuid[0] for one in answer.goals_canceling]) == (0, [2])
    assert rig.statuses == [EXECUTING, CANCELED]
    assert rig.result(2)[0].result.message == "cancelled by its caller"
    assert rig.cancel(2).return_code == 3  # it has ended
    assert rig.cancel(7).return_code == 2  # there is none
    assert len(rig.running) == 1


@story(Goals)
def test_goals_are_cancelled_all_or_until_a_time(rig):
    times = iter((10**9, 2 * 10**9, 3 * 10**9))
    rig.node.feed.now_ns = lambda: next(times)
    for number in (1, 2, 3):
        rig.send(number)
    assert len(rig.cancel(stamp=2 * 10**9).goals_canceling) == 2
    assert rig.statuses == [CANCELED, CANCELED, EXECUTING]
    assert [one.goal_id.uuid[0] for one in rig.cancel().goals_canceling] == [3]
    assert rig.cancel().return_code == 0  # none is left, and none was asked for by name


@story(Goals)
def test_what_cannot_be_done_is_not_accepted(rig):
    fields = rig.goal()
    fields["goal"].speed = float("nan")
    bad = [
        rig.wire.call("/rov/goto/_action/send_goal", data=b"\0\1\0\0\1\2"),
        rig.wire.call("/rov/goto/_action/send_goal", **fields),
        rig.wire.call("/rov/goto/_action/send_goal", **rig.goal(x=1e300)),
    ]
    assert [(answer.accepted,) for (answer,) in bad] == [(False,)] * 3
    assert rig.world.calls == [] or all(call.service == "world/status" for call in rig.world.calls)
    assert rig.world.stats.details["refused"] == {"message": 1, "goal": 2}
    assert rig.send().accepted
    assert not rig.send().accepted  # the same once more
    (lost,) = rig.wire.call("/rov/goto/_action/get_result", data=b"")
    assert lost.status == 0
    (lost,) = rig.wire.call("/rov/goto/_action/cancel_goal", data=b"")
    assert lost.return_code == 1


@story(Goals)
def test_what_is_remembered_is_bounded(rig):
    for number in range(1, GOALS + 1):
        assert rig.send(number).accepted
    assert not rig.send(GOALS + 1).accepted
    for call in rig.running:
        call.finish(Reply(1, 1, {}))
    for number in range(GOALS + 1, GOALS + 4):
        rig.send(number)
        rig.running[0].finish(Reply(1, 1, {}))
    assert len(rig.statuses) == GOALS
    assert rig.result(1)[0].status == 0
    assert rig.result(GOALS + 3)[0].status == SUCCEEDED


@story(Goals)
def test_actions_come_and_go_with_the_world(rig):
    assert {name for name in rig.wire.services if "/goto/_action/" in name} == {
        f"/rov/goto/_action/{part}" for part in ("send_goal", "cancel_goal", "get_result")
    }
    rig.world.services = {path: service for path, service in rig.world.services.items() if path != "rov/autopilot/goto"}
    rig.node.feed.begin()
    assert not [name for name in (*rig.wire.services, *rig.wire.heard) if "/rov/goto/" in name]
    assert "/rov/mission/_action/status" in rig.wire.heard


@pytest.mark.parametrize("offers", [False, True])
def test_a_node_without_services_has_no_actions(offers):
    async def told():
        world, types = flying(), Types()
        wire = Wire(types)
        refusals = Refusals("ros2", world.stats, asyncio.get_running_loop().time)
        made = Node(world, Ros2Config(domain=0, services=offers), refusals, wire, types)
        made.feed.begin()
        assert bool(wire.services) == offers
        await made.close()

    asyncio.run(told())
