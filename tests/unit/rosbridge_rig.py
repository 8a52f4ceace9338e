"""Clients of rosbridge against the adapter, on loopback."""

from __future__ import annotations

import asyncio
import contextlib
import json

import websockets
from adapter_rig import serving
from cbor_rig import uncbor
from ros_rig import context
from uwserver_adapters.rosbridge import RosbridgeAdapter
from uwserver_adapters.rosbridge.config import RosbridgeConfig


class Client:
    """One connection."""

    def __init__(self, socket):
        self.socket = socket

    async def say(self, **message):
        await self.socket.send(json.dumps(message))

    async def hear(self):
        data = await asyncio.wait_for(self.socket.recv(), 30)
        return json.loads(data) if isinstance(data, str) else uncbor(data)[0]

    async def call(self, service, args=None, **more):
        await self.say(op="call_service", service=service, args=args or {}, **more)
        while (answer := await self.hear())["op"] != "service_response":
            pass
        return answer

    async def settle(self):
        """All that was said before is done."""
        await self.call("/rosapi/get_ros_version", id="settle")


@contextlib.asynccontextmanager
async def bridge(count=1, made=None, **config):
    made = made or context()
    async with serving(RosbridgeAdapter(RosbridgeConfig(**{"port": 0, "truth": True, **config}), made)):
        async with contextlib.AsyncExitStack() as stack:
            clients = [
                Client(await stack.enter_async_context(websockets.connect(made.stats.address, max_size=None)))
                for _ in range(count)
            ]
            yield (made, *clients)


def run(story):
    asyncio.run(asyncio.wait_for(story(), 120))
