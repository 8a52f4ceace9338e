"""One TCP connection of the `sockets` adapter."""

from __future__ import annotations

import contextlib

from uwserver.adapter import AdapterContext, Peer, Peers, is_loopback
from uwserver.ports import Progress, Refused, Reply
from uwserver_adapters.native.connection import TRIES, NativeConnection
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.websocket import Handshake
from uwserver_adapters.sockets.config import SocketsConfig

__all__ = ["TRIES", "Connection"]


class Connection(NativeConnection):
    """A peer that uses JSON lines, msgpack frames or WebSocket."""

    def __init__(self, service: NativeService, config: SocketsConfig, peers: Peers[Peer]) -> None:
        def handshake() -> Handshake:
            # The address of the page is only valid on this machine: not on another, nor outside a container.
            page = page_of(service.context) if is_loopback(self.host) else ""
            return Handshake(config.allowed_origins, config.allowed_hosts, page)

        super().__init__(service, config, peers, handshake)


def page_of(context: AdapterContext) -> str:
    """Return the address of the page that another adapter of this server shows; "" where none does."""
    answers: list[Reply | Progress] = []
    with contextlib.suppress(Refused):
        context.call("world/status", {}, "sockets", answers.append)
    for answer in answers:
        status = answer.result if isinstance(answer, Reply) else None
        adapters = status.get("adapters") if isinstance(status, dict) else None
        for stats in adapters.values() if isinstance(adapters, dict) else ():
            if isinstance(stats, dict) and stats["state"] == "running" and str(stats["address"]).startswith("http"):
                return str(stats["address"])
    return ""
