"""One TCP connection of the native protocol: bytes to requests, answers to bytes, and what happens to a peer that misbehaves."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

from uwserver import adapter
from uwserver.adapter import STRANGER_LIMIT, Peer, Peers
from uwserver.ports import Fault
from uwserver_adapters.native.codec import NEED_DATA, Codec, Control, JsonCodec, choose_codec
from uwserver_adapters.native.encoding import RequestId
from uwserver_adapters.native.outbox import Outbox
from uwserver_adapters.native.requests import Malformed, Request
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.session import Session
from uwserver_adapters.native.websocket import Handshake

TRIES = 3
"""Messages before a valid `hello` where a token is set."""


class Bounds(Protocol):
    """What an adapter's table says of each peer: see `uwserver_adapters.sockets.config.SocketsConfig`."""

    @property
    def hello_timeout_s(self) -> float:
        """Wall time in which it must have been admitted."""

    @property
    def queue_samples(self) -> int:
        """Samples that may wait for it."""

    @property
    def queue_bytes(self) -> int:
        """Bytes of samples, and of replies, that may wait for it."""


class NativeConnection(adapter.Connection):
    """Made for each peer; all its methods run on the loop.

    Args:
        service: the native protocol.
        bounds: of each peer.
        peers: of the adapter.
        handshake: begins that of a WebSocket.
    """

    def __init__(
        self, service: NativeService, bounds: Bounds, peers: Peers[Peer], handshake: Callable[[], Handshake]
    ) -> None:
        super().__init__(peers, bounds.hello_timeout_s)
        self._service = service
        self._begin_handshake = handshake
        self._stats = service.context.stats
        self._outbox = Outbox(self.write, self._overflow, bounds.queue_samples, self._stats, bounds.queue_bytes)
        self._session: Session | None = None
        self._waking: asyncio.Handle | None = None
        self._rate = service.rate_meter()
        self._handshake: Handshake | None = None
        self._ends_with_peer = False  # neither TLS nor WebSocket knows a peer that only listens on
        self._tries = 0
        self._full_limit = 0

    # -- life -----------------------------------------------------------------------------------------------------------------------

    def opened(self) -> None:
        """There is room for it."""
        self._ends_with_peer = self.transport.get_extra_info("sslcontext") is not None
        if self._is_locked_out():
            self._dismiss(self._service.lockout.fault)

    def refused(self, fault: Fault) -> bytes:
        """One too many: a JSON line where which encoding it speaks is not known yet."""
        return self._last_text(fault)

    def missed(self) -> None:
        """It has not shown in time that it is one of ours."""
        if self._handshake is not None and self._session is None:
            self.abort()
        elif self._service.token is None:
            super().missed()
        else:
            text = 'this server wants a token: no valid "hello" came in time'
            self._service.refusals.note("timeout", text)
            self._dismiss(Fault("denied", text, "token"))

    def stop(self) -> None:
        """It begins to end."""
        self._outbox.close()
        if self._waking is not None:
            self._waking.cancel()

    def closed(self) -> None:
        """The peer died, or we closed."""
        self.stop()
        if self._session is not None:
            self._session.close()

    def eof_received(self) -> bool:
        """The peer sends nothing more. Returns whether the connection stays open."""
        if self._ends_with_peer:
            self.close()
        return super().eof_received()

    def half_closed(self) -> None:
        """It grants no further tick."""
        if self._session is not None:
            self._session.step_back()

    @property
    def is_owed(self) -> bool:
        """Whether anything may still come for the peer though it asks for nothing more."""
        return not self._outbox.is_empty or (self._session is not None and self._session.is_owed)

    def close(self) -> None:
        """Send what the peer still takes, then close."""
        self._outbox.flush()
        if self._session is not None:
            self.write(self._session.codec.ending(None))
        super().close()

    def _last_text(self, fault: Fault, request: RequestId = None) -> bytes:
        self._stats.errors += 1
        codec = self._session.codec if self._session is not None else JsonCodec()
        last = codec.error(request, fault) + codec.ending(fault)
        self._stats.bytes_sent += len(last)
        return last

    def _dismiss(self, fault: Fault, request: RequestId = None) -> None:
        if not self.is_closing:
            self.farewell(self._last_text(fault, request))

    def _overflow(self, text: str) -> None:
        self._service.refusals.note("slow reader", text)
        self._dismiss(Fault("overload", text))

    # -- out ------------------------------------------------------------------------------------------------------------------------

    def pause_writing(self) -> None:
        """The peer reads too slowly."""
        self._outbox.paused = True

    def resume_writing(self) -> None:
        """The peer has read."""
        self._outbox.resume()
        self.finish_if_done()

    def wake(self) -> None:
        """An answer came later than its request; all that come at once are written together."""
        if self._waking is None and not self.is_working and not self.is_closing:
            self._waking = self.loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._waking = None
        self._outbox.flush()
        self.finish_if_done()

    def after_turn(self) -> None:
        """Answers of one turn are written together."""
        self._outbox.flush()

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def takes_http(self, head: bytes) -> bool:
        """A GET may open a WebSocket; nothing else of HTTP is answered."""
        if not head.startswith(b"GET "):
            return False
        self._handshake = self._begin_handshake()
        return True

    def receive(self, data: bytes) -> None:
        """Store bytes; the first ones choose the codec."""
        if self._session is None:
            codec: Codec | None
            if self._handshake is None:
                codec = choose_codec(data)
            else:
                data = self._handshake.receive(data)
                codec = self._let_in(self._handshake)
            if codec is None:
                return
            self._session = self.begin(codec)
        self._session.codec.receive(data)

    def _let_in(self, handshake: Handshake) -> Codec | None:
        """Answer the opening of a WebSocket once it is complete; returns its codec if the peer is let in."""
        if handshake.answer is None:
            return None
        if handshake.fault is not None:
            self._stats.errors += 1
            cause = {"allowed_origins": "origin", "allowed_hosts": "host"}.get(handshake.fault.where, "handshake")
            self._service.refusals.note(cause, handshake.fault.text)
        elif handshake.codec is None:
            self._service.refusals.note("http", "a peer asked for a page, which is not served here")
        if handshake.codec is None:
            self._stats.bytes_sent += len(handshake.answer)
            self.farewell(handshake.answer)
            return None
        self._ends_with_peer = True
        self.write(handshake.answer)
        return handshake.codec

    def begin(self, codec: Codec) -> Session:
        """It speaks the native protocol from now on."""
        session = self._service.session(codec, self._outbox, self.wake)
        if self._service.token is None:
            session.admit()
        else:
            self._full_limit, codec.limit = codec.limit, STRANGER_LIMIT
        return session

    def step(self) -> bool:
        """Carry out one message."""
        session = self._session
        if session is None:
            return False
        event = session.codec.next_event()
        if event is NEED_DATA:
            return False
        self._take(event, session)
        return True

    def quiet_until(self) -> float:
        """The end of the window, when the peer floods."""
        return self._rate.end if self._rate.is_flooded(self.loop.time()) else 0.0

    def _take(self, event: Request | Malformed | Control, session: Session) -> None:
        is_allowed = self._rate.take(self.loop.time())
        if isinstance(event, Control):
            self._take_control(event, is_allowed)
        elif not session.admitted:
            self._take_from_stranger(event, session)
        elif not is_allowed:
            text = f"more than {self._rate.most} requests a second: send fewer, or raise max_requests_per_s"
            self._service.refusals.note("rate", text)
            session.refuse(event.id, Fault("overload", text))
        elif isinstance(event, Request):
            if self.admit():
                self._carry_out(event, session)
        else:
            self._service.refusals.note(event.fault.code, event.fault.text)
            if event.fatal:
                self._outbox.flush()
                self._dismiss(event.fault, event.id)
            else:
                session.refuse(event.id, event.fault)

    def _take_control(self, control: Control, is_allowed: bool) -> None:
        if control.ends:
            self._outbox.flush()
            self.write(control.data)
            super().close()
        elif is_allowed and control.data:
            self._outbox.put_reply(control.data)

    def _take_from_stranger(self, event: Request | Malformed, session: Session) -> None:
        """Before a valid `hello` nothing else is answered, and not often."""
        if self._is_locked_out():
            self._dismiss(self._service.lockout.fault)
            return
        self._tries += 1
        if isinstance(event, Request):
            self._carry_out(event, session)
        else:
            session.refuse(
                event.id,
                Fault("denied", 'this server wants a token: send "hello" with "version" and "token" first', "token"),
            )
        if session.admitted:
            session.codec.limit = self._full_limit
            self.admit()
        elif self._tries >= TRIES or (isinstance(event, Malformed) and event.fatal):
            self._outbox.flush()
            text = 'too many messages without a valid "hello"'
            self._service.refusals.note("denied", text)
            self._dismiss(Fault("denied", text, "token"))

    def _is_locked_out(self) -> bool:
        return self._service.lockout.is_out(self.host, self.loop.time())

    def _carry_out(self, request: Request, session: Session) -> None:
        fault = self._service.take(session, request, self.host)
        if fault is not None:
            self._outbox.flush()
            last = session.codec.ending(fault)
            self._stats.bytes_sent += len(last)
            self.farewell(last)
