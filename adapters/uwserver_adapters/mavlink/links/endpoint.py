"""What all links share: how they are named, what they are for the adapter, and how much may wait."""

from __future__ import annotations

from typing import Protocol

from uwserver.adapter import CannotServe, address_text

RETRY_S = 1.0
"""Wall time between two attempts to connect."""
WAITING, READY = 1 << 18, 1 << 14
"""Bytes that may wait for a peer before frames are dropped, and below which downloads go on."""

RIVAL, PORT_KEY = "a ground station", "its port in links"
"""Who most likely holds a port that is in use, and what gives another."""

Address = tuple[str, int]


class BadLink(CannotServe):
    """A link of the table cannot be had; the text says why and what to do."""


class Link(Protocol):
    """One entry of `links`."""

    @property
    def address(self) -> str:
        """As a user would type it."""

    async def open(self) -> None:
        """Make it ready for peers. Raises CannotServe when that is impossible."""

    async def attend(self) -> None:
        """To be called about once a second: connect again, forget the silent."""

    def close(self) -> None:
        """Leave nothing behind."""


def shown(kind: str, address: Address) -> str:
    """A link as a user would type it."""
    return f"{kind}:{address_text(*address)}"
