"""One TCP connection of the `sockets` adapter, and the adapter's table in a scenario."""

from __future__ import annotations

import contextlib

from uwserver.adapter import STRANGERS, UNANSWERED, AdapterContext, Peer, Peers, is_loopback
from uwserver.ports import Progress, Refused, Reply
from uwserver.table import Count, PortNumber, Positive
from uwserver_adapters.native.connection import TRIES, NativeConnection
from uwserver_adapters.native.outbox import OutboxTable
from uwserver_adapters.native.service import NativeService
from uwserver_adapters.native.session import SUBSCRIPTIONS
from uwserver_adapters.native.websocket import Handshake


class SocketsConfig(OutboxTable, tag="sockets", kw_only=True, frozen=True):
    """Attributes:
    port: TCP port; 0 takes a free one.
    udp_port: UDP port; 0 takes a free one; none by default.
    udp_lease_s: wall time after which a silent UDP client is forgotten, s.
    max_requests_per_s: most requests of one client; more are refused.
    max_subscriptions: most subscriptions of one client.
    max_unanswered: most commands and calls of one client that wait for the world.
    max_clients: most admitted clients at a time; a client is admitted by its token, or by a valid message where no token is needed.
    max_clients_per_host: most admitted clients of one host other than this machine.
    max_strangers: most further connections that are not admitted yet; the oldest is closed first.
    """

    port: PortNumber = 7600
    udp_port: PortNumber | None = None
    udp_lease_s: Positive = 10.0
    max_requests_per_s: Count = 50_000
    max_subscriptions: Count = SUBSCRIPTIONS
    max_unanswered: Count = UNANSWERED
    max_clients: Count = 256
    max_clients_per_host: Count = 128
    max_strangers: Count = STRANGERS


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
