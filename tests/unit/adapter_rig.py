"""A running adapter, for tests."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

from uwserver.testing.fake_context import FakeContext


@contextlib.asynccontextmanager
async def serving(adapter: Any) -> AsyncIterator[FakeContext]:
    """The context of an adapter that runs, from when it is ready; AssertionError if it ends before the block does."""
    ready = asyncio.Event()
    task = asyncio.ensure_future(adapter.run(ready))
    try:
        waiting = asyncio.ensure_future(ready.wait())
        await asyncio.wait([task, waiting], timeout=60.0, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if task.done():
            task.result()
        yield adapter.context
        assert not task.done(), task.exception()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
