"""One TCP connection of the `sockets` adapter."""

from __future__ import annotations

from uwserver.adapter import Peer, Peers
from uwserver_adapters.native.connection import TRIES, NativeConnection
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.websocket import Handshake
from uwserver_adapters.sockets.config import SocketsConfig

__all__ = ["TRIES", "Connection"]


class Connection(NativeConnection):
    """A peer that speaks JSON lines, msgpack frames or WebSocket."""

    def __init__(self, service: NativeService, config: SocketsConfig, peers: Peers[Peer]) -> None:
        super().__init__(service, config, peers, lambda: Handshake(config.allowed_origins, config.allowed_hosts))
