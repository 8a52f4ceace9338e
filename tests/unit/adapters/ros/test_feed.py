"""The feed of a ROS graph: where sensors sit is known before the first message, and what is not heard is not made."""

from __future__ import annotations

import asyncio
from dataclasses import replace

from msgspec import structs
from ros_rig import PORTS, context, sample
from uwserver_adapters.ros.feed import Feed
from uwserver_adapters.ros.messages import Facts, Types

from uwserver.adapter import Refusals
from uwserver.ports import BodyView, Event, Sample, SensorView
from uwserver.testing.fake_context import FakeContext


def mounted(made, likes=("rov",), answers=True):
    """A world that knows where its sensors sit: of those that are like these; and answers a request for the scene, or does not."""

    class World(FakeContext):
        def scene(self, entities):
            for body in entities.vehicles:
                if body.like not in likes:
                    raise KeyError(body.like)
            sensor = SensorView("rov/imu", "imu", (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), message="Imu")
            scene = super().scene(entities)
            return structs.replace(scene, vehicles=(BodyView("rov", "x", "rov", (), sensors=(sensor,)),))

        def request_scene_state(self, on_state, source=""):
            if answers:
                super().request_scene_state(on_state, source)

    return World(ports=made.ports, services=made.services)


def run(story):
    return asyncio.run(asyncio.wait_for(story(), 120))


def heard_of(world, *topics):
    told = []
    refusals = Refusals("ros", world.stats, asyncio.get_running_loop().time)
    feed = Feed(world, refusals, Types(), Facts(), lambda topic, message: told.append((topic, message)))
    feed.begin()
    world.attach(feed)
    for topic in topics:
        feed.hear(topic)
    return feed, told


def test_mounts_are_known_before_the_first_tick():
    """Adapters start before the world runs: a request would not be answered, and hold up the start."""

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
        assert world.subscriptions == frozenset()
        feed.hear("/rov/imu/temperature")
        feed.hear("/rov/imu/temperature")
        assert world.subscriptions == {"rov/imu"}
        world.put([sample(PORTS["rov/imu"]), sample(PORTS["rov/depth"])])
        assert [topic for topic, _ in told] == ["/rov/imu/temperature"]
        feed.leave("/rov/imu/temperature")
        assert world.subscriptions == {"rov/imu"}
        feed.leave("/rov/imu/temperature")
        assert world.subscriptions == frozenset()

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


def test_a_fault_of_a_table_costs_its_message_and_is_told():
    """What no test foresaw of one kind of sensor must not end the adapter, nor the topics of all others."""

    async def story():
        world = mounted(context())
        feed, told = heard_of(world, "/rov/imu", "/rov/lasers")
        (lasers,) = (
            sensor_topic for sensor_topic in feed.catalogue.sensor_topics if sensor_topic.name == "/rov/lasers"
        )
        calls = []

        def broken(a_sample):
            calls.append(a_sample.seq)
            if len(calls) == 1:
                raise KeyError("an angle")
            return lasers.make(a_sample)

        sensor_topics = (replace(o, make=broken) if o is lasers else o for o in feed.catalogue.sensor_topics)
        feed.catalogue = replace(feed.catalogue, sensor_topics=tuple(sensor_topics))
        feed.hear("/rov/imu")
        feed.hear("/rov/bumper")
        feed.leave("/rov/bumper")
        both = [sample(PORTS["rov/lasers"]), sample(PORTS["rov/imu"])]
        world.put(both)
        (_, bad), (_, good) = told
        assert (bad.raw, bad.plain, bad.message) == (None, None, None)
        assert good.raw is not None
        assert good.plain is not None
        assert (world.stats.errors, world.stats.details["refused"]) == (1, {"encoding": 1})
        assert (
            world.stats.last_error == "a message of sensor_msgs/msg/LaserScan could not be made: KeyError: 'an angle'"
        )
        world.put(both)
        assert told[2][1].raw is not None

    run(story)


def test_a_fault_of_an_encoder_costs_that_form_once():
    async def story():
        world = mounted(context())
        feed, told = heard_of(world, "/rov/imu")
        world.put([sample(PORTS["rov/imu"])])
        (_, message) = told[0]
        tried = []

        def breaks():
            tried.append(1)
            raise UnicodeEncodeError("utf-8", "\ud800", 0, 1, "half a pair")

        assert message.encoded("cbor", breaks) is None
        assert message.encoded("cbor", breaks) is None
        assert len(tried) == world.stats.errors == 1
        assert message.encoded("png", lambda: b"x") == b"x"
        assert message.raw is not None
        await feed.close()

    run(story)


def test_the_clock_goes_back_with_the_world():
    """A reset is told as an event; a restore is only seen by its samples. Nodes with use_sim_time hear of both."""

    async def story():
        world = mounted(context())
        _, told = heard_of(world, "/clock")
        (path,) = world.subscriptions
        base = sample(PORTS[path])

        def at(t_ns):
            world.put([Sample(path, 0, t_ns, t_ns, True, base.value)])
            clock = told[-1][1].message.clock
            return clock.sec * 10**9 + clock.nanosec - world.world.epoch_ns

        assert at(5_000_000_000) == 5_000_000_000
        world.say(Event("reset", 0, 0, "the world was reset"))
        assert at(4_000_000) == 4_000_000
        assert at(9_000_000_000) == 9_000_000_000
        assert at(7_000_000_000) == 7_000_000_000
        before = len(told)
        world.put([Sample(path, 0, 7_001_000_000, 7_001_000_000, True, base.value)])
        assert len(told) == before  # of the same hundredth of a second

    run(story)
