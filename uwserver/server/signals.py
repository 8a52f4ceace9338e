"""The signals that end a server: on every system, also where asyncio's own are less able (Windows)."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

_ENDING = (signal.SIGINT, signal.SIGTERM)


def end_undisturbed() -> None:
    """What is left is the end of this process: a signal that asks for it once more must not make it look killed. Main thread only."""
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def signals_received(loop: asyncio.AbstractEventLoop, received: Callable[[signal.Signals], None]) -> Iterator[None]:
    """Tell of SIGINT and SIGTERM, in the loop. Main thread only, as Python demands.

    Afterwards what was done before with a signal is done again; but once one was received, `received` goes on to hear of all, between two
    instructions of whatever runs: who asked this process to end may ask again while it does.

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
    """Begin to listen for one signal; returns what ends it."""
    before = signal.getsignal(number)

    def handler(caught: int, frame: FrameType | None) -> None:
        # Between two instructions of whatever runs: only the loop may call.
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
