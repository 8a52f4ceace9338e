"""One TCP connection of the `sockets` adapter."""

from __future__ import annotations

from uwserver.adapter import AdapterContext, Peer, Peers, is_loopback
from uwserver.ports import Progress, Refused, Reply
from uwserver_adapters.native.connection import TRIES, NativeConnection
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.websocket import Handshake
from uwserver_adapters.sockets.config import SocketsConfig

__all__ = ["TRIES", "Connection"]


class Connection(NativeConnection):
    """A peer that speaks JSON lines, msgpack frames or WebSocket."""

    def __init__(self, service: NativeService, config: SocketsConfig, peers: Peers[Peer]) -> None:
        def handshake() -> Handshake:
            # Its address is one of this machine, and leads nowhere from another, or from outside a container.
            page = page_of(service.context) if is_loopback(self.host) else ""
            return Handshake(config.allowed_origins, config.allowed_hosts, page)

        super().__init__(service, config, peers, handshake)


def page_of(context: AdapterContext) -> str:
    """Address of the page that another adapter of this server shows; "" where none does."""
    answers: list[Reply | Progress] = []
    try:
        context.call("world/status", {}, "sockets", answers.append)
    except Refused:
        return ""
    for answer in answers:
        adapters = (
            answer.result.get("adapters") if isinstance(answer, Reply) and isinstance(answer.result, dict) else None
        )
        for stats in adapters.values() if isinstance(adapters, dict) else ():
            if isinstance(stats, dict) and stats["state"] == "running" and str(stats["address"]).startswith("http"):
                return str(stats["address"])
    return ""
