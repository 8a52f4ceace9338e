"""One connection: converts bytes to messages of rosbridge and back, and deals with clients that misbehave."""

from __future__ import annotations

import hmac
from collections.abc import Callable
from urllib.parse import parse_qs, urlsplit

from websockets.http11 import Request

from uwserver.adapter import Lockout, Peer, Peers
from uwserver.ports import Fault
from uwserver_adapters.native.codec import Control
from uwserver_adapters.native.connection import OutboxConnection
from uwserver_adapters.native.messages import Malformed
from uwserver_adapters.native.outbox import Outbox
from uwserver_adapters.native.websocket import Handshake
from uwserver_adapters.rosbridge.codec import MessageCodec, Text
from uwserver_adapters.rosbridge.hub import Hub
from uwserver_adapters.rosbridge.session import Session

NO_PAGE = b"HTTP/1.1 426 Upgrade Required\r\nUpgrade: websocket\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\nThis is rosbridge: open a WebSocket.\n"  # noqa: E501

Begin = Callable[[Outbox, Callable[[], None]], Session]
"""Makes the session of a client that is admitted, from its outbox and the function that wakes its connection."""


class RosbridgeConnection(OutboxConnection):
    """The connection of one peer.

    Args:
        hub: what all clients share.
        token: the token that clients must show; None where none is needed.
        lockout: hosts that have shown wrong tokens.
        peers: peers of the adapter.
        begin: makes the session.
    """

    def __init__(self, hub: Hub, token: str | None, lockout: Lockout, peers: Peers[Peer], begin: Begin) -> None:
        config = hub.config
        super().__init__(peers, config, hub.context.stats, config.max_requests_per_s)
        self._hub, self._token, self._lockout, self._begin = hub, token, lockout, begin
        self._handshake: Handshake | None = None
        self._codec: MessageCodec | None = None
        self._session: Session | None = None

    # -- admission -------------------------------------------------------------------------------------------------------------------------

    def takes_http(self, head: bytes) -> bool:
        """Take a GET, which may open a WebSocket, and no other request."""
        if not head.startswith(b"GET "):
            return False
        config = self._hub.config
        self._handshake = Handshake(
            config.allowed_origins, config.allowed_hosts, speaks=MessageCodec, check=self._objection
        )
        return True

    def _objection(self, request: Request) -> Fault | None:
        """Return why a request is refused for its token; None where it is not."""
        if self._token is None:
            return None
        now = self.loop.time()
        if self._lockout.is_out(self.host, now):
            return self._lockout.fault
        shown = parse_qs(urlsplit(request.path).query).get("token", [])
        shown += [
            value.partition(" ")[2].strip()
            for value in request.headers.get_all("Authorization")
            if value.lower().startswith("bearer ")
        ]
        if any(hmac.compare_digest(one.encode(), self._token.encode()) for one in shown):
            return None
        if shown:
            self._lockout.wrong(self.host, now)
        return Fault("denied", "this server wants a token: add ?token=... to the address", "token")

    def receive(self, data: bytes) -> None:
        """Store bytes; the first ones belong to the handshake."""
        if self._codec is None:
            if self._handshake is None:
                self.farewell(b"this port speaks rosbridge: open a WebSocket\n")
                return
            data = self._handshake.receive(data)
            if not self._let_in(self._handshake):
                return
        assert self._codec is not None
        self._codec.receive(data)

    def _let_in(self, handshake: Handshake) -> bool:
        if handshake.answer is None:
            return False
        codec = handshake.codec
        if not isinstance(codec, MessageCodec):
            self._stats.errors += 1
            self._hub.refusals.note(*handshake.refusal)
            # Without a fault the peer only asked for a page.
            self.farewell(NO_PAGE if handshake.fault is None else handshake.answer)
            return False
        self.write(handshake.answer)
        self._codec = codec
        if not self.admit():
            return False
        self._session = self._begin(self._outbox, self.wake)
        return True

    def refused(self, fault: Fault) -> bytes:
        """Return the close frame for a client for which there is no place."""
        return self._codec.ending(fault) if self._codec is not None else b""

    # -- messages ---------------------------------------------------------------------------------------------------------------------------

    def step(self) -> bool:
        """Carry out one message."""
        if self._codec is None or self._session is None:
            return False
        event: object = self._codec.next_event()
        if event is None:
            return False
        is_allowed = self._rate.take(self.loop.time())
        if isinstance(event, Control):
            self.take_control(event, is_allowed)
        elif isinstance(event, Malformed):
            self._hub.refusals.note(event.fault.code, event.fault.text)
            self._outbox.flush()
            self.farewell(self._codec.ending(event.fault))
        elif not is_allowed:
            text = f"more than {self._rate.most} messages a second: send fewer, or raise max_requests_per_s"
            self._session.overloaded(text)
        elif isinstance(event, Text):
            self._session.take(event)
        return True

    def overflow(self, text: str) -> None:
        """End the connection, because too much waits for the client."""
        self._hub.refusals.note("slow reader", text)
        self._stats.errors += 1
        if not self.is_closing and self._codec is not None:
            self.farewell(self._codec.ending(Fault("overload", text)))

    # -- its end ----------------------------------------------------------------------------------------------------------------------------

    def missed(self) -> None:
        """End the connection, as no WebSocket was opened in time."""
        self.abort()

    def eof_received(self) -> bool:
        """End the connection: in a WebSocket no peer stops sending but goes on listening."""
        self.close()
        return super().eof_received()

    def close(self) -> None:
        """Send what the peer still takes, then close."""
        self._outbox.flush()
        if self._codec is not None:
            self.write(self._codec.ending(None))
        super().close()

    def closed(self) -> None:
        """End the session."""
        self.stop()
        if self._session is not None:
            self._session.close()
