"""What all links share: their contract, how they are named, and how much may be buffered."""

from __future__ import annotations

from uwserver.adapter import CannotServe, address_text
from uwserver_adapters.mavlink.links.router import Router

RETRY_S = 1.0
"""Wall time between two attempts to connect."""
WAITING, READY = 1 << 18, 1 << 14
"""Buffered bytes per peer: above the first number frames are dropped, below the second downloads continue."""
RIVAL, PORT_KEY = "a ground station", "its port in links"
"""What most likely holds a port that is in use, and where the user sets another one. For error texts."""

Address = tuple[str, int]


class BadLink(CannotServe):
    """A link of the table cannot be opened. The text says why and what to do."""


class Link:
    """One entry of `links`.

    Args:
        address: the link as a user would type it.
        router: the router of the vehicle.

    Attributes:
        address: once the link is open, with the port that it really has.
    """

    def __init__(self, address: str, router: Router) -> None:
        self.address = address
        self._router = router
        self._stats = router.context.stats

    async def open(self) -> None:
        """Make the link ready for peers. Raises CannotServe when that is impossible."""
        await self.attend()

    async def attend(self) -> None:
        """Connect again if needed, and forget silent peers. Called about once per second."""

    async def close(self) -> None:
        """Close everything that `open` has opened."""


def shown(kind: str, address: Address) -> str:
    """Return a link as a user would type it."""
    return f"{kind}:{address_text(*address)}"
