"""Serves ``/health`` and ``/metrics`` over HTTP: requests without a body, one per connection, and nothing that a web page could use."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import AsyncIterator, Callable, Sequence
from functools import partial

from uwserver.adapter import (
    AdapterStats,
    Connection,
    Peers,
    Refusals,
    http_answer,
    is_host_known,
    serve_tcp,
)
from uwserver.adapter.http import HEAD_END, HEAD_LIMIT, parse
from uwserver.ports import Json

log = logging.getLogger(__name__)

REQUEST_TIMEOUT_S = 5.0
"""Wall time in which a peer must have sent its request, and then the same time in which it must have read the answer."""
MOST_PEERS = 64
"""Most connections at a time; a new one closes the oldest."""


class Service:
    """Answers requests.

    Args:
        status: returns the status of the server.
        metrics: returns its metrics in Prometheus' text format.
        hosts: names by which it may be asked, see `is_host_known`.
        refusals: takes the reasons of refused requests.
    """

    def __init__(
        self,
        status: Callable[[], dict[str, Json]],
        metrics: Callable[[], bytes],
        hosts: Sequence[str],
        refusals: Refusals,
    ) -> None:
        self._status = status
        self._metrics = metrics
        self._hosts = hosts
        self._refusals = refusals

    def answer(self, head: bytes) -> bytes:
        """Return the answer to the head of a request."""
        request = parse(head)
        if request is None:
            return http_answer("400 Bad Request", "this is no request of HTTP/1.1\n")
        method, with_body = request.method, request.method != "HEAD"
        for name in request.headers.get("host", ()):
            if not is_host_known(name, self._hosts):
                # A web page whose host name was made to point here (DNS rebinding) could read the answer.
                text = f'"{name[:200]}" is no known name of this server: ask by address, or add it to [server] allowed_hosts'
                self._refusals.note("host", text)
                return http_answer("421 Misdirected Request", f"{text}\n", body=with_body)
        if method not in ("GET", "HEAD"):
            self._refusals.note("method", f"{method[:20]} is neither GET nor HEAD")
            return http_answer("405 Method Not Allowed", "ask with GET or HEAD\n", "Allow: GET, HEAD\r\n")
        return self._answer(request.target, with_body)

    def _answer(self, path: str, with_body: bool) -> bytes:
        try:
            if path == "/metrics":
                text = self._metrics().decode()
                return http_answer("200 OK", text, kind="text/plain; version=0.0.4; charset=utf-8", body=with_body)
            if path == "/health":
                now = self._status()
                code = "503 Service Unavailable" if now["failure"] else "200 OK"
                return http_answer(code, json.dumps(now), kind="application/json", body=with_body)
        except Exception:  # A fault of ours is reported to the peer, too.
            log.exception("%s failed", path)
            return http_answer("500 Internal Server Error", "the server failed to answer: see its log\n")
        return http_answer("404 Not Found", "there are /health and /metrics here\n", body=with_body)


class Asker(Connection):
    """One peer with one request.

    Args:
        service: answers the request.
        peers: all present peers.
    """

    def __init__(self, service: Service, peers: Peers[Asker]) -> None:
        super().__init__(peers, REQUEST_TIMEOUT_S)
        self._service = service
        self._head = bytearray()
        self._is_http = False

    def takes_http(self, head: bytes) -> bool:
        """Take the whole request as HTTP."""
        self._is_http = True
        return True

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._head += data

    def step(self) -> bool:
        """Answer once the head is complete. Bytes that are no HTTP get no answer."""
        end = self._head.find(HEAD_END, 0, HEAD_LIMIT)
        if end >= 0 and self._is_http:
            self.farewell(self._service.answer(bytes(self._head[:end])), REQUEST_TIMEOUT_S)
        elif not self._is_http or len(self._head) >= HEAD_LIMIT:
            self.abort()
        return False

    def missed(self) -> None:
        """Close the connection, as the request was not complete in time."""
        self.abort()


@contextlib.asynccontextmanager
async def serve_http(
    bind: str,
    port: int,
    status: Callable[[], dict[str, Json]],
    metrics: Callable[[], bytes],
    hosts: Sequence[str] = (),
) -> AsyncIterator[int]:
    """Serve ``/health`` (200, or 503 after a failure) and ``/metrics`` while the context is open; gives the bound port.

    Args:
        bind, port: the address; port 0 takes a free one.
        status, metrics, hosts: see `Service`.

    Raises:
        CannotListen: the address is not available.
    """
    refusals = Refusals("/health and /metrics", AdapterStats(), asyncio.get_running_loop().time)
    service = Service(status, metrics, hosts, refusals)
    peers: Peers[Asker] = Peers(0, refusals, strangers=MOST_PEERS)
    async with serve_tcp(partial(Asker, service, peers), peers, bind, port, key="[server] metrics_port") as server:
        yield server.port
