"""The table of the adapter `mavlink` in a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from msgspec import Meta, field

from uwserver.adapter import AdapterTable
from uwserver.table import Name

SystemNumber = Annotated[int, Meta(ge=1, le=255)]


class MavlinkConfig(AdapterTable, tag="mavlink", kw_only=True, frozen=True):
    """Attributes:
    vehicle: vehicle that is shown; default: the only one there is. Several vehicles need one table each, with different `system` numbers.
    links: where to speak. "udpout:host:port" sends there, "udpin:host:port" waits for peers, "tcpin:host:port" listens, "tcpout:host:port"
        connects, "serial:/dev/ttyS1" is a serial line or pseudo-terminal, and "zenoh:tcp/host:port" carries raw frames as in BlueOS.
    system: system number of the vehicle in MAVLink.
    origin_deg: latitude and longitude of N's origin; without it a ground station may set it (SET_GPS_GLOBAL_ORIGIN).
    externals: external vehicles of the world by name, and the systems that they follow by ODOMETRY in LOCAL_NED, or else GLOBAL_POSITION_INT.
    parameters: values that differ from the defaults, by name.
    passphrase: if set, all messages are signed and only signed ones are accepted; the ground station needs the same.
    tlog: file (.tlog) for all messages of all links; an earlier file of this name is kept under a number.
    frames_per_s: frames accepted from one peer per second; more are dropped and counted.
    """

    vehicle: Name | None = None
    links: tuple[Name, ...] = ("udpout:127.0.0.1:14550",)
    system: SystemNumber = 1
    origin_deg: tuple[float, float] | None = None
    externals: dict[Name, SystemNumber] = field(default_factory=dict)
    parameters: dict[Name, float] = field(default_factory=dict)
    passphrase: Name | None = None
    tlog: Name | None = None
    frames_per_s: Annotated[int, Meta(ge=10)] = 2000

    def needs(self) -> Mapping[str, str]:
        """Return the modules that the links need: the dialect, and zenoh for its links."""
        needed = {"pymavlink.dialects.v20.ardupilotmega": "uwserver"}
        return needed | ({"zenoh": "uwserver"} if any(link.startswith("zenoh:") for link in self.links) else {})
