"""Questions to a YARP name server: where a port is, and to register our own."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Sequence
from typing import NamedTuple

from uwserver.adapter import CannotServe, within
from uwserver.ports import Refused
from uwserver_adapters.yarp.wire import hello, message

ANSWER_S = 5.0
"""Wall time in which a name server, or a port to which we connect, must answer."""
ANSWER_LIMIT = 1 << 16
"""Longest answer of a name server that is read, bytes."""
PIPELINE = 64
"""Most questions that are sent before the first is answered."""
END = b"*** end of message"

_REGISTRATION = re.compile(r"registration name (\S+) ip (\S+) port (\d{1,5}) type (\S+)")


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
