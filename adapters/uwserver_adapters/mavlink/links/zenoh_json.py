"""Messages as JSON on zenoh's keys, as mavlink-server publishes them: `mavlink/out`, `mavlink/{system}/{component}/{MESSAGE}`, and `/{field}` below.

Nothing is encoded for nobody. Who listens does not lose a message, by the priority and congestion control that mavlink-server has; so putting
one may have to wait, and is done on a thread.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from uwserver.adapter import Worker
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.frames import Decoder, Frame
from uwserver_adapters.mavlink.wire.json_form import fields_of, name_of, text_of

if TYPE_CHECKING:
    import zenoh

OUT, IN = "mavlink/out", "mavlink/in"
"""All messages of the vehicle, and those for it."""
KEYS = 4096
"""Keys that are remembered at a time: senders whose messages are forwarded may have any number."""


class _Key:
    """A key, or all below one, and whether somebody listens there."""

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
        # Zenoh's own thread only sets a flag, for which it needs to start none of Python.
        self._listener = self._publisher.declare_matching_listener(
            zenoh.handlers.Callback(self._matches, indirect=False)
        )
        self.look()

    def _matches(self, status: zenoh.MatchingStatus) -> None:
        self.is_heard = status.matching

    def look(self) -> None:
        """Ask, as the listener is told a little later. Never unlearns what it says meanwhile."""
        status: Any = self._publisher.matching_status  # zenoh's stub says bool, it is a MatchingStatus
        if status.matching:
            self.is_heard = True

    def put(self, text: bytes) -> None:
        """Publish. May wait for who is slow."""
        self._publisher.put(text)


class JsonKeys:
    """What one session tells. Loop thread, but for `_tell` and what it calls.

    Args:
        session: of zenoh.
        worker: puts messages, in their order.
        dialect: the messages.
    """

    def __init__(self, session: zenoh.Session, worker: Worker, dialect: Dialect) -> None:
        self._session = session
        self._worker = worker
        self._dialect = dialect
        self._decoder = Decoder(dialect)
        self._out = _Key(session, OUT)
        self._below = _Key(session, "mavlink/*/*/**")  # somebody listens to some message, or to fields
        self._keys: dict[str, _Key] = {}

    def look(self) -> None:
        """Find those who listen, of whom zenoh has not said anything yet."""
        for key in (self._out, self._below):
            if not key.is_heard:
                key.look()

    def put(self, frame: bytes) -> None:
        """Tell a frame to who listens."""
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
