"""The clients of `uwserver bench moos`, in a process of their own: ``python -m uwserver_bench.moos.moos_load``. Its tasks are as of `load`.

A client has only as much of the protocol as it needs, and shares no code with the adapters.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from uwserver.simulation.clock import SystemTime
from uwserver_bench.net.traced import TICKS, open_trace
from uwserver_bench.processes import carry_out
from uwserver_bench.report import quantile

CONNECT_S = 10.0
_HELLO = b"ELKS CAN'T DANCE 2/8/10".ljust(32, b"\0")
_PACKET, _LENGTH, _NUMBERS = struct.Struct("<iiB"), struct.Struct("<i"), struct.Struct("<ddd")
_HEAD = 10
_CHUNK = 1 << 18
_clock = SystemTime()
TOGETHER = 20
"""Number of doubles in a packet."""
IN_FLIGHT = 4000


class MoosPeer:
    """One client.

    Args:
        address: ``host:port`` of a MOOSDB.
        name: its name there.

    Raises:
        ConnectionError: the database refused the connection.
    """

    def __init__(self, address: str, name: str) -> None:
        host, _, port = address.rpartition(":")
        self._name = name.encode()
        self._socket = socket.create_connection((host, int(port)), CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._buffer = bytearray()
        self._socket.sendall(_HELLO + _packet([_message(b"iS", b"asynchronous", 0.0, self._name)]))
        answer = self._socket.recv(_CHUNK)
        if answer[_PACKET.size + 8 : _PACKET.size + 9] != b"W":
            raise ConnectionError(f"{name} was not welcomed: {answer!r}")

    def fileno(self) -> int:
        """Return the file descriptor, for a selector."""
        return self._socket.fileno()

    def hear(self, pattern: str) -> None:
        """Register for all variables that match a pattern."""
        text = f"AppPattern=*,VarPattern={pattern},Interval=0".encode()
        self._socket.sendall(_packet([_message(b"*S", self._name, -1.0, text, self._name)]))

    def write(self, pairs: Iterable[tuple[str, float]]) -> None:
        """Write doubles in one packet."""
        self._socket.sendall(_packet([_message(b"ND", key.encode(), value, b"", self._name) for key, value in pairs]))

    def receive(self, timeout_s: float) -> list[tuple[int, bytes, float]]:
        """Return the notifications that have arrived: monotonic time of the arrival (ns), variable, number.

        Raises:
            ConnectionError: the database closed the connection.
        """
        self._socket.settimeout(max(timeout_s, 1e-4))
        try:
            data = self._socket.recv(_CHUNK)
        except TimeoutError:
            return []
        at_ns = _clock.now_ns()
        if not data:
            raise ConnectionError("the database ended the connection")
        self._buffer += data
        found: list[tuple[int, bytes, float]] = []
        while len(self._buffer) >= 4 and len(self._buffer) >= (size := _LENGTH.unpack_from(self._buffer)[0]):
            found += ((at_ns, key, number) for key, number in _mail(bytes(self._buffer[:size])))
            del self._buffer[:size]
        return found

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def _message(types: bytes, key: bytes, number: float, data: bytes, src: bytes = b"") -> bytes:
    texts = b"".join(_LENGTH.pack(len(text)) + text for text in (src, b"", b"", key))
    body = types + texts + _NUMBERS.pack(0.0, number, -1.0) + _LENGTH.pack(len(data)) + data
    return _LENGTH.pack(8 + len(body)) + _LENGTH.pack(0) + body


def _packet(messages: list[bytes]) -> bytes:
    body = b"".join(messages)
    return _PACKET.pack(_PACKET.size + len(body), len(messages), 0) + body


def _mail(data: bytes) -> Iterator[tuple[bytes, float]]:
    """Return variable and number of each notification in a packet."""
    at = _PACKET.size
    while at < len(data):
        (size,) = _LENGTH.unpack_from(data, at)
        if data[at + 8 : at + 9] == b"N":
            end, key = at + _HEAD, b""
            for _ in range(4):
                (length,) = _LENGTH.unpack_from(data, end)
                key, end = data[end + 4 : end + 4 + length], end + 4 + length
            yield key, _NUMBERS.unpack_from(data, end)[1]
        at += size


Task = Mapping[str, Any]


def flow(task: Task) -> dict[str, object]:
    """Let one client write doubles as fast as another receives them, for `seconds`. Returns the received doubles per second."""
    names = [f"FLOW_{k}" for k in range(TOGETHER)]
    with _peers(task, 2) as (writer, reader):
        reader.hear("FLOW_*")
        written = heard = 0
        start = _clock.now_ns()
        end = start + int(task["seconds"] * 1e9)
        while _clock.now_ns() < end:
            while written - heard < IN_FLIGHT:
                writer.write((name, float(written)) for name in names)
                written += TOGETHER
            heard += sum(key.startswith(b"FLOW_") for _, key, _ in reader.receive(0.1))
        return {"per_s": heard / ((_clock.now_ns() - start) * 1e-9), "count": heard}


def navigation(task: Task) -> dict[str, object]:
    """Receive NAV_* for `seconds`. Returns the p99 time (s) from the end of a tick until the client has its position, and the sets per second."""
    ends, late = open_trace(task["trace"]), []
    with _peers(task, 1) as (reader,):
        reader.hear("NAV_X")
        reader.hear("UWSERVER_TIME")
        end = _clock.now_ns() + int(task["seconds"] * 1e9)
        has_position = False
        while _clock.now_ns() < end:
            for at_ns, key, number in reader.receive(0.1):
                if key == b"NAV_X":
                    has_position = True
                elif has_position:  # the time is the last in each packet
                    has_position = False
                    late.append((at_ns - int(ends[round(number * task["rate_hz"]) % TICKS])) * 1e-9)
    late = late[5:]  # the database keeps a set from before the client registered
    if not late:
        raise ValueError("no position came")
    return {"p99_s": quantile(late, 0.99), "per_s": len(late) / task["seconds"]}


def crowd(task: Task) -> dict[str, object]:
    """Let `clients` receive what one client writes at a steady rate, so that `per_s` notifications are sent. Returns how many arrived per second."""
    count = task["clients"]
    names = [f"CROWD_{k}" for k in range(TOGETHER)]
    period = int(1e9 * TOGETHER * count / task["per_s"])
    with _peers(task, count + 1) as (writer, *readers), selectors.DefaultSelector() as selector:
        for reader in readers:
            reader.hear("CROWD_*")
            selector.register(reader, selectors.EVENT_READ, reader)
        start = due = _clock.now_ns()
        end, heard = start + int(task["seconds"] * 1e9), 0
        while (now := _clock.now_ns()) < end:
            if now >= due:
                writer.write((name, 1.0) for name in names)
                due += period
            for key, _ in selector.select(max(0.0, (due - _clock.now_ns()) * 1e-9)):
                heard += sum(name.startswith(b"CROWD_") for _, name, _ in key.data.receive(0.0))
        return {"per_s": heard / ((_clock.now_ns() - start) * 1e-9)}


@contextlib.contextmanager
def _peers(task: Task, count: int) -> Any:
    with contextlib.ExitStack() as stack:
        # The database may not have noticed yet that the clients of the previous task have gone.
        names = [f"bench{_clock.now_ns()}_{k}" for k in range(count)]
        yield [stack.enter_context(contextlib.closing(MoosPeer(task["address"], name))) for name in names]


_TASKS: Mapping[str, Callable[[Task], dict[str, object]]] = {"flow": flow, "navigation": navigation, "crowd": crowd}


if __name__ == "__main__":
    carry_out(_TASKS, "load")
