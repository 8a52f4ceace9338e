"""The adapter's table in a scenario."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.adapter import STRANGERS, NodeTable
from uwserver.table import Count, Name, PortNumber, Positive

_Prefix = Annotated[str, Meta(pattern=r"^(/[A-Za-z0-9_.\-]+)+$")]


class YarpConfig(NodeTable, tag="yarp", kw_only=True, frozen=True):
    """Attributes:
    name_server: host and port of the YARP name server (yarpserver).
    prefix: prefix of the names of all ports.
    first_port: TCP port of the first port. Each port has the next one, or the one after that where it is in use; 0 takes free ones.
    ports: patterns of the ports of the world that are served; each needs a socket.
    vectors: patterns of sensors whose samples are sent as one vector of all their numbers, for readers of `yarp::sig::Vector`.
    clock_hz: most messages of ``/clock`` below the prefix in a simulated second.
    allowed_hosts: hosts, besides this machine and that of the name server, to which ports connect when somebody asks for it (`yarp connect`).
    queue_bytes: most bytes that wait for a slow reader; further samples are dropped.
    max_requests_per_s: most messages of one peer; more are not read until the second is over.
    max_clients: most connections, including those that this server makes.
    max_strangers: most further connections that have said nothing valid yet.
    hello_timeout_s: wall time in which a connection must say who it is, s.
    """

    name_server: Name = "127.0.0.1:10000"
    prefix: _Prefix = "/uwserver"
    first_port: PortNumber = 0
    ports: tuple[Name, ...] = ("**",)
    vectors: tuple[Name, ...] = ()
    clock_hz: Annotated[float, Meta(gt=0, le=1000)] = 100.0
    allowed_hosts: tuple[Name, ...] = ()
    queue_bytes: Count = 1 << 20
    max_requests_per_s: Count = 2000
    max_clients: Count = 256
    max_strangers: Count = STRANGERS
    hello_timeout_s: Positive = 10.0
