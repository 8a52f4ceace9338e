"""What all links share: how they are named, what they are for the adapter, and how much may wait."""

from __future__ import annotations

from uwserver.adapter import CannotServe, address_text
from uwserver_adapters.mavlink.links.router import Router

RETRY_S = 1.0
"""Wall time between two attempts to connect."""
WAITING, READY = 1 << 18, 1 << 14
"""Bytes that may wait for a peer before frames are dropped, and below which downloads go on."""
RIVAL, PORT_KEY = "a ground station", "its port in links"
"""Who most likely holds a port that is in use, and what gives another."""

Address = tuple[str, int]


class BadLink(CannotServe):
    """A link of the table cannot be had; the text says why and what to do."""


class Link:
    """One entry of `links`.

    Args:
        address: as a user would type it.
        router: of the vehicle.

    Attributes:
        address: with the port that it has really got, once it is open.
    """

    def __init__(self, address: str, router: Router) -> None:
        self.address = address
        self._router = router
        self._stats = router.context.stats

    async def open(self) -> None:
        """Make it ready for peers. Raises CannotServe when that is impossible."""

    async def attend(self) -> None:
        """To be called about once a second: connect again, forget the silent."""

    async def close(self) -> None:
        """Leave nothing behind."""


def shown(kind: str, address: Address) -> str:
    """A link as a user would type it."""
    return f"{kind}:{address_text(*address)}"
