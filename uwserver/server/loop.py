"""The asyncio loop of a server: one that can watch a listener, on every system, and that hands the interpreter over without falling asleep."""

from __future__ import annotations

import asyncio
import selectors
import sys
from collections.abc import Coroutine
from typing import Any, TypeVar

from uwserver.physics.kernel.right_of_way import RightOfWay
from uwserver.physics.kernel.team import why_alone

T = TypeVar("T")


class _Selector(selectors.DefaultSelector):
    """Waits in compiled code, where there is a right of way."""

    right_of_way: RightOfWay | None = None

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if self.right_of_way is not None and (timeout is None or timeout > 0.0):
            self.right_of_way.sleep(self.fileno(), timeout)
            timeout = 0.0
        return super().select(timeout)


class ServerLoop(asyncio.SelectorEventLoop):
    """asyncio's own, which waits by the right of way that it is given."""

    def __init__(self) -> None:
        self._waits = _Selector()
        super().__init__(self._waits)

    def _write_to_self(self) -> None:
        """asyncio's own name for what wakes it, after it was told what to do; under another one, it would do that as ever."""
        way = self._waits.right_of_way
        if way is None or not way.answer():
            super()._write_to_self()  # type: ignore[misc]

    @property
    def right_of_way(self) -> RightOfWay | None:
        """With the thread that steps the world of this server; None where nobody has begun one."""
        return self._waits.right_of_way

    @right_of_way.setter
    def right_of_way(self, way: RightOfWay | None) -> None:
        self._waits.right_of_way = way


def begin_way(loop: asyncio.AbstractEventLoop) -> RightOfWay | None:
    """Let a loop have a right of way from now on; None where it cannot, as that of libuv, or need not, as on one core."""
    if not isinstance(loop, ServerLoop) or why_alone():
        return None
    loop.right_of_way = way = RightOfWay()
    return way


def run(main: Coroutine[Any, Any, T], platform: str = sys.platform) -> T:
    """As `asyncio.run`, on such a loop: the default one of Windows has no `add_reader`."""
    if sys.version_info >= (3, 11) and platform != "win32":
        with asyncio.Runner(loop_factory=ServerLoop) as runner:
            return runner.run(main)
    loop = ServerLoop()
    try:
        asyncio.set_event_loop(loop)
        return loop.run_until_complete(main)
    finally:
        left = asyncio.all_tasks(loop)
        for task in left:
            task.cancel()
        if left:
            loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
        loop.run_until_complete(loop.shutdown_asyncgens())
        loop.run_until_complete(loop.shutdown_default_executor())
        asyncio.set_event_loop(None)
        loop.close()
