"""The pages of `uwserver bench web`, in a process of their own: ``python -m uwserver_bench.web.web_load``. Its tasks are as of `load`."""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver.units import NANOSECONDS
from uwserver_bench.processes import carry_out
from uwserver_bench.websocket import BINARY, WebSocket

_PATIENCE_S = 60.0
_SMALL = 4096
"""Size of the receive buffer of a page that does not read, bytes."""
_clock = SystemTime()


def watch(task: Mapping[str, Any]) -> dict[str, object]:
    """Open `pages` pages, of which `deaf` do not read, and read the others for `seconds` of wall time.

    Returns:
        Bytes and states per second of a page that reads.

    Raises:
        ValueError: a page was refused.
    """
    with contextlib.ExitStack() as stack, selectors.DefaultSelector() as selector:
        pages = [stack.enter_context(_page(task, n < task["deaf"])) for n in range(task["pages"])][task["deaf"] :]
        for page in pages:
            selector.register(page, selectors.EVENT_READ, page)
        begin, frames = _clock.now_ns(), 0
        end = begin + int(task["seconds"] * NANOSECONDS)
        while _clock.now_ns() < end:
            for key, _ in selector.select(0.1):
                frames += sum(first == BINARY for first, _ in key.data.read())
        seconds = (_clock.now_ns() - begin) / NANOSECONDS
    count, received = max(1, len(pages)), sum(page.received for page in pages)
    return {"bytes_per_s": received / seconds / count, "frames_per_s": frames / seconds / count}


@contextlib.contextmanager
def _page(task: Mapping[str, Any], deaf: bool) -> Iterator[WebSocket]:
    with socket.socket() as stream:
        if deaf:
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SMALL)
        stream.settimeout(_PATIENCE_S)
        stream.connect((task["host"], task["port"]))
        page = WebSocket(stream, f"{task['host']}:{task['port']}", "/live")
        page.send('{"jsonrpc":"2.0","method":"view","params":{"frames":true}}')
        yield page


_TASKS: Mapping[str, Callable[[Mapping[str, Any]], dict[str, object]]] = {"watch": watch}


if __name__ == "__main__":
    carry_out(_TASKS, "web")
