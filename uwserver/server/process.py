"""The process of a server: its event loop, and the signals that end it, on every system."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from collections.abc import Callable, Coroutine, Iterator
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")
_ENDING = (signal.SIGINT, signal.SIGTERM)


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine as `asyncio.run` does, on a loop that has `add_reader`. The default loop of Windows has none."""
    if sys.platform == "win32":
        asyncio.set_event_loop_policy(asyncio.WindowsSelectorEventLoopPolicy())
    return asyncio.run(main)


def end_undisturbed() -> None:
    """Ignore further signals, as the process is about to end: a signal now must not make it look killed. Main thread only."""
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def signals_received(loop: asyncio.AbstractEventLoop, received: Callable[[signal.Signals], None]) -> Iterator[None]:
    """Call `received` in the loop at SIGINT and SIGTERM. Main thread only, as Python demands.

    Afterwards the previous handlers are restored. But once a signal was received, `received` stays the handler of all further ones, so that
    a user can ask again while this process ends. It is then called between any two instructions.

    Args:
        loop: runs, or is about to.
        received: takes the signal.
    """
    heard = False

    def tell(number: signal.Signals) -> None:
        nonlocal heard
        heard = True
        received(number)

    undo: list[Callable[[], Any]] = []
    try:
        for number in _ENDING:
            undo.append(_listen(loop, number, tell))
        yield
    finally:
        for each in undo:
            each()
        if heard:
            for number in _ENDING:
                signal.signal(number, lambda caught, frame: received(signal.Signals(caught)))


def _listen(loop: asyncio.AbstractEventLoop, number: signal.Signals, received: Callable[[signal.Signals], None]) -> Callable[[], Any]:  # fmt: skip
    """Begin to listen for one signal. Returns the function that ends it."""
    before = signal.getsignal(number)

    def handler(caught: int, frame: FrameType | None) -> None:
        # Python calls this between any two instructions, so only the loop may call `received`.
        loop.call_soon_threadsafe(received, number)

    def end() -> None:
        with contextlib.suppress(NotImplementedError):
            loop.remove_signal_handler(number)
        signal.signal(number, before)

    try:
        loop.add_signal_handler(number, received, number)
    except NotImplementedError:
        signal.signal(number, handler)
    return end
