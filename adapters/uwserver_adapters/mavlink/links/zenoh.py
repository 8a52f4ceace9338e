"""Zenoh as BlueOS has it: vehicles speak on `mavlink_raw/out`, others on `mavlink_raw/in`; the same as JSON below `mavlink/` (`zenoh_json.py`)."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from uwserver.adapter import AdapterStats
from uwserver_adapters.mavlink.links.endpoint import BadLink
from uwserver_adapters.mavlink.links.hub import Hub
from uwserver_adapters.mavlink.links.zenoh_json import IN as JSON_IN
from uwserver_adapters.mavlink.links.zenoh_json import JsonKeys
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.json_form import BadJson, frame_of

if TYPE_CHECKING:
    import zenoh

OUT, IN = "mavlink_raw/out", "mavlink_raw/in"
"""Keys, named as seen from the vehicle."""
WAITING = 1000
"""Messages that may wait for the loop; more are dropped and counted."""


class ZenohLink:
    """A session with one endpoint: a router, or another peer.

    Args:
        endpoint: as "tcp/192.168.2.2:7117"; it may come later.
    """

    def __init__(self, endpoint: str, hub: Hub, stats: AdapterStats) -> None:
        self.address = f"zenoh:{endpoint}"
        self._endpoint = endpoint
        self._hub = hub
        self._stats = stats
        self._loop = asyncio.get_running_loop()
        self._session: zenoh.Session | None = None
        self._publisher: zenoh.Publisher | None = None
        self._channel: Channel | None = None
        self._json: JsonKeys | None = None
        self._thread = ThreadPoolExecutor(1, "zenoh of mavlink")
        self._waiting = 0

    async def open(self) -> None:
        """Open the session; what it connects to may come later.

        Raises:
            BadLink: zenoh is not installed, or does not know such an endpoint.
        """
        try:
            import zenoh
        except ImportError as error:
            raise BadLink(f"link {self.address} needs zenoh: pip install 'uwserver[zenoh]'") from error
        config = zenoh.Config()
        settings = {
            "mode": "peer",
            "connect/endpoints": [self._endpoint],
            "listen/endpoints": [],
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/unicast/accept_timeout": 700,
            "transport/unicast/open_timeout": 700,
        }
        try:
            for path, value in settings.items():
                config.insert_json5(path, json.dumps(value))
            # It takes half a second, which the loop cannot wait.
            self._session = await self._loop.run_in_executor(self._thread, zenoh.open, config)
        except zenoh.ZError as error:
            raise BadLink(f"link {self.address}: {str(error).split(' at /')[0].strip()}") from None
        self._publisher = self._session.declare_publisher(
            OUT, priority=zenoh.Priority.REAL_TIME, congestion_control=zenoh.CongestionControl.DROP
        )
        for key, take in ((IN, self._take), (JSON_IN, self._take_json)):
            self._session.declare_subscriber(key, self._handover(take), allowed_origin=zenoh.Locality.REMOTE)
        self._json = JsonKeys(self._session, self._thread, self._hub.dialect, self._stats)
        self._channel = self._hub.open(self.address, self._write, lambda: True)

    async def attend(self) -> None:
        """Zenoh connects again by itself; look who listens."""
        if self._json is not None:
            self._json.look()

    def close(self) -> None:
        """Close the session; its threads end with it."""
        if self._channel is not None:
            self._hub.close(self._channel)
        session, self._session = self._session, None
        if session is not None:
            session.close()
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _handover(self, take: Callable[[bytes], None]) -> Callable[[zenoh.Sample], None]:
        """For a thread of zenoh: hand it over at once."""

        def heard(sample: zenoh.Sample) -> None:
            if self._waiting >= WAITING:
                self._stats.dropped += 1
                return
            self._waiting += 1
            self._loop.call_soon_threadsafe(self._arrived, take, sample.payload.to_bytes())

        return heard

    def _arrived(self, take: Callable[[bytes], None], data: bytes) -> None:
        self._waiting -= 1
        if self._session is not None:
            take(data)

    def _take(self, data: bytes) -> None:
        if self._channel is not None:
            self._hub.receive(self._channel, data)

    def _take_json(self, data: bytes) -> None:
        try:
            frame = frame_of(data, self._hub.dialect)
        except BadJson as error:
            self._hub.count("json")
            self._stats.last_error = f"{JSON_IN}: {error}"
            return
        self._take(frame)

    def _write(self, data: bytes) -> bool:
        if self._publisher is None or self._session is None:
            return False
        self._publisher.put(data)
        if self._json is not None:
            self._json.put(data)
        return True
