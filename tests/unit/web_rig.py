"""A web view that runs, over a world of the test; and peers on plain sockets, so that no browser stands between a test and the wire."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import adapter_rig
import numpy as np
from uwserver_adapters.web import WebAdapter
from uwserver_adapters.web.config import WebConfig
from websockets.asyncio.client import ClientConnection, connect

from uwserver.adapter import VehicleFacts
from uwserver.ports import EntityList, Present, SceneState
from uwserver.testing import FakeContext

TWO = EntityList(3, (Present("rov", "rov"), Present("auv", "rov")), (Present("crate", "crate"),))


def state_of(t_ns: int = 0) -> SceneState:
    """Two vehicles and an object, of which each number is another one."""
    poses = np.arange(21, dtype=np.float64).reshape(3, 7) + 0.5
    return SceneState(TWO, t_ns, poses, np.array([-127, 0, 127], np.int8), (0.0, 0.0, 0.0))


class Stage(NamedTuple):
    """A running view."""

    adapter: WebAdapter
    context: FakeContext
    host: str
    port: int

    async def raw(self, data: bytes) -> bytes:
        """All that comes back for some bytes, until the view closes."""
        reader, writer = await asyncio.open_connection(self.host, self.port)
        writer.write(data)
        answer = await asyncio.wait_for(reader.read(), 60.0)
        writer.close()
        return answer

    async def get(self, path: str, method: str = "GET", **headers: str) -> Answer:
        """An answer; a header "Host" of None leaves it out."""
        lines = {"Host": f"{self.host}:{self.port}", **{name.replace("_", "-"): text for name, text in headers.items()}}
        head = f"{method} {path} HTTP/1.1\r\n" + "".join(f"{name}: {text}\r\n" for name, text in lines.items() if text)
        data = await self.raw(head.encode() + b"\r\n")
        first, _, body = data.partition(b"\r\n\r\n")
        status, *rest = first.decode().split("\r\n")
        fields = dict(line.split(": ", 1) for line in rest)
        return Answer(int(status.split()[1]), {name.lower(): text for name, text in fields.items()}, body)

    def page(self, **options: Any) -> connect:
        """A page: its live data."""
        return connect(f"ws://{self.host}:{self.port}/live", compression=None, **options)


class Answer(NamedTuple):
    """An answer of HTTP."""

    status: int
    headers: dict[str, str]
    body: bytes


async def ask(page: ClientConnection, method: str, **params: Any) -> dict[str, Any]:
    """The whole reply; what comes meanwhile is passed over."""
    await page.send(json.dumps({"jsonrpc": "2.0", "id": "asked", "method": method, "params": params}))

    async def heard() -> dict[str, Any]:
        async for message in page:
            if isinstance(message, str) and (found := json.loads(message)).get("id") == "asked":
                return dict(found)
        raise AssertionError(f"the view left after {method}")

    return await asyncio.wait_for(heard(), 60.0)


async def call(page: ClientConnection, service: str, **args: Any) -> dict[str, Any]:
    """The same of a service."""
    return await ask(page, "call", service=service, args=args)


def code_of(reply: dict[str, Any]) -> str:
    """Why it was refused; "" when it was not."""
    return reply["error"]["data"]["code"] if "error" in reply else ""


def play(scene: Callable[[Stage], Awaitable[None]], context: FakeContext | None = None, **table: Any) -> FakeContext:
    """A scene with a view of this table; gives the context."""
    given = context or FakeContext(scene_state=state_of(), world=world_of("rov", "auv"))
    given.scripts["world/status"] = lambda args: {
        "t_s": 1.5,
        "paused": False,
        "mode": "realtime",
        "failure": "",
        "recorder": None,
    }

    async def whole() -> None:
        adapter = WebAdapter(WebConfig(port=0, **table), given)
        async with adapter_rig.serving(adapter) as running:
            host, _, port = running.stats.address.removeprefix("http://").rstrip("/").rpartition(":")
            await asyncio.wait_for(scene(Stage(adapter, given, host, int(port))), 120.0)

    asyncio.run(whole())
    return given


def world_of(*names: str) -> Any:
    """Facts of a world with these vehicles."""
    import msgspec

    return msgspec.structs.replace(FakeContext().world, vehicles=tuple(VehicleFacts(name, "fake") for name in names))
