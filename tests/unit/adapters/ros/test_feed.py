"""The feed of a ROS graph: where sensors sit is known before the first message, and what is not heard is not made."""

from __future__ import annotations

import asyncio

from msgspec import structs
from ros_rig import PORTS, context, sample
from uwserver_adapters.ros.feed import Feed
from uwserver_adapters.ros.messages import Facts, Types

from uwserver.ports import BodyView, Event, Sample, SensorView
from uwserver.testing.fake_context import FakeContext


def mounted(made, likes=("rov",), answers=True):
    """A world that knows where its sensors sit: of those that are like these; and answers a look, or does not."""

    class World(FakeContext):
        def scene(self, cast):
            for body in cast.vehicles:
                if body.like not in likes:
                    raise KeyError(body.like)
            sensor = SensorView("rov/imu", "imu", (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0))
            scene = super().scene(cast)
            return structs.replace(scene, vehicles=(BodyView("rov", "x", "rov", (), sensors=(sensor,)),))

        def look(self, on_state, source=""):
            if answers:
                super().look(on_state, source)

    return World(ports=made.ports, services=made.services)


def run(story):
    return asyncio.run(asyncio.wait_for(story(), 20))


def heard_of(world, *topics):
    told = []
    feed = Feed(world, Types(), Facts(), lambda topic, message: told.append((topic, message)))
    feed.begin()
    world.attach(feed)
    for topic in topics:
        feed.hear(topic)
    return feed, told


def test_mounts_are_known_before_the_first_tick():
    """Adapters start before the world runs: a look would not be answered, and hold up the start."""

    async def story():
        world = mounted(context(), answers=False)
        feed, told = heard_of(world, "/rov/imu")
        world.put([sample(PORTS["rov/imu"])])
        assert told[0][1].message.header.frame_id == "rov/imu"
        assert [t.child_frame_id for t in feed.catalogue.tf_static.transforms] == ["rov/imu", "rov/odom"]

    run(story)


def test_a_copy_that_was_spawned_is_asked_for():
    async def story():
        world = mounted(context(), likes=())
        feed, _ = heard_of(world)
        assert feed.catalogue.facts.mounts == {}
        await feed.close()

    run(story)


def test_nothing_is_made_for_nobody():
    async def story():
        world = mounted(context())
        feed, told = heard_of(world)
        assert world.wanted == frozenset()
        feed.hear("/rov/imu/temperature")
        feed.hear("/rov/imu/temperature")
        assert world.wanted == {"rov/imu"}
        world.put([sample(PORTS["rov/imu"]), sample(PORTS["rov/depth"])])
        assert [topic for topic, _ in told] == ["/rov/imu/temperature"]
        feed.leave("/rov/imu/temperature")
        assert world.wanted == {"rov/imu"}
        feed.leave("/rov/imu/temperature")
        assert world.wanted == frozenset()

    run(story)


def test_odometry_waits_for_both_of_its_ports():
    async def story():
        world = mounted(context())
        _, told = heard_of(world, "/rov/truth/odom")
        pose, velocity = sample(PORTS["rov/truth/pose"]), sample(PORTS["rov/truth/velocity"])
        world.put([pose])
        assert told == []
        world.put([velocity])
        assert len(told) == 1
        world.put([Sample(pose.port, 9, pose.t_ns + 5, pose.t_ns + 5, True, pose.value)])
        assert len(told) == 1  # a pose of another time than the velocity's

    run(story)


def test_numbers_that_a_type_cannot_hold_cost_that_message_alone():
    async def story():
        world = mounted(context())
        _, told = heard_of(world, "/rov/battery")
        world.put([sample(PORTS["rov/battery"], voltage=1e300), sample(PORTS["rov/battery"])])
        assert [message.raw is None for _, message in told] == [True, False]

    run(story)


def test_after_a_reset_nothing_old_is_told_to_late_comers():
    async def story():
        world = mounted(context())
        feed, _ = heard_of(world, "/rov/mode")
        world.put([sample(PORTS["rov/autopilot/state"])])
        assert feed.hear("/rov/mode") is not None
        world.say(Event("reset", 0, 0, "again"))
        assert feed.hear("/rov/mode") is None
        assert feed.hear("/tf_static") is not None

    run(story)
