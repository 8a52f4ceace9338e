"""Messages as JSON on zenoh's keys, in the layout of mavlink-server.

The keys are `mavlink/out`, `mavlink/{system}/{component}/{MESSAGE}`, and below that `/{field}`. Only what somebody subscribes to is encoded.
Priority and congestion control are mavlink-server's, with which a subscriber loses no message. A put may therefore block, so it runs on a thread.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from uwserver.adapter import Worker
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.frames import Decoder, Frame
from uwserver_adapters.mavlink.wire.json_form import fields_of, name_of, text_of
from uwserver_adapters.zenoh_session.session import direct

if TYPE_CHECKING:
    import zenoh

OUT, IN = "mavlink/out", "mavlink/in"
"""Keys of all messages from the vehicle, and of those to it."""
KEYS = 4096
"""Keys that are remembered at a time, since forwarded messages may come from any number of senders."""


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
        self._out = _Key(session, OUT)
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
