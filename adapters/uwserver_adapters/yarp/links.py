"""Connections that this server makes: questions to a YARP name server, and connections of a port to another port (`yarp connect`).

The name server tells where a port is, and our own ports are registered there.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

from uwserver.adapter import HIGH_WATER, AdapterStats, CannotServe, Peers, within
from uwserver.ports import Refused
from uwserver_adapters.yarp import wire
from uwserver_adapters.yarp.port import YarpPort
from uwserver_adapters.yarp.wire import Carrier, hello, message

ANSWER_S = 5.0
"""Wall time in which a name server, or a port to which we connect, must answer."""
ANSWER_LIMIT = 1 << 16
"""Longest answer of a name server that is read, bytes."""
PIPELINE = 64
"""Most questions that are sent before the first is answered."""
END = b"*** end of message"

_REGISTRATION = re.compile(r"registration name (\S+) ip (\S+) port (\d{1,5}) type (\S+)")
GREETING_LIMIT = 1 << 11
"""Longest answer to our hello, bytes."""


class Address(NamedTuple):
    """Host and TCP port of a port of YARP, and the carrier that its owner suggests."""

    host: str
    port: int
    carrier: str


def server_of(text: str) -> tuple[str, int]:
    """Return host and port of the key `name_server`.

    Raises:
        CannotServe: it is not host:port.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise CannotServe(f'name_server: "{text}" is not host:port, as 127.0.0.1:10000')
    return host.strip("[]"), int(port)


async def ask(server: tuple[str, int], questions: Sequence[str], caller: str) -> list[str]:
    """Return the answers of a name server. They are asked in its protocol of text lines, on one connection.

    Args:
        server: its host and port.
        questions: such as ``query /port``, without line ends.
        caller: our name.

    Raises:
        OSError: it is not there, does not answer in time, or is no name server.
    """
    return await within(ANSWER_S, _asked(server, questions, caller), "it did not answer")


async def _asked(server: tuple[str, int], questions: Sequence[str], caller: str) -> list[str]:
    reader, writer = await asyncio.open_connection(*server, limit=ANSWER_LIMIT)
    try:
        writer.write(hello("text", caller))
        if not (await _line(reader)).startswith(b"Welcome"):
            raise OSError("what listens there is no name server of YARP")
        answers: list[str] = []
        for start in range(0, len(questions), PIPELINE):
            together = questions[start : start + PIPELINE]
            for question in together:
                writer.write(message(True, "d", question.encode() + b"\r\n"))
            for _ in together:
                answers.append(await _answer(reader))
        return answers
    finally:
        writer.transport.abort()


async def _answer(reader: asyncio.StreamReader) -> str:
    lines: list[bytes] = []
    while not (line := await _line(reader)).startswith(END):
        lines.append(line)
        if sum(map(len, lines)) > ANSWER_LIMIT:
            raise OSError(f"its answer has more than {ANSWER_LIMIT} bytes")
    return b"".join(lines).decode("utf-8", "replace")


async def _line(reader: asyncio.StreamReader) -> bytes:
    try:
        line = await reader.readline()
    except ValueError:
        raise OSError(f"its answer has a line of more than {ANSWER_LIMIT} bytes") from None
    if not line:
        raise OSError("it closed the connection without an answer")
    return line


def address_in(answer: str) -> Address | None:
    """Return the address of a port in a name server's answer; None where it has none."""
    found = _REGISTRATION.search(answer)
    return None if found is None else Address(found[2], int(found[3]), found[4])


def target_of(said: str) -> tuple[str, str]:
    """Return carrier and name of a port as YARP's tools write them: ``/read``, ``tcp://read``, ``tcp:/read``.

    The carrier may be "".

    Raises:
        Refused: it is no name of a port.
    """
    carrier, sign, name = said.partition(":/")
    if not sign:
        carrier, name = "", said
    name = "/" + name.lstrip("/")
    if not re.fullmatch(r"(/[^\s/\"()\[\]{}]+)+", name) or len(name) > 256:
        raise Refused("bad_argument", f"{said[:100]} is no name of a port: /name, or carrier://name")
    return carrier.partition("+")[0].strip("/"), name


class Link(asyncio.Protocol):
    """A connection from a port of ours to another port, which hears it. Acknowledgements are ignored.

    Args:
        port: our port.
        name: name of the other port.
        carrier: carrier of the connection.
        peers: all connections of the adapter.
        stats: stats of the adapter.
        queue_bytes: most bytes that wait for the other side.
        lost: called when the connection has ended.

    Attributes:
        name, carrier: as given.
        is_half_open: always False, as nothing is expected of the other side.
        greeted: done when the other side has answered.
    """

    is_half_open = False

    def __init__(
        self, port: YarpPort, name: str, carrier: Carrier, peers: Peers[Any], stats: AdapterStats, queue_bytes: int,
        lost: Callable[[Link], None],
    ) -> None:  # fmt: skip
        self.name = name
        self.carrier: Carrier = carrier
        self.greeted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._port, self._peers, self._stats, self._queue_bytes = port, peers, stats, queue_bytes
        self._lost = lost
        self._transport: asyncio.Transport | None = None
        self._answer = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send our hello, if there is a place for the connection."""
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(HIGH_WATER)
        self._peers.enter(self)
        fault = self._peers.admit(self)
        if fault is not None:
            self._fail(Refused(fault.code, fault.text))
            return
        self._transport.write(wire.hello(self.carrier, self._port.name))

    def data_received(self, data: bytes) -> None:
        """Take the answer to the hello."""
        if self.greeted.done():
            return
        self._answer += data
        # YARP answers on both text carriers, though its own writers wait for the answer on only one of them.
        if wire.is_text(self.carrier):
            is_right = self._answer.startswith(b"Welcome"[: len(self._answer)])
            is_whole = b"\n" in self._answer
        else:
            is_right = self._answer.startswith(b"YA"[: len(self._answer)])
            is_whole = len(self._answer) >= 8
        if not is_right or len(self._answer) > GREETING_LIMIT:
            self._fail(Refused("invalid_request", "what listens there is no port of YARP"))
        elif is_whole:
            self.greeted.set_result(None)

    def connection_lost(self, error: Exception | None) -> None:
        """End the link."""
        self._peers.leave(self)
        self._lost(self)
        self._fail(Refused("internal", "it closed the connection without an answer"))

    def _fail(self, why: Refused) -> None:
        if not self.greeted.done():
            self.greeted.set_exception(why)
        self.abort()

    def send_sample(self, message: bytes) -> None:
        """Send a message; drop it while too much waits."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        if transport.get_write_buffer_size() > self._queue_bytes:
            self._stats.dropped += 1
            return
        self._stats.samples_sent += 1
        self._stats.bytes_sent += len(message)
        transport.write(message)

    def close(self) -> None:
        """Say that the connection ends, then close it."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(wire.message(wire.is_text(self.carrier), "q"))
            self._transport.close()

    def abort(self) -> None:
        """Close the connection at once."""
        if self._transport is not None:
            self._transport.abort()


async def connect(link: Link, address: Address) -> None:
    """Make the connection of a link.

    Raises:
        OSError: nobody is there, or does not answer in time.
        Refused: it is no port of YARP, or there is no place for the connection.
    """
    loop = asyncio.get_running_loop()

    async def make() -> None:
        await loop.create_connection(lambda: link, address.host, address.port)
        await link.greeted

    try:
        await within(ANSWER_S, make(), "it did not answer")
    except BaseException:
        link.abort()
        if link.greeted.done() and not link.greeted.cancelled():
            link.greeted.exception()  # reported already; asyncio must not log it again
        raise
