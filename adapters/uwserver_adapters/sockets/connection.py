"""One TCP connection: bytes to requests, answers to bytes, and what happens to a peer that misbehaves.

Nothing a peer does costs more than a bounded amount of memory, and at most `TURN_S` of the loop before others have their turn.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, cast

from uwserver.ports import Fault
from uwserver_adapters.sockets import verbs
from uwserver_adapters.sockets.codec import NEED_DATA, WEB, Codec, Control, JsonCodec, choose_codec
from uwserver_adapters.sockets.limits import RateMeter
from uwserver_adapters.sockets.outbox import Outbox
from uwserver_adapters.sockets.requests import Malformed, Request
from uwserver_adapters.sockets.session import Session
from uwserver_adapters.sockets.websocket import Handshake

if TYPE_CHECKING:
    from uwserver_adapters.sockets.adapter import SocketsAdapter

TURN_S = 0.002
"""Wall time after which the other clients have their turn."""
LINGER_S = 1.0
"""Wall time that a peer has to read the last text."""
TRIES = 3
"""Messages before a valid `hello` where a token is set."""
STRANGER_LIMIT = 1 << 16
"""Longest message of a peer that has not shown the token, bytes."""
HIGH_WATER = 1 << 16
"""Bytes in the transport above which samples wait, and may be dropped, in the outbox."""


class Connection(asyncio.Protocol):
    """Made by the server for each peer; all its methods run on the loop."""

    def __init__(self, adapter: SocketsAdapter) -> None:
        self.is_half_open = False
        self._adapter = adapter
        config = adapter.config
        self._stats = adapter.context.stats
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport
        self._outbox = Outbox(self._write, self._overflow, config.queue_samples, self._stats, config.queue_bytes)
        self._head = b""
        self._session: Session | None = None
        self._closing = False
        self._working = False
        self._turn: asyncio.Handle | None = None
        self._waking: asyncio.Handle | None = None
        self._deadline: asyncio.TimerHandle | None = None
        self._rate = RateMeter(config.max_requests_per_s)
        self._handshake: Handshake | None = None
        self._ends_with_peer = False  # neither TLS nor WebSocket knows a peer that only listens on
        self._tries = 0
        self._full_limit = 0

    # -- life -----------------------------------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; a peer too many is told and sent away."""
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(HIGH_WATER)
        self._ends_with_peer = transport.get_extra_info("sslcontext") is not None
        if not self._adapter.enter(self):
            most = self._adapter.config.max_clients
            text = f"{most} clients are connected: close some, or raise max_clients of the adapter"
            self._adapter.refusals.note("max_clients", text)
            self._farewell(Fault("overload", text))  # a JSON line: which encoding it speaks is not known yet
        elif self._adapter.token is not None:
            self._deadline = self._loop.call_later(self._adapter.config.hello_timeout_s, self._hello_missed)

    def connection_lost(self, error: Exception | None) -> None:
        """End; the peer died, or we closed."""
        self._closing = True
        self._outbox.close()
        for handle in (self._turn, self._waking, self._deadline):
            if handle is not None:
                handle.cancel()
        if self._session is not None:
            self._session.close()
        self._adapter.leave(self)

    def eof_received(self) -> bool:
        """The peer sends nothing more; it may still want to read what it is owed (``echo ... | nc -N``).

        Returns:
            Whether the connection stays open.
        """
        if self._ends_with_peer:
            self.close()
        if self._closing:
            return False
        self.is_half_open = True
        if self._session is not None:
            self._session.step_back()
        if self._turn is None:
            self._finish_if_done()
        return True

    def close(self) -> None:
        """Send what the peer still takes, then close."""
        if not self._closing:
            self._outbox.flush()
            self._begin_closing()
            if self._session is not None:
                self._transport.write(self._session.codec.ending(None))
            self._transport.close()

    def abort(self) -> None:
        """Close at once."""
        self._transport.abort()

    def _begin_closing(self) -> None:
        self._closing = True
        self._outbox.close()
        if self._deadline is not None:
            self._deadline.cancel()
        # A peer that reads nothing would keep its connection, and our memory, for ever.
        self._deadline = self._loop.call_later(LINGER_S, self._transport.abort)

    def _farewell(self, fault: Fault | None, last: bytes = b"") -> None:
        """End the connection with a last text, and leave the peer a moment to read it: closing at once would destroy it on its way, as soon
        as one more byte comes from the peer."""
        if self._closing:
            return
        if fault is not None:
            self._stats.errors += 1
            codec = self._session.codec if self._session is not None else JsonCodec()
            last = codec.error(None, fault) + codec.ending(fault)
        if self._turn is not None:
            self._turn.cancel()
        self._begin_closing()
        self._stats.bytes_sent += len(last)
        self._transport.write(last)
        if not self._transport.can_write_eof():  # TLS
            self._transport.close()
            return
        self._transport.write_eof()
        self._transport.resume_reading()  # to see the peer's end; what it sends is thrown away

    def _hello_missed(self) -> None:
        text = 'this server wants a token: no valid "hello" came in time'
        self._farewell(Fault("denied", text, "token"))

    def _overflow(self, text: str) -> None:
        self._adapter.refusals.note("slow reader", text)
        self._farewell(Fault("overload", text))

    def _finish_if_done(self) -> None:
        if (
            self.is_half_open
            and not self._closing
            and self._outbox.is_empty
            and not (self._session and self._session.is_owed)
        ):
            self._begin_closing()
            self._transport.close()

    # -- out ------------------------------------------------------------------------------------------------------------------------

    def _write(self, message: bytes) -> None:
        self._transport.write(message)

    def pause_writing(self) -> None:
        """The peer reads too slowly."""
        self._outbox.paused = True

    def resume_writing(self) -> None:
        """The peer has read."""
        self._outbox.resume()
        self._finish_if_done()

    def wake(self) -> None:
        """An answer came later than its request; all that come at once are written together."""
        if self._waking is None and not self._working and not self._closing:
            self._waking = self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._waking = None
        self._outbox.flush()
        self._finish_if_done()

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        """Take bytes in pieces of any size."""
        if self._closing:
            return
        session = self._session
        if session is None:
            self._head += data
            codec = self._shake_hands() if self._handshake is not None else choose_codec(self._head)
            if codec is WEB:
                codec = self._open_web()
            if codec is None:
                return
            data = self._head
            session = self._begin(codec)
        session.codec.receive(data)
        if self._turn is None:
            self._work(session)

    def _open_web(self) -> Codec | None:
        self._handshake = Handshake(self._adapter.config.allowed_origins)
        if self._deadline is None:
            self._deadline = self._loop.call_later(self._adapter.config.hello_timeout_s, self.abort)
        return self._shake_hands()

    def _shake_hands(self) -> Codec | None:
        """Go on with the opening of a WebSocket; returns its codec once the peer is let in."""
        handshake = self._handshake
        assert handshake is not None
        self._head = handshake.receive(self._head)
        if handshake.answer is None:
            return None
        if handshake.fault is not None:
            self._stats.errors += 1
            cause = "origin" if handshake.fault.code == "denied" else "handshake"
            self._adapter.refusals.note(cause, handshake.fault.text)
        if handshake.codec is None:
            self._farewell(None, handshake.answer)
            return None
        self._ends_with_peer = True
        if self._adapter.token is None and self._deadline is not None:
            self._deadline.cancel()
        self._transport.write(handshake.answer)
        return handshake.codec

    def _begin(self, codec: Codec) -> Session:
        self._head = b""
        adapter = self._adapter
        session = Session(adapter.next_serial(), codec, self._outbox, adapter.fanout, self.wake, adapter.allowance)
        self._session = session
        if self._adapter.token is None:
            session.admit()
        else:
            self._full_limit, codec.limit = codec.limit, STRANGER_LIMIT
        return session

    def _work(self, session: Session) -> None:
        """Carry out what was received, for one turn."""
        self._turn = None
        loop = self._loop
        end = loop.time() + TURN_S
        self._working = True
        try:
            while not self._closing:
                event = session.codec.next_event()
                if event is NEED_DATA:
                    self._await_data(session)
                    break
                self._take(event, session)
                if loop.time() >= end:
                    self._transport.pause_reading()
                    self._turn = loop.call_soon(self._work, session)
                    break
        finally:
            self._working = False
        self._outbox.flush()
        if self._turn is None:
            self._finish_if_done()

    def _await_data(self, session: Session) -> None:
        """All is done: read on, or at the end of the window when the peer floods."""
        if self._rate.is_flooded(self._loop.time()):
            self._transport.pause_reading()
            self._turn = self._loop.call_at(self._rate.end, self._work, session)
        elif not self.is_half_open:
            self._transport.resume_reading()

    def _take(self, event: Request | Malformed | Control, session: Session) -> None:
        is_allowed = self._rate.take(self._loop.time())
        if isinstance(event, Control):
            self._take_control(event, is_allowed)
        elif not session.admitted:
            self._take_from_stranger(event, session)
        elif not is_allowed:
            text = f"more than {self._rate.most} requests a second: send fewer, or raise max_requests_per_s"
            self._adapter.refusals.note("rate", text)
            session.refuse(event.id, Fault("overload", text))
        elif isinstance(event, Request):
            self._carry_out(event, session)
        else:
            self._adapter.refusals.note(event.fault.code, event.fault.text)
            if event.fatal:
                self._outbox.flush()
                self._farewell(event.fault)
            else:
                session.refuse(event.id, event.fault)

    def _take_control(self, control: Control, is_allowed: bool) -> None:
        if control.ends:
            self._outbox.flush()
            self._begin_closing()
            self._transport.write(control.data)
            self._transport.close()
        elif is_allowed:
            self._outbox.put_reply(control.data)

    def _take_from_stranger(self, event: Request | Malformed, session: Session) -> None:
        """Before a valid `hello` nothing else is answered, and not often."""
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
            if self._deadline is not None:
                self._deadline.cancel()
        elif self._tries >= TRIES or (isinstance(event, Malformed) and event.fatal):
            self._outbox.flush()
            text = 'too many messages without a valid "hello"'
            self._adapter.refusals.note("denied", text)
            self._farewell(Fault("denied", text, "token"))

    def _carry_out(self, request: Request, session: Session) -> None:
        try:
            verbs.take(session, request, self._adapter.token)
        except verbs.Rejected as rejected:
            self._adapter.refusals.note(rejected.fault.code, rejected.fault.text)
            session.refuse(request.id, rejected.fault)
            self._outbox.flush()
            self._farewell(None, session.codec.ending(rejected.fault))
