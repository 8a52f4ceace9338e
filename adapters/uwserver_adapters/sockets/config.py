"""The adapter's table in a scenario."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.adapter import STRANGERS, UNANSWERED, AdapterTable
from uwserver.table import Name, Positive
from uwserver_adapters.native.outbox import QUEUE_BYTES
from uwserver_adapters.native.session import SUBSCRIPTIONS

_Count = Annotated[int, Meta(ge=1)]


class SocketsConfig(AdapterTable, tag="sockets", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at; anything but loopback needs a token.
    port: TCP port; 0 takes a free one.
    token: clients must show it; default: the environment's UWSERVER_TOKEN. If there is none and bind is not loopback, a token is generated and
        printed.
    udp_port: UDP port; 0 takes a free one; none by default.
    udp_lease_s: wall time after which a silent UDP client is forgotten, s.
    allowed_origins: pages that may connect by WebSocket: an origin ("http://localhost:8000"), an origin with ":*" for any port, or "*" for all;
        by default none may.
    allowed_hosts: names of this server that WebSocket clients other than browsers may use, besides its addresses and localhost; "*" for any.
    tls_cert: certificate (PEM); with it, TCP and WebSocket are served over TLS only. A relative path starts from the folder in which the
        server was started; so do the next two.
    tls_key: its key (PEM); default: in the file of the certificate.
    tls_client_ca: authorities (PEM) of client certificates, which are then required.
    queue_samples: most samples that wait for a slow client; the oldest is dropped first.
    queue_bytes: most bytes of samples, and of replies, that wait for a slow client.
    max_requests_per_s: most requests of one client; more are refused.
    max_subscriptions: most subscriptions of one client.
    max_unanswered: most commands and calls of one client that wait for the world.
    max_clients: most admitted clients at a time; a client is admitted by its token, or by a valid message where no token is needed.
    max_clients_per_host: most admitted clients of one host other than this machine.
    max_strangers: most further connections that are not admitted yet; the oldest is closed first.
    hello_timeout_s: wall time in which a client must be admitted, s; it has as long before that for a TLS handshake.
    """

    bind: Name = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 7600
    token: Name | None = None
    udp_port: Annotated[int, Meta(ge=0, le=65535)] | None = None
    udp_lease_s: Positive = 10.0
    allowed_origins: tuple[Name, ...] = ()
    allowed_hosts: tuple[Name, ...] = ()
    tls_cert: Name | None = None
    tls_key: Name | None = None
    tls_client_ca: Name | None = None
    queue_samples: _Count = 1024
    queue_bytes: _Count = QUEUE_BYTES
    max_requests_per_s: _Count = 50_000
    max_subscriptions: _Count = SUBSCRIPTIONS
    max_unanswered: _Count = UNANSWERED
    max_clients: _Count = 256
    max_clients_per_host: _Count = 128
    max_strangers: _Count = STRANGERS
    hello_timeout_s: Positive = 10.0
