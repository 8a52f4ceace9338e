"""Zenoh as in BlueOS: vehicles speak on `mavlink_raw/out` and others on `mavlink_raw/in`.

The keys `mavlink/out`, `mavlink/{system}/{component}/{MESSAGE}`, and below that `/{field}`, carry the same messages as JSON, in the layout of
mavlink-server. Only what somebody subscribes to is encoded. Priority and congestion control are mavlink-server's, with which a subscriber loses no
message. A put may therefore block, so it runs on a thread.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import msgspec

from uwserver.adapter import CannotServe, Inbox, Worker
from uwserver_adapters.mavlink.links.endpoint import BadLink, Link
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.frames import Decoder, Frame
from uwserver_adapters.mavlink.wire.json_form import LONGEST, BadJson, fields_of, frame_of, name_of, text_of
from uwserver_adapters.zenoh_session.config import ZenohConfig
from uwserver_adapters.zenoh_session.session import direct, opened

if TYPE_CHECKING:
    import zenoh


JSON_OUT, JSON_IN = "mavlink/out", "mavlink/in"
"""Keys of all messages from the vehicle, and of those to it."""
KEYS = 4096
"""Keys that are remembered at a time, since forwarded messages may come from any number of senders."""
OUT, IN = "mavlink_raw/out", "mavlink_raw/in"
"""Keys, named from the vehicle's side."""
WAITING = 1000
"""Messages that may wait for the loop. More are dropped and counted."""


class _Key:
    """A publisher for a key, or for all keys below one, and whether somebody subscribes there."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        import zenoh

        self._publisher = session.declare_publisher(
            key,
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema("mavlink"),
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.BLOCK,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        self.is_heard = False
        # The callback only sets a flag, so zenoh may call it on its own thread.
        self._listener = self._publisher.declare_matching_listener(direct(self._matches))
        self.refresh_matching()

    def _matches(self, status: zenoh.MatchingStatus) -> None:
        self.is_heard = status.matching

    def refresh_matching(self) -> None:
        """Ask zenoh whether somebody subscribes, because the listener hears it a little later. Never clears what the listener has set."""
        status: Any = self._publisher.matching_status  # zenoh's stub declares a bool, but it is a MatchingStatus
        if status.matching:
            self.is_heard = True

    def put(self, text: bytes) -> None:
        """Publish a text. Blocks while a subscriber is slow."""
        self._publisher.put(text)


class JsonKeys:
    """The JSON keys of one session. Runs on the loop thread, except for `_tell` and what it calls.

    Args:
        session: the zenoh session.
        worker: the thread that puts messages, in order.
        dialect: the messages.
    """

    def __init__(self, session: zenoh.Session, worker: Worker, dialect: Dialect) -> None:
        self._session = session
        self._worker = worker
        self._dialect = dialect
        self._decoder = Decoder(dialect)
        self._out = _Key(session, JSON_OUT)
        self._below = _Key(session, "mavlink/*/*/**")  # matches a subscriber to any message or field
        self._keys: dict[str, _Key] = {}

    def refresh_matching(self) -> None:
        """Look for subscribers that zenoh has not reported yet."""
        for key in (self._out, self._below):
            if not key.is_heard:
                key.refresh_matching()

    def put(self, frame: bytes) -> None:
        """Publish a frame if somebody subscribes."""
        if not (self._out.is_heard or self._below.is_heard):
            return
        self._worker.send(lambda: self._tell(frame))

    def _tell(self, data: bytes) -> None:
        self._decoder.receive(data)
        while isinstance(event := self._decoder.next_event(), Frame):
            self._tell_frame(event)

    def _tell_frame(self, frame: Frame) -> None:
        layout = self._dialect.by_id[frame.id]
        fields = fields_of(frame, layout)
        key = f"mavlink/{frame.system}/{frame.component}/{layout.name}"
        whole = [self._out, self._key(key)] if self._below.is_heard else [self._out]
        if heard := [one for one in whole if one.is_heard]:
            text = text_of(frame, layout.name, fields)
            for one in heard:
                one.put(text)
        if not self._below.is_heard:
            return
        if self._key(f"{key}/*").is_heard:
            for part in layout.parts:
                name = name_of(part)
                if (below := self._key(f"{key}/{name}")).is_heard:
                    below.put(msgspec.json.encode(fields[name]))

    def _key(self, key: str) -> _Key:
        known = self._keys.get(key)
        if known is None:
            if len(self._keys) >= KEYS:
                self._keys.clear()
            known = self._keys[key] = _Key(self._session, key)
        return known


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
