"""The adapter's table in a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta

from uwserver.adapter import STRANGERS
from uwserver.table import Count, PortNumber
from uwserver_adapters.native.outbox import OutboxTable


class RosbridgeConfig(OutboxTable, tag="rosbridge", kw_only=True, frozen=True):
    """Attributes:
    port: TCP port; 0 takes a free one.
    ros_distro: distribution whose types clients expect; noetic for those of ROS 1.
    token: clients must show it, as ``?token=...`` of the address or as ``Authorization: Bearer ...``; default: the environment's UWSERVER_TOKEN.
        If there is none and bind is not loopback, a token is generated and printed.
    tf: source of the poses of vehicles on ``/tf``: the autopilot's "estimate", the "truth" (with truth = true), or "none".
    geoid_m: height of the sea surface above the ellipsoid, m; NavSatFix counts heights from the ellipsoid.
    clock_hz: most messages of ``/clock`` in a simulated second.
    tls_cert: certificate (PEM); with it, the address begins with wss. A relative path starts from the folder in which the server was started.
    queue_bytes: most bytes of samples, and of replies, that wait for a slow client; as many wait for one that throttles.
    max_requests_per_s: most messages of one client; more are refused.
    max_subscriptions: most subscriptions of one client, over all topics together; also most advertisements, and services that it offers.
    max_unanswered: most commands and calls of one client that wait for the world.
    max_clients: most clients at a time.
    max_strangers: most further connections that have not opened a WebSocket yet; the oldest is closed first.
    hello_timeout_s: wall time in which a WebSocket must be open, s.
    """

    port: PortNumber = 9090
    ros_distro: Literal["noetic", "humble", "jazzy", "kilted", "rolling"] = "jazzy"
    tf: Literal["estimate", "truth", "none"] = "estimate"
    geoid_m: float = 0.0
    clock_hz: Annotated[float, Meta(gt=0, le=1000)] = 100.0
    max_requests_per_s: Count = 20_000
    max_subscriptions: Count = 1024
    max_unanswered: Count = 1024
    max_clients: Count = 64
    max_strangers: Count = STRANGERS

    def needs(self) -> Mapping[str, str]:
        """See `AdapterTable.needs`."""
        return {"rosbags": "uwserver[ros]"}
