"""The adapter's table in a scenario."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.adapter import STRANGERS, AdapterTable
from uwserver.table import Name, Positive

_Port = Annotated[int, Meta(ge=0, le=65535)]
_Count = Annotated[int, Meta(ge=1)]
_Prefix = Annotated[str, Meta(pattern=r"^(/[A-Za-z0-9_.\-]+)+$")]


class YarpConfig(AdapterTable, tag="yarp", kw_only=True, frozen=True):
    """Attributes:
    name_server: host and port of the YARP name server (yarpserver).
    prefix: of the names of all ports.
    bind: address to listen at. YARP knows no token: anything but loopback needs allow_network.
    allow_network: whoever reaches the address may read all and command all.
    host: name or address by which others reach this one; default: bind, which must lead here then.
    first_port: TCP port of the first of them, each has one of its own; one that is in use is passed over. 0 takes free ones.
    ports: patterns of the ports of the world that are there, each of which needs a socket.
    vectors: patterns of sensors whose samples are told as one vector of all their numbers, for readers of `yarp::sig::Vector`.
    clock_hz: messages of ``/clock`` below the prefix in a simulated second, at most.
    allowed_hosts: hosts besides this machine and the name server's to which ports connect when somebody asks for it (`yarp connect`).
    queue_bytes: that wait for a slow reader; samples are left out above it.
    max_requests_per_s: messages of one peer; more are not read until the second is over.
    max_clients: connections, both those of others and those that this server makes.
    max_strangers: connected besides, that have said nothing valid yet.
    hello_timeout_s: wall time in which a connection must have said who it is.
    """

    name_server: Name = "127.0.0.1:10000"
    prefix: _Prefix = "/uwserver"
    bind: Name = "127.0.0.1"
    allow_network: bool = False
    host: Name | None = None
    first_port: _Port = 0
    ports: tuple[Name, ...] = ("**",)
    vectors: tuple[Name, ...] = ()
    clock_hz: Annotated[float, Meta(gt=0, le=1000)] = 100.0
    allowed_hosts: tuple[Name, ...] = ()
    queue_bytes: _Count = 1 << 20
    max_requests_per_s: _Count = 2000
    max_clients: _Count = 256
    max_strangers: _Count = STRANGERS
    hello_timeout_s: Positive = 10.0
