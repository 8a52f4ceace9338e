"""One TCP connection of the native protocol: bytes to requests, answers to bytes, and what happens to a peer that misbehaves."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from uwserver import adapter
from uwserver.adapter import STRANGER_LIMIT, AdapterStats, Peer, Peers
from uwserver.ports import Fault
from uwserver_adapters.native.codec import Codec, Control, JsonCodec, choose_codec
from uwserver_adapters.native.messages import Malformed, Request, RequestId, error_message
from uwserver_adapters.native.outbox import Outbox, OutboxTable
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.session import Session
from uwserver_adapters.native.websocket import Handshake

TRIES = 3
"""Messages that a peer may send before a valid `hello`, if a token is needed."""


class OutboxConnection(adapter.Connection):
    """A connection that writes through an outbox, so that the answers of one turn are written together.

    Args:
        peers: the peers of the adapter.
        config: the adapter's table.
        stats: counters of the adapter.
        requests_per_s: see `uwserver.adapter.Connection`.
    """

    def __init__(self, peers: Peers[Peer], config: OutboxTable, stats: AdapterStats, requests_per_s: int) -> None:
        super().__init__(peers, config.hello_timeout_s, stats=stats, requests_per_s=requests_per_s)
        self._outbox = Outbox(self.write, self.overflow, config.queue_samples, stats, config.queue_bytes)
        self._waking: asyncio.Handle | None = None

    def overflow(self, text: str) -> None:
        """End the connection, because too much waits for the peer."""
        raise NotImplementedError

    def take_control(self, control: Control, is_allowed: bool) -> None:
        """Send what the framing itself must send, and close the connection if the peer has ended the conversation."""
        if control.ends:
            self._outbox.flush()
            self.write(control.data)
            super().close()
        elif is_allowed and control.data:
            self._outbox.put_reply(control.data)

    def wake(self) -> None:
        """Write an answer that came later than its request. All that come in one turn of the loop are written together."""
        if self._waking is None and not self.is_working and not self.is_closing:
            self._waking = self.loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._waking = None
        self._outbox.flush()
        self.finish_if_done()

    def after_turn(self) -> None:
        """Write the answers of one turn together."""
        self._outbox.flush()

    def pause_writing(self) -> None:
        """Hold back what is sent: the peer reads too slowly."""
        self._outbox.paused = True

    def resume_writing(self) -> None:
        """Go on sending: the peer has read."""
        self._outbox.resume()
        self.finish_if_done()

    def stop(self) -> None:
        """Forget what waits, and send nothing more."""
        self._outbox.close()
        if self._waking is not None:
            self._waking.cancel()


class NativeConnection(OutboxConnection):
    """The connection of one peer. Loop thread.

    Args:
        service: the native protocol.
        config: the adapter's table.
        peers: the peers of the adapter.
        handshake: begins the handshake of a WebSocket.
    """

    def __init__(
        self, service: NativeService, config: OutboxTable, peers: Peers[Peer], handshake: Callable[[], Handshake]
    ) -> None:
        super().__init__(peers, config, service.context.stats, service.requests_per_s)
        self._service = service
        self._begin_handshake = handshake
        self._session: Session | None = None
        self._handshake: Handshake | None = None
        # With TLS and with WebSocket a peer that ends its side does not listen any more.
        self._ends_with_peer = False
        self._tries = 0
        self._full_limit = 0

    # -- life -----------------------------------------------------------------------------------------------------------------------

    def opened(self) -> None:
        """Refuse a peer whose host has tried tokens."""
        self._ends_with_peer = self.transport.get_extra_info("sslcontext") is not None
        if self._is_locked_out():
            self._dismiss(self._service.lockout.fault)

    def refused(self, fault: Fault) -> bytes:
        """Return the last text for a peer: a JSON line if its encoding is not known yet."""
        return self._last_text(fault)

    def missed(self) -> None:
        """Refuse a peer that was not admitted in time."""
        if self._handshake is not None and self._session is None:
            self.abort()
        elif self._service.token is None:
            super().missed()
        else:
            text = 'this server wants a token: no valid "hello" came in time'
            self._service.refusals.note("timeout", text)
            self._dismiss(Fault("denied", text, "token"))

    def closed(self) -> None:
        """End the session when the connection has ended, from either side."""
        self.stop()
        if self._session is not None:
            self._session.close()

    def eof_received(self) -> bool:
        """Note that the peer sends nothing more; return whether the connection stays open."""
        if self._ends_with_peer:
            self.close()
        return super().eof_received()

    def half_closed(self) -> None:
        """Take the peer out of the lockstep barrier: it cannot grant a tick any more. Its calls go on."""
        if self._session is not None:
            self._session.conversation.leave()

    @property
    def has_pending_output(self) -> bool:
        """Whether the peer may still get something although it asks for nothing more."""
        return not self._outbox.is_empty or (self._session is not None and self._session.has_pending_output)

    def close(self) -> None:
        """Send what the peer still takes, then close the connection."""
        self._outbox.flush()
        if self._session is not None:
            self.write(self._session.codec.ending(None))
        super().close()

    def _last_text(self, fault: Fault, request: RequestId = None) -> bytes:
        self._stats.errors += 1
        codec = self._session.codec if self._session is not None else JsonCodec()
        last = codec.message(error_message(request, fault)) + codec.ending(fault)
        self._stats.bytes_sent += len(last)
        return last

    def _dismiss(self, fault: Fault, request: RequestId = None) -> None:
        if not self.is_closing:
            self.farewell(self._last_text(fault, request))

    def overflow(self, text: str) -> None:
        """End the connection, because too much waits for the peer."""
        self._service.refusals.note("slow reader", text)
        self._dismiss(Fault("overload", text))

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def takes_http(self, head: bytes) -> bool:
        """Begin a handshake with a GET, which may open a WebSocket. No other request of HTTP is answered."""
        if not head.startswith(b"GET "):
            return False
        self._handshake = self._begin_handshake()
        return True

    def receive(self, data: bytes) -> None:
        """Store bytes. The first ones choose the codec."""
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
        """Answer the handshake once it is complete; return its codec if the peer is let in."""
        if handshake.answer is None:
            return None
        if handshake.codec is None:
            if handshake.fault is not None:
                self._stats.errors += 1
            self._service.refusals.note(*handshake.refusal)
            self._stats.bytes_sent += len(handshake.answer)
            self.farewell(handshake.answer)
            return None
        self._ends_with_peer = True
        self.write(handshake.answer)
        return handshake.codec

    def begin(self, codec: Codec) -> Session:
        """Return the session of the peer, which uses this codec. Without a token it is admitted with its first valid message."""
        session = self._service.session(codec, self._outbox, self.wake)
        if self._service.token is None:
            session.admit()
        else:
            self._full_limit, codec.limit = codec.limit, STRANGER_LIMIT
        return session

    def step(self) -> bool:
        """Carry out one message."""
        session = self._session
        event = None if session is None else session.codec.next_event()
        if session is None or event is None:
            return False
        is_allowed = self._rate.take(self.loop.time())
        if isinstance(event, Control):
            self.take_control(event, is_allowed)
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
        return True

    def _take_from_stranger(self, event: Request | Malformed, session: Session) -> None:
        """Take a message of a peer that has not shown the token. Only a few are answered before a valid `hello`."""
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
