"""A transport of a ROS 2 node that a test reads and writes, and a node on it."""

from __future__ import annotations

import asyncio

from ros_rig import flying
from uwserver_adapters.ros.messages import Types
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.ros2.node import Node

from uwserver.adapter import Refusals


class Wire:
    """A transport that a test reads and writes: implements `Carrier`."""

    def __init__(self, types):
        self.types, self.said, self.services, self.heard = types, [], {}, {}

    def advertise(self, topic, type_name, latched, heard):
        self.heard[topic] = heard
        wire = self

        class Writer:
            is_latched = latched

            def put(self, data):
                wire.said.append((topic, wire.types.from_cdr(data, type_name)))
                return True

            def close(self):
                del wire.heard[topic]

        return Writer()

    def listen(self, topic, type_name, take):
        return lambda: None

    def serve(self, service, type_name, take):
        self.services[service] = (type_name, take)
        return lambda: self.services.pop(service)

    def call(self, service, data=None, **fields):
        """Answers so far."""
        kind, take = self.services[service]
        answers = []
        sent = self.types.cdr(self.types.make(f"{kind}_Request", **fields)) if data is None else data
        take(sent, "peer", lambda body: answers.append(self.types.from_cdr(body, f"{kind}_Response")))
        return answers

    def of(self, topic):
        return [message for name, message in self.said if name == topic]


class Rig:
    """A node on such a transport, with an autopilot whose ways the test ends."""

    def __init__(self, world=None, distro="jazzy"):
        self.world, self.types = world or flying(), Types(distro)
        self.wire = Wire(self.types)
        refusals = Refusals("ros2", self.world.stats, asyncio.get_running_loop().time)
        self.node = Node(self.world, Ros2Config(domain=0), refusals, self.wire, self.types)
        self.node.feed.begin()


def story(make):
    """A test that gets what `make` gives, and whose node is closed; it runs on a loop."""

    def decorated(work):
        def test():
            async def told():
                rig = make()
                await work(rig) if asyncio.iscoroutinefunction(work) else work(rig)
                await rig.node.close()

            asyncio.run(asyncio.wait_for(told(), 120))

        test.__name__, test.__doc__ = work.__name__, work.__doc__
        return test

    return decorated
