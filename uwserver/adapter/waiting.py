"""Waiting with a time limit."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")


async def within(seconds: float, what: Awaitable[T], text: str) -> T:
    """Wait for a result, but no longer than so many seconds. `asyncio.wait_for` would lose a cancellation that comes together with the result.

    Raises:
        TimeoutError: it took too long; the error begins with `text`. It is an `OSError`, like other losses of a peer.
    """
    task = asyncio.ensure_future(what)
    try:
        await asyncio.wait({task}, timeout=seconds)
    finally:
        if not task.done():
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
    if task.cancelled():
        raise TimeoutError(f"{text} in {seconds:g} s")
    return task.result()
