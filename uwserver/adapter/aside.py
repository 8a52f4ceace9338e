"""What an adapter does in compiled code while the world goes on."""

from __future__ import annotations

import asyncio

from uwserver.physics.kernel.right_of_way import RightOfWay


def way_of(loop: asyncio.AbstractEventLoop) -> RightOfWay | None:
    """The right of way between a loop and the thread that steps the world; None where it has none, as in tests and on uvloop."""
    way: RightOfWay | None = getattr(loop, "right_of_way", None)
    return way
