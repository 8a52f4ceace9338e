"""The TLS handshake of one peer, before it is a connection: bounded in time and number, and its failures are told once per cause."""

from __future__ import annotations

import asyncio
import os
import socket
import ssl
from typing import cast

from uwserver.adapter import Peer, Peers
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.sockets.config import SocketsConfig
from uwserver_adapters.sockets.connection import Connection

_PLAIN = ("HTTP_REQUEST", "WRONG_VERSION_NUMBER", "UNKNOWN_PROTOCOL", "RECORD_LAYER_FAILURE", "PACKET_LENGTH_TOO_LONG")
_TOO_OLD = ("UNSUPPORTED_PROTOCOL", "VERSION_TOO_LOW")
_NO_CERTIFICATE = ("PEER_DID_NOT_RETURN_A_CERTIFICATE", "CERTIFICATE_VERIFY_FAILED")


class Doorway(asyncio.Protocol):
    """Takes a peer from its TCP connection to a `Connection` on top of TLS.

    The server would start TLS by itself, but then its end could not wait for handshakes, and nobody would learn why one failed.

    Args:
        service, config, peers: of the connection that it may become.
        handshakes: those under way.
        context: of TLS.
    """

    def __init__(
        self,
        service: NativeService,
        config: SocketsConfig,
        peers: Peers[Peer],
        handshakes: set[asyncio.Task[None]],
        context: ssl.SSLContext,
    ) -> None:
        self._service = service
        self._config = config
        self._peers = peers
        self._handshakes = handshakes
        self._context = context

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin the handshake on the peer's socket, unless too many are under way."""
        plain = cast(asyncio.Transport, transport)
        tasks = self._handshakes
        if len(tasks) >= self._config.max_clients:
            text = f"{len(tasks)} TLS handshakes are under way: raise max_clients of the adapter"
            self._service.refusals.note("max_clients", text)
        else:
            peer = socket.socket(fileno=os.dup(plain.get_extra_info("socket").fileno()))
            peer.setblocking(False)
            task = asyncio.get_running_loop().create_task(self._shake_hands(peer))
            tasks.add(task)
            task.add_done_callback(tasks.discard)
        plain.abort()  # nothing was read yet, and the copy of the socket stays open

    async def _shake_hands(self, peer: socket.socket) -> None:
        seconds = self._config.hello_timeout_s
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: Connection(self._service, self._config, self._peers),
                peer,
                ssl=self._context,
                ssl_handshake_timeout=seconds,
            )
        except ssl.SSLError as error:
            self._refuse(str(error.reason or "unknown"))
        except ConnectionAbortedError:
            self._refuse("TIMEOUT")
        except OSError:
            pass  # it went away; port scanners and health checks do

    def _refuse(self, reason: str) -> None:
        self._service.context.stats.errors += 1
        self._service.refusals.note(
            f"tls {_cause(reason)}", f"a TLS handshake failed ({reason.lower()}): {_remedy(reason)}"
        )


def _cause(reason: str) -> str:
    for cause, reasons in (
        ("plain client", _PLAIN),
        ("old version", _TOO_OLD),
        ("client certificate", _NO_CERTIFICATE),
    ):
        if reason in reasons:
            return cause
    return "timeout" if reason == "TIMEOUT" else "failure"


def _remedy(reason: str) -> str:
    return {
        "plain client": "this port speaks TLS only, connect with TLS (wss:// in a browser)",
        "old version": "TLS 1.2 is the least",
        "client certificate": "a client needs a certificate of tls_client_ca",
        "timeout": "it took longer than hello_timeout_s",
    }.get(_cause(reason), "check the client's TLS settings and its trust in tls_cert")
