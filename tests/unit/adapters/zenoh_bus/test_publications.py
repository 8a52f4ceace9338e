"""The world is told what anybody in the network subscribes to; a session is played here, the real one is in the tests of whole servers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from msgspec.structs import replace
from uwserver_adapters.zenoh_bus import publications as module
from uwserver_adapters.zenoh_bus.codec import Codec
from uwserver_adapters.zenoh_bus.keys import KeyScheme
from uwserver_adapters.zenoh_bus.publications import Publications

from uwserver.ports import Event
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import DEPTH, IMU, THRUSTERS

pytest.importorskip("zenoh")


class Session:
    """Publishers by key, and who subscribes to them."""

    def __init__(self) -> None:
        self.heard: dict[str, bool] = {}
        self.told: dict[str, Callable[[Any], None]] = {}

    def liveliness(self) -> Any:
        return Mock()

    def declare_publisher(self, key: str, **_: object) -> Any:
        path = key.split("/", 2)[2]
        publisher = Mock()
        type(publisher).matching_status = property(lambda _: SimpleNamespace(matching=self.heard.get(path, False)))
        publisher.declare_matching_listener = lambda callback: self.told.update({path: callback})
        return publisher

    def subscribe(self, path: str, is_heard: bool = True) -> None:
        """Zenoh says so, in a thread of its own."""
        self.heard[path] = is_heard
        self.told[path](SimpleNamespace(matching=is_heard))


def test_the_world_is_told_what_is_subscribed_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "direct", lambda callback: callback)
    context, session = FakeContext(), Session()

    async def scene() -> None:
        publications = Publications(context, session, KeyScheme("uw", "s"), Codec("json"), Mock())
        publications.open()
        context.attach(publications)
        assert context.subscriptions == frozenset()
        follow = Mock(wraps=context.subscriptions_changed)
        monkeypatch.setattr(context, "subscriptions_changed", follow)
        for path in ("rov/imu", "rov/depth"):
            await asyncio.to_thread(session.subscribe, path)
        await asyncio.sleep(0)
        assert context.subscriptions == {"rov/imu", "rov/depth"}
        await asyncio.to_thread(session.subscribe, "rov/imu", False)
        await asyncio.sleep(0)
        assert context.subscriptions == {"rov/depth"}
        session.heard["rov/imu"] = True  # its listener is late
        publications.refresh_matching()
        assert context.subscriptions == {"rov/imu", "rov/depth"}, "at once: an answer may follow"
        calls = follow.call_count
        publications.refresh_matching()
        assert follow.call_count == calls, "nothing is new"
        session.heard["rov2/depth"] = True  # subscribed to before it is there
        context.set_ports([DEPTH, THRUSTERS, replace(DEPTH, path="rov2/depth")])
        assert context.subscriptions == {"rov/depth", "rov2/depth"}
        context.set_ports([IMU])
        assert context.subscriptions == {"rov/imu"}
        publications.put_event(Event("paused", 0, 0, ""))

    asyncio.run(scene())
