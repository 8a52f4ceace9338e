"""The table of the adapter `player` in a scenario."""

from __future__ import annotations

from typing import Literal

from uwserver.adapter import STRANGERS, OpenTable
from uwserver.table import Count, PortNumber, Positive


class PlayerConfig(OpenTable, tag="player", kw_only=True, frozen=True):
    """Attributes:
    port: TCP port; 0 takes a free one.
    pose: source of position3d: the autopilot's "estimate", or the "truth" (with truth = true).
    queue_bytes: bytes that may wait for a slow client; data are dropped above that.
    max_requests_per_s: messages of one client in a second; more are not read until the second is over.
    max_clients: connections.
    max_strangers: further connections that have said nothing valid yet.
    hello_timeout_s: wall time in which a client must have asked for something.
    """

    port: PortNumber = 6665
    pose: Literal["estimate", "truth"] = "estimate"
    queue_bytes: Count = 1 << 20
    max_requests_per_s: Count = 2000
    max_clients: Count = 64
    max_strangers: Count = STRANGERS
    hello_timeout_s: Positive = 10.0
