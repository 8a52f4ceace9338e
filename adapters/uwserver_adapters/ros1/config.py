"""The adapter's table in a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta

from uwserver.adapter import STRANGERS, NodeTable
from uwserver.table import Count, Name, PortNumber, Positive

_NodeName = Annotated[str, Meta(pattern=r"^(/[A-Za-z][A-Za-z0-9_]*)+$")]


class Ros1Config(NodeTable, tag="ros1", kw_only=True, frozen=True):
    """Attributes:
    master: address of the ROS master; default: the environment's ROS_MASTER_URI, or http://127.0.0.1:11311.
    node: name of this node.
    bind: address to listen at, for calls of other nodes and for topics and services. ROS 1 has no tokens: anything but loopback needs
        allow_network.
    api_port, tcpros_port: TCP ports; 0 takes free ones.
    allowed_hosts: hosts, besides this machine and that of the master, to which this node connects when the master names a publisher there.
    sim_time: set the parameter /use_sim_time at the master, so that nodes that start later take their time from /clock.
    tf: source of the poses of vehicles on ``/tf``: the autopilot's "estimate", the "truth" (with truth = true), or "none".
    geoid_m: height of the sea surface above the ellipsoid, m; NavSatFix counts heights from the ellipsoid.
    clock_hz: most messages of ``/clock`` in a simulated second.
    queue_bytes: most bytes that wait for a slow subscriber; further messages are dropped.
    max_requests_per_s: most messages of one publisher, or calls of one client; more are refused.
    max_clients: most subscribers, service clients and callers.
    max_strangers: most further connections that have said nothing valid yet.
    hello_timeout_s: wall time in which a connection must say what it wants, s.
    """

    master: Name | None = None
    node: _NodeName = "/uwserver"
    api_port: PortNumber = 0
    tcpros_port: PortNumber = 0
    allowed_hosts: tuple[Name, ...] = ()
    sim_time: bool = True
    tf: Literal["estimate", "truth", "none"] = "estimate"
    geoid_m: float = 0.0
    clock_hz: Annotated[float, Meta(gt=0, le=1000)] = 100.0
    queue_bytes: Count = 1 << 20
    max_requests_per_s: Count = 2000
    max_clients: Count = 256
    max_strangers: Count = STRANGERS
    hello_timeout_s: Positive = 10.0

    def needs(self) -> Mapping[str, str]:
        """See `AdapterTable.needs`."""
        return {"rosbags": "uwserver[ros]"}
