"""Connections that this node makes: calls of the master and other nodes, and subscriptions to topics that command vehicles."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any
from urllib.parse import urlsplit

from uwserver.adapter import RateMeter, may_connect, within
from uwserver.ports import Refused
from uwserver_adapters.ros1 import wire, xmlrpc

CALL_S = 5.0
"""Wall time in which another node must answer."""
RETRY_S = 1.0
"""Wall time before a publisher is tried again."""


def place_of(uri: str) -> tuple[str, int, str]:
    """Return host, port and path of the address of a node.

    Raises:
        Refused: it is no such address.
    """
    try:
        parts = urlsplit(uri)
        port = parts.port
    except ValueError as error:
        raise Refused("bad_argument", f'"{uri[:100]}" is no address of a node: {error}') from None
    if parts.scheme != "http" or not parts.hostname or port is None:
        raise Refused("bad_argument", f'"{uri[:100]}" is no address of a node: http://host:port/')
    return parts.hostname, port, parts.path or "/"


async def ask(uri: str, method: str, *args: Any) -> Any:
    """Call a method of a node's API and return its value.

    Raises:
        Refused: the node answers that the call failed, or its answer is wrong.
        OSError: the node is not there, or does not answer in time.
    """
    host, port, path = place_of(uri)
    return await within(CALL_S, _asked(host, port, path, method, args), f"{uri} did not answer")


async def _asked(host: str, port: int, path: str, method: str, args: Sequence[Any]) -> Any:
    reader, writer = await asyncio.open_connection(host, port)
    try:
        writer.write(xmlrpc.request(f"{host}:{port}", path, method, args))
        answered = b""
        while piece := await reader.read(1 << 16):
            answered += piece
            if len(answered) > xmlrpc.BODY_LIMIT or _is_whole(answered):
                break
        return xmlrpc.result(answered)
    finally:
        writer.transport.abort()


def _is_whole(answered: bytes) -> bool:
    """Return whether the body has the announced length: not every node closes the connection after its answer."""
    head, end, body = answered.partition(b"\r\n\r\n")
    for line in head.lower().split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name == b"content-length" and end and value.strip().isdigit():
            return len(body) >= int(value)
    return False


class Subscription:
    """The connection to one publisher of a topic. It is made again whenever it breaks, until `close`.

    Args:
        uri: address of the publisher's API.
        topic, type_name, md5, text: of the messages; the type in ROS 1's spelling.
        node: name of this node.
        allowed: hosts besides this machine to which it may connect.
        most_per_s: most messages that are taken in a second.
        take: gets each message.
        complain: gets texts of faults.

    Attributes:
        uri: as given.
        is_connected: whether the publisher has answered.
    """

    def __init__(
        self, uri: str, topic: str, type_name: str, md5: str, text: str, node: str, allowed: Sequence[str], most_per_s: int,
        take: Callable[[bytes], None], complain: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.uri = uri
        self.is_connected = False
        self._topic, self._node, self._allowed = topic, node, allowed
        self._header = wire.header({
            "callerid": node, "topic": topic, "type": type_name, "md5sum": md5, "tcp_nodelay": "1", "message_definition": text,
        })  # fmt: skip
        self._rate = RateMeter(most_per_s)
        self._take, self._complain = take, complain
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        """End the connection."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            try:
                await self._hear()
            except (Refused, OSError) as error:
                self._complain(f"{self._topic} from {self.uri}: {str(error) or type(error).__name__}")
            await asyncio.sleep(RETRY_S)

    async def _hear(self) -> None:
        self._check(place_of(self.uri)[0])
        given = await ask(self.uri, "requestTopic", self._node, self._topic, [["TCPROS"]])
        if not (
            isinstance(given, list) and len(given) == 3 and isinstance(given[1], str) and isinstance(given[2], int)
        ):
            raise Refused("internal", "it offers no TCPROS")
        self._check(given[1])
        connecting = asyncio.open_connection(given[1], given[2], limit=1 << 16)
        reader, writer = await within(CALL_S, connecting, "it could not be reached")
        try:
            writer.write(self._header)
            await self._read(reader)
        finally:
            self.is_connected = False
            writer.transport.abort()

    def _check(self, host: str) -> None:
        if not may_connect(host, self._allowed):
            text = f'it names the host "{host[:100]}": say allowed_hosts = ["{host[:100]}"] if that is one of yours'
            raise Refused("denied", text)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        blocks = wire.Blocks()
        now = asyncio.get_running_loop().time
        while piece := await reader.read(1 << 14):
            blocks.receive(piece)
            while (block := blocks.next_block()) is not None:
                if not self.is_connected:
                    fields = wire.fields_of(block)
                    if "error" in fields:
                        raise Refused("denied", fields["error"][:200])
                    self.is_connected = True
                    blocks.limit = wire.MESSAGE_LIMIT
                    continue
                self._take(block)
                if not self._rate.take(now()):  # too many: read on when the second is over
                    await asyncio.sleep(max(self._rate.end - now(), 0.0))
                await asyncio.sleep(0)  # let others have their turn
        if not self.is_connected:
            raise OSError("it closed the connection without an answer")
