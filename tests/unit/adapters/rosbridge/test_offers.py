"""Actions that clients offer to each other."""

from __future__ import annotations

from ros_rig import flying
from rosbridge_rig import bridge, run

DOCK = {"op": "advertise_action", "action": "/dock", "type": "dock_msgs/Dock"}
GOAL = {"op": "send_action_goal", "action": "/dock", "action_type": "dock_msgs/action/Dock", "args": {"bay": 3}}


def test_a_goal_is_passed_on_and_what_is_told_of_it_comes_back():
    async def story():
        async with bridge(2) as (_, asks, acts):
            await acts.say(**DOCK)
            await acts.settle()
            assert "/dock" in (await asks.call("/rosapi/action_servers"))["values"]["action_servers"]
            assert (await asks.call("/rosapi/action_type", {"action": "/dock"}))["values"] == {
                "type": "dock_msgs/action/Dock"
            }
            await asks.say(**GOAL, id="g", feedback=True)
            goal = await acts.hear()
            key = goal.pop("id")
            assert goal == {**GOAL, "feedback": True}
            assert key != "g"
            await acts.say(op="action_feedback", id=key, action="/dock", values={"near": 0.5})
            assert await asks.hear() == {
                "op": "action_feedback", "action": "/dock", "id": "g", "values": {"near": 0.5}
            }  # fmt: skip
            await acts.say(op="action_result", id=key, action="/dock", values={"docked": True}, status=4, result=True)
            result = {"op": "action_result", "action": "/dock", "id": "g", "values": {"docked": True}}
            assert await asks.hear() == {**result, "status": 4, "result": True}
            await acts.say(op="action_result", id=key, action="/dock", values={}, status=4, result=True)
            assert "no goal of this id" in (await acts.hear())["msg"]

    run(story)


def test_who_asked_cancels_and_who_goes_cancels_too():
    async def story():
        async with bridge(2) as (_, asks, acts):
            await acts.say(**DOCK)
            await acts.settle()
            await asks.say(**GOAL, id="g")
            key = (await acts.hear())["id"]
            await asks.say(op="cancel_action_goal", action="/dock", id="g")
            assert await acts.hear() == {"op": "cancel_action_goal", "id": key, "action": "/dock"}
            await acts.say(op="action_result", id=key, action="/dock", values={}, status=5, result=True)
            assert (await asks.hear())["status"] == 5
            await asks.say(**GOAL, id="h")
            key = (await acts.hear())["id"]
            await asks.socket.close()
            assert await acts.hear() == {"op": "cancel_action_goal", "id": key, "action": "/dock"}
            await acts.say(op="action_result", id=key, action="/dock", values={}, status=5, result=True)
            await acts.settle()

    run(story)


def test_goals_of_who_goes_or_gives_up_are_aborted():
    async def story():
        async with bridge(2) as (_, asks, acts):
            for end in ("unadvertise_action", "close"):
                await acts.say(**DOCK)
                await acts.settle()
                await asks.say(**GOAL, id=end)
                await acts.hear()
                if end == "close":
                    await acts.socket.close()
                else:
                    await acts.say(op=end, action="/dock")
                told = await asks.hear()
                assert (told["id"], told["status"], told["result"]) == (end, 6, False)
                assert "not offered any more" in told["values"]
            await asks.say(**GOAL, id="late")
            assert 'no action "/dock"' in (await asks.hear())["values"]

    run(story)


def test_what_cannot_be_offered_or_asked_is_told():
    async def story():
        async with bridge(2, made=flying(), max_unanswered=1, max_subscriptions=1) as (_, asks, acts):
            await acts.say(**{**DOCK, "action": "/rov/goto"})
            assert "an action of the simulator" in (await acts.hear())["msg"]
            await acts.say(**DOCK)
            await acts.say(**{**DOCK, "action": "/other"})
            assert "there are 1 actions" in (await acts.hear())["msg"]
            await asks.say(**DOCK)
            assert "offered by another client" in (await asks.hear())["msg"]
            await asks.say(**{**GOAL, "action_type": "dock_msgs/action/Leave"}, id="a")
            assert "is of type dock_msgs/action/Dock" in (await asks.hear())["values"]
            await asks.say(**GOAL, id="a")
            key = (await acts.hear())["id"]
            await asks.say(**GOAL, id="a")
            assert "a goal of this id" in (await asks.hear())["values"]
            await asks.say(**GOAL, id="b")
            assert "are under way already" in (await asks.hear())["values"]
            await acts.say(op="action_result", id=key, action="/dock", status="fine")
            assert "status is a whole number" in (await acts.hear())["msg"]

    run(story)
