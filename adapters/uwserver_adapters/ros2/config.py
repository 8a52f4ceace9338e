"""The adapter's table in a scenario."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from msgspec import Meta, field

from uwserver.adapter import AdapterTable, CannotServe
from uwserver.table import Count, Name

DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
MOST_DOMAIN = 232
_Endpoint = Annotated[str, Meta(pattern=r"^[a-z0-9_]+/.+$")]


class Ros2Config(AdapterTable, tag="ros2", kw_only=True, frozen=True):
    """Attributes:
    transport: "zenoh", as rmw_zenoh uses it; "dds", as all other middlewares of ROS 2 use it; or "bridge", zenoh as zenoh-bridge-ros2dds uses
        it to connect nodes on DDS.
    allow_network: must be true for DDS, which listens on all interfaces of the machine.
    discovery: for DDS: find nodes on this machine, or on the whole subnet; CYCLONEDDS_URI of the environment applies too.
    ros_distro: distribution of the other nodes; it decides types and hashes.
    domain: ROS_DOMAIN_ID of the other nodes; default: that of the environment, or 0.
    node: name of the node.
    mode: mode of the zenoh session: "router", which needs no rmw_zenohd; "peer" or "client" of an rmw_zenohd that runs.
    listen, connect, config_file, config: those of the session, as for `zenoh`.
    services: offer the services of the world, its actions and parameters; default: over zenoh and a bridge. Over DDS only rmw_cyclonedds
        understands them.
    tf: source of the poses of vehicles on ``/tf``: the autopilot's "estimate", the "truth" (with truth = true), or "none".
    geoid_m: height of the sea surface above the ellipsoid, m; NavSatFix counts heights from the ellipsoid.
    clock_hz: most messages of ``/clock`` in a simulated second.
    queue_requests: most commands and calls that wait for the loop; more are dropped and counted.
    """

    transport: Literal["zenoh", "dds", "bridge"] = "zenoh"
    allow_network: bool = False
    discovery: Literal["localhost", "subnet"] = "localhost"
    ros_distro: Literal["humble", "jazzy", "kilted", "rolling"] = "jazzy"
    domain: Annotated[int, Meta(ge=0, le=MOST_DOMAIN)] | None = None
    node: Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")] = "uwserver"
    mode: Literal["router", "peer", "client"] = "router"
    listen: tuple[_Endpoint, ...] | None = None
    connect: tuple[_Endpoint, ...] = ()
    config_file: Name | None = None
    config: dict[str, Any] = field(default_factory=dict)
    services: bool | None = None
    tf: Literal["estimate", "truth", "none"] = "estimate"
    geoid_m: float = 0.0
    clock_hz: Annotated[float, Meta(gt=0, le=1000)] = 100.0
    queue_requests: Count = 4096

    def needs(self) -> Mapping[str, str]:
        """See `AdapterTable.needs`."""
        if self.transport == "dds":
            return {"rosbags": "uwserver[ros]", "cyclonedds": "uwserver[dds]"}
        return {"rosbags": "uwserver[ros]", "xxhash": "uwserver[ros]", "zenoh": "uwserver"}

    @property
    def offers_services(self) -> bool:
        """Whether services are offered: `services`, or its default."""
        return self.transport != "dds" if self.services is None else self.services

    @property
    def its_domain(self) -> int:
        """`domain`, or that of the environment.

        Raises:
            CannotServe: that of the environment is no number of a domain.
        """
        if self.domain is not None:
            return self.domain
        text = os.environ.get(DOMAIN_VARIABLE) or "0"
        if not text.isdecimal() or int(text) > MOST_DOMAIN:
            raise CannotServe(f"{DOMAIN_VARIABLE} is {text[:40]!r}: a domain is a number from 0 to {MOST_DOMAIN}")
        return int(text)
