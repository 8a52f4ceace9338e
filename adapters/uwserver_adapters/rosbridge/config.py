"""The adapter's table in a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta

from uwserver.adapter import STRANGERS, AdapterTable
from uwserver.table import Name, Positive

_Count = Annotated[int, Meta(ge=1)]


class RosbridgeConfig(AdapterTable, tag="rosbridge", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at; anything but loopback needs a token.
    port: TCP port; 0 takes a free one.
    ros_distro: distribution whose types clients expect; noetic for those of ROS 1.
    token: clients must show it, as ``?token=...`` of the address or as ``Authorization: Bearer ...``; default: the environment's UWSERVER_TOKEN.
        If there is none and bind is not loopback, a token is generated and printed.
    tf: source of the poses of vehicles on ``/tf``: the autopilot's "estimate", the "truth" (with truth = true), or "none".
    geoid_m: height of the sea surface above the ellipsoid, m; NavSatFix counts heights from the ellipsoid.
    clock_hz: most messages of ``/clock`` in a simulated second.
    allowed_origins, allowed_hosts: as for `sockets`.
    tls_cert, tls_key, tls_client_ca: as for `sockets`; the address then begins with wss.
    queue_samples, queue_bytes: most samples and bytes that wait for a slow client, as for `sockets`; as many bytes wait for one that throttles.
    max_requests_per_s: most messages of one client; more are refused.
    max_subscriptions: most subscriptions of one client, over all topics together; also most advertisements, and services that it offers.
    max_unanswered: most commands and calls of one client that wait for the world.
    max_clients: most clients at a time.
    max_strangers: most further connections that have not opened a WebSocket yet; the oldest is closed first.
    hello_timeout_s: wall time in which a WebSocket must be open, s.
    """

    bind: Name = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 9090
    ros_distro: Literal["noetic", "humble", "jazzy", "kilted", "rolling"] = "jazzy"
    token: Name | None = None
    tf: Literal["estimate", "truth", "none"] = "estimate"
    geoid_m: float = 0.0
    clock_hz: Annotated[float, Meta(gt=0, le=1000)] = 100.0
    allowed_origins: tuple[Name, ...] = ()
    allowed_hosts: tuple[Name, ...] = ()
    tls_cert: Name | None = None
    tls_key: Name | None = None
    tls_client_ca: Name | None = None
    queue_samples: _Count = 1024
    queue_bytes: _Count = 16 << 20
    max_requests_per_s: _Count = 20_000
    max_subscriptions: _Count = 1024
    max_unanswered: _Count = 1024
    max_clients: _Count = 64
    max_strangers: _Count = STRANGERS
    hello_timeout_s: Positive = 10.0

    def needs(self) -> Mapping[str, str]:
        """See `AdapterTable.needs`."""
        return {"rosbags": "uwserver[ros]"}
