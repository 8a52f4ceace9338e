"""What an adapter does in compiled code while the world goes on."""

from __future__ import annotations

import asyncio

from uwserver.physics.kernel.right_of_way import RightOfWay


def way_here() -> RightOfWay | None:
    """The right of way between the running loop and the thread that steps the world; None where there is none, as on uvloop or without a loop."""
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        return None
    way: RightOfWay | None = getattr(loop, "right_of_way", None)
    return way
