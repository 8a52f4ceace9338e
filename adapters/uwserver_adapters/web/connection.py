"""One connection of a browser, and what all connections share: a request and its answer, or the live data of a page over a WebSocket."""

from __future__ import annotations

import socket
from typing import Final

from websockets.frames import Frame, Opcode

from uwserver.adapter import AdapterContext, Peer, Peers
from uwserver.adapter.http import HEAD_END, HEAD_LIMIT, Request, parse
from uwserver.ports import Json
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.connection import NativeConnection
from uwserver_adapters.native.messages import Notice
from uwserver_adapters.native.session import Allowance, Session
from uwserver_adapters.native.websocket import Handshake
from uwserver_adapters.web.config import WebConfig
from uwserver_adapters.web.pages import Pages
from uwserver_adapters.web.service import WebService
from uwserver_adapters.web.site import LIVE, Answer, Files, Site, page_folder, text

PIECE: Final = 1 << 16
"""Bytes of an answer that are given to the transport at a time."""
TAKEN_S: Final = 5.0
"""Wall time in which a peer must have taken the last piece."""
SEND_BUFFER: Final = 1 << 16
"""Bytes of live data that the kernel buffers: what waits there is old when it arrives."""


class WebConnection(NativeConnection):
    """The connection of one browser.

    Args:
        service: the native protocol for pages.
        site: the answers to HTTP requests.
        config: the adapter's table.
        peers: the adapter's connections.

    Attributes:
        serial: serial number of its session; 0 before.
        wants_frames: see `Page`.
    """

    def __init__(self, service: WebService, site: Site, config: WebConfig, peers: Peers[Peer]) -> None:
        super().__init__(service, config, peers, self._open_handshake)
        self.serial = 0
        self.wants_frames = False
        self._web = service
        self._site = site
        self._config = config
        self._is_http = False
        self._head = bytearray()
        self._request: Request | None = None
        self._is_answering = False
        self._rest: memoryview | None = None

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def takes_http(self, head: bytes) -> bool:
        """Take all HTTP requests."""
        self._is_http = True
        return True

    def receive(self, data: bytes) -> None:
        """Store received bytes. A complete request is answered, or opens a WebSocket."""
        if not self._is_http:
            self.farewell(b"this port only speaks HTTP: open it in a browser\n")
            return
        if self._request is not None:
            if not self._is_answering:
                super().receive(data)
            return
        self._head += data
        end = self._head.find(HEAD_END, 0, HEAD_LIMIT)
        if end < 0:
            if len(self._head) >= HEAD_LIMIT:
                self._answer(text("431 Request Header Fields Too Large", "the head of this request is too long"))
            return
        request = parse(bytes(self._head[:end]))
        if request is None:
            self._answer(text("400 Bad Request", "this is no HTTP/1.1 request"))
            return
        self._request = request
        if request.path == LIVE and "upgrade" in request.headers and request.method == "GET":
            self._upgrade(request)
        else:
            self._is_answering = True
            self._site.answer(request, self.host, self._answer)

    def _upgrade(self, request: Request) -> None:
        refused = self._site.objection(request)
        if refused is not None:
            self._stats.errors += 1
            self._answer(refused)
            return
        data, self._head = bytes(self._head), bytearray()
        super().takes_http(data)
        super().receive(data)

    def _open_handshake(self) -> Handshake:
        assert self._request is not None
        return Handshake(self._site.origins(self._request), self._config.allowed_hosts)

    def _answer(self, answer: Answer) -> None:
        """Send an answer in pieces, as fast as the peer takes them, and end the connection."""
        self._is_answering = True
        if self.is_closing:
            return
        is_bodiless = self._request is not None and self._request.method == "HEAD"
        self.write(answer.head())
        self._rest = memoryview(b"" if is_bodiless else answer.body)
        self._pump()

    def _pump(self) -> None:
        while self._rest is not None and not self._outbox.paused and not self.is_closing:
            piece, self._rest = self._rest[:PIECE], self._rest[PIECE:]
            self._stats.bytes_sent += len(piece)
            if len(self._rest):
                self.write(bytes(piece))
            else:
                self._rest = None
                self.farewell(bytes(piece), TAKEN_S)

    def resume_writing(self) -> None:
        """Continue an answer: the peer has read."""
        super().resume_writing()
        self._pump()

    def missed(self) -> None:
        """End a connection that was not admitted in time. A peer that still receives a long file is left alone."""
        if self._is_answering:
            if self._rest is None and not self.is_closing:
                self._answer(text("503 Service Unavailable", "the answer took too long: try again"))
        elif self._request is None:
            self.abort()  # browsers open connections in advance, so nothing is wrong, and nobody would read an answer
        else:
            super().missed()

    def opened(self) -> None:
        """Accept the connection. A locked-out host is told so only when it asks for data: the page itself needs no token."""
        self._ends_with_peer = self.transport.get_extra_info("sslcontext") is not None

    @property
    def has_pending_output(self) -> bool:
        """Whether anything may still be sent."""
        return self._is_answering or super().has_pending_output

    # -- live data ------------------------------------------------------------------------------------------------------------------

    def begin(self, codec: Codec) -> Session:
        """Begin the session of a page."""
        session = super().begin(codec)
        self.serial = session.serial
        stream = self.transport.get_extra_info("socket")
        if stream is not None:
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self._web.open(session, self)
        return session

    def closed(self) -> None:
        """End the session, if there is one."""
        session = self._session
        super().closed()
        if session is not None:
            self._web.end(session)

    @property
    def is_clear(self) -> bool:
        """Whether the transport has taken everything, so that what is sent now arrives in time."""
        return (
            self._session is not None
            and self._session.admitted
            and not self.is_closing
            and not self._outbox.paused
            and self._outbox.is_empty
            and self.waiting == 0
        )

    def send_frame(self, body: bytes) -> None:
        """Send a binary message."""
        data = Frame(Opcode.BINARY, body).serialize(mask=False)
        self._stats.bytes_sent += len(data)
        self.write(data)

    def send_status(self, status: dict[str, Json]) -> None:
        """Send the status in the encoding of the session."""
        session = self._session
        if session is not None:
            self._outbox.put_reply(session.codec.message(Notice("status", status)))
            self._outbox.flush()


class Front:
    """The parts of a web view.

    Args:
        config, context: the adapter's table and context.
        token: token that pages must show; None where none is needed.
        peers: all connections.

    Attributes:
        service: the native protocol for pages.
        pages: the open pages.
        site: the answers to HTTP requests.
    """

    def __init__(self, config: WebConfig, context: AdapterContext, token: str | None, peers: Peers[Peer]) -> None:
        self._config, self._peers = config, peers
        allowance = Allowance(config.max_subscriptions, config.max_unanswered)
        self.service = WebService(
            context,
            (token, config.view_token),
            config.read_only,
            allowance,
            config.max_requests_per_s,
            peers.refusals,
        )
        leases = self.service.rights.leases
        self.pages = Pages(context, self.service.fanout, leases, config.frames_hz, config.shows_poses)
        self.service.pages = self.pages
        self.site = Site(context, config, Files(page_folder()), self.service, peers.refusals)

    def greet(self) -> WebConnection:
        """Return the protocol for a new connection."""
        return WebConnection(self.service, self.site, self._config, self._peers)

    async def close(self) -> None:
        """Send nothing more, and end all threads and tasks."""
        self.pages.close()
        await self.pages.pictures.close()
        await self.service.fanout.close()
        await self.site.close()
