"""``/health`` and ``/metrics`` over HTTP, by the library that serves WebSocket too."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import AsyncIterator, Callable
from http import HTTPStatus
from typing import TYPE_CHECKING

from uwserver.ports import Json

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

log = logging.getLogger(__name__)

REQUEST_TIMEOUT_S = 5.0
"""Wall time in which a peer must have sent its request, and again in which it must have taken the answer."""

# The library tells of every connection, and of every peer that sends nonsense.
_quiet = logging.getLogger(f"{__name__}.websockets")
_quiet.setLevel(logging.CRITICAL)

Answer = tuple[HTTPStatus, str, bytes]
"""Status, content type, body."""


@contextlib.asynccontextmanager
async def serve_http(
    bind: str, port: int, status: Callable[[], dict[str, Json]], metrics: Callable[[], bytes]
) -> AsyncIterator[int]:
    """Serve ``/health`` (200, or 503 after a failure) and ``/metrics`` while the context is open; gives the bound port.

    Raises:
        OSError: the address cannot be had.
    """
    # Imported when the port is opened: it costs as much as all else that a server imports.
    from websockets.asyncio.server import ServerConnection, serve

    peers: set[Peer] = set()

    class Peer(ServerConnection):
        """Known from its first byte on, so that the end of the server need not wait for one that says nothing."""

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            peers.add(self)

        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            peers.discard(self)

    def respond(_: ServerConnection, request: Request) -> Response:
        return _response(request, _answer(request.path, status, metrics))

    server = await serve(
        _nothing_else, bind, port, process_request=respond, server_header=None, compression=None, logger=_quiet,
        open_timeout=REQUEST_TIMEOUT_S, close_timeout=REQUEST_TIMEOUT_S, create_connection=Peer,
    )  # fmt: skip
    try:
        yield next(iter(server.sockets)).getsockname()[1]
    finally:
        server.close()
        for peer in list(peers):
            peer.transport.abort()
        await server.wait_closed()


async def _nothing_else(connection: ServerConnection) -> None:
    """No request becomes a WebSocket: each has its answer before."""


def _answer(path: str, status: Callable[[], dict[str, Json]], metrics: Callable[[], bytes]) -> Answer:
    try:
        if path == "/metrics":
            return HTTPStatus.OK, "text/plain; version=0.0.4; charset=utf-8", metrics()
        if path == "/health":
            now = status()
            is_well = HTTPStatus.SERVICE_UNAVAILABLE if now["failure"] else HTTPStatus.OK
            return is_well, "application/json", json.dumps(now).encode()
    except Exception:  # a fault of ours is told to who asks, too
        log.exception("%s failed", path)
        return HTTPStatus.INTERNAL_SERVER_ERROR, "text/plain", b"the server failed to answer: see its log\n"
    return HTTPStatus.NOT_FOUND, "text/plain", b"there are /health and /metrics here\n"


def _response(request: Request, answer: Answer) -> Response:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    code, kind, body = answer
    headers = Headers({"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close"})
    # Releases of the library that know no other method than GET do not say which it was.
    is_head = getattr(request, "method", "GET") == "HEAD"
    return Response(code.value, code.phrase, headers, b"" if is_head else body)
