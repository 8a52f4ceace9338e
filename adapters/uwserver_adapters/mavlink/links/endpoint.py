"""What all links share: how they are named, what they are for the adapter, and how much may wait."""

from __future__ import annotations

import errno
from typing import Protocol

RETRY_S = 1.0
"""Wall time between two attempts to connect."""
WAITING, READY = 1 << 18, 1 << 14
"""Bytes that may wait for a peer before frames are dropped, and below which downloads go on."""

Address = tuple[str, int]


class BadLink(Exception):
    """A link of the table cannot be had; the text says why and what to do."""


class Link(Protocol):
    """One entry of `links`."""

    @property
    def address(self) -> str:
        """As a user would type it."""

    async def open(self) -> None:
        """Make it ready for peers. Raises BadLink when that is impossible."""

    async def attend(self) -> None:
        """To be called about once a second: connect again, forget the silent."""

    def close(self) -> None:
        """Leave nothing behind."""


def shown(kind: str, address: Address) -> str:
    """A link as a user would type it."""
    host, port = address
    return f"{kind}:[{host}]:{port}" if ":" in host else f"{kind}:{host}:{port}"


def cannot_listen(error: OSError, kind: str, address: Address) -> BadLink:
    """The reason in words that say what to do."""
    where = shown(kind, address)
    if error.errno == errno.EADDRINUSE:
        return BadLink(
            f"link {where} is in use, perhaps by a ground station: close it, or take another port (0: a free one)"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return BadLink(f"link {where}: this machine has no such address; 127.0.0.1 is always there, 0.0.0.0 means all")
    return BadLink(f"cannot listen at {where}: {error}")
