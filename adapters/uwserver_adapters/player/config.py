"""The table of the adapter `player` in a scenario."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from uwserver.adapter import STRANGERS, AdapterTable
from uwserver.table import Name, Positive

_Port = Annotated[int, Meta(ge=0, le=65535)]
_Count = Annotated[int, Meta(ge=1)]


class PlayerConfig(AdapterTable, tag="player", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at. Player knows no token: anything but loopback needs allow_network.
    allow_network: allow another address: whoever reaches it may read all and command all.
    port: TCP port; 0 takes a free one.
    pose: source of position3d: the autopilot's "estimate", or the "truth" (with truth = true).
    queue_bytes: bytes that may wait for a slow client; data are dropped above that.
    max_requests_per_s: messages of one client in a second; more are not read until the second is over.
    max_clients: connections.
    max_strangers: further connections that have said nothing valid yet.
    hello_timeout_s: wall time in which a client must have asked for something.
    """

    bind: Name = "127.0.0.1"
    allow_network: bool = False
    port: _Port = 6665
    pose: Literal["estimate", "truth"] = "estimate"
    queue_bytes: _Count = 1 << 20
    max_requests_per_s: _Count = 2000
    max_clients: _Count = 64
    max_strangers: _Count = STRANGERS
    hello_timeout_s: Positive = 10.0
