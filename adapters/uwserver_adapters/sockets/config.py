"""The adapter's table in a scenario."""

from __future__ import annotations

from uwserver.adapter import STRANGERS, UNANSWERED
from uwserver.table import Count, PortNumber, Positive
from uwserver_adapters.native.outbox import OutboxTable
from uwserver_adapters.native.session import SUBSCRIPTIONS


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
