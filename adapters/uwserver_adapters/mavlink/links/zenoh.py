"""Zenoh as in BlueOS: vehicles speak on `mavlink_raw/out` and others on `mavlink_raw/in`.

The keys below `mavlink/` carry the same messages as JSON (`zenoh_json.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from uwserver.adapter import CannotServe, Inbox, Worker
from uwserver_adapters.mavlink.links.endpoint import BadLink, Link
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.links.zenoh_json import IN as JSON_IN
from uwserver_adapters.mavlink.links.zenoh_json import JsonKeys
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.json_form import LONGEST, BadJson, frame_of
from uwserver_adapters.zenoh_session.config import ZenohConfig
from uwserver_adapters.zenoh_session.session import opened

if TYPE_CHECKING:
    import zenoh

OUT, IN = "mavlink_raw/out", "mavlink_raw/in"
"""Keys, named from the vehicle's side."""
WAITING = 1000
"""Messages that may wait for the loop. More are dropped and counted."""


class ZenohLink(Link):
    """A session with one endpoint, which is a router or another peer.

    Args:
        endpoint: the endpoint, such as "tcp/192.168.2.2:7117". It may come later.
        router: the router of the vehicle.
    """

    def __init__(self, endpoint: str, router: Router) -> None:
        super().__init__(f"zenoh:{endpoint}", router)
        self._endpoint = endpoint
        self._session: zenoh.Session | None = None
        self._publisher: zenoh.Publisher | None = None
        self._channel: Channel | None = None
        self._json: JsonKeys | None = None
        self._worker = Worker("zenoh of mavlink", self._stats)
        self._inbox = Inbox(self._arrived, WAITING, self._too_many)

    async def open(self) -> None:
        """Open the session. The endpoint may come later.

        Raises:
            BadLink: zenoh is not installed, or the endpoint is not valid.
        """
        config = ZenohConfig(connect=(self._endpoint,), listen=())
        try:
            # This takes half a second, for which the loop must not wait.
            self._session = await self._worker.run(lambda: opened(config, ()))
        except CannotServe as error:
            raise BadLink(f"link {self.address}: {error}") from None
        import zenoh

        self._publisher = self._session.declare_publisher(
            OUT, priority=zenoh.Priority.REAL_TIME, congestion_control=zenoh.CongestionControl.DROP
        )
        for key, take in ((IN, self._take), (JSON_IN, self._take_json)):
            self._session.declare_subscriber(key, self._hears(take), allowed_origin=zenoh.Locality.REMOTE)
        self._json = JsonKeys(self._session, self._worker, self._router.dialect)
        self._channel = self._router.open(self.address, self._write, lambda: True)

    async def attend(self) -> None:
        """Ask who listens. Zenoh connects again by itself."""
        if self._json is not None:
            self._json.refresh_matching()

    async def close(self) -> None:
        """Close the session, which ends its threads."""
        if self._channel is not None:
            self._router.close(self._channel)
        session, self._session = self._session, None
        await self._worker.close(lambda: None if session is None else session.close())

    def _hears(self, take: Callable[[bytes], None]) -> Callable[[zenoh.Sample], None]:
        """Return a subscriber's callback, which runs on a thread of zenoh."""

        def hear(sample: zenoh.Sample) -> None:
            if len(sample.payload) > LONGEST:  # copying a huge payload would hold up everything else
                self._too_many(sample)
            else:
                self._inbox.put((take, sample.payload.to_bytes()))

        return hear

    def _arrived(self, item: tuple[Callable[[bytes], None], bytes]) -> None:
        take, data = item
        if self._session is not None:
            take(data)

    def _too_many(self, _: object) -> None:
        self._stats.dropped += 1

    def _take(self, data: bytes) -> None:
        if self._channel is not None:
            self._router.receive(self._channel, data)

    def _take_json(self, data: bytes) -> None:
        try:
            frame = frame_of(data, self._router.dialect)
        except BadJson as error:
            self._router.counters["json"] += 1
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
