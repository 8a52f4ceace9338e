"""Lines of MORSE's request channel, both sides, without input or output.

A request is ``ID COMPONENT SERVICE [JSON list]`` or ``ID cancel``. An answer is ``ID STATUS [JSON]`` with SUCCESS, FAILED or PREEMPTED. Faults of
MORSE's own server are not repeated here: it took the bytes of one ``recv`` for whole requests, wrote no false, zero or empty result, and let one
client cancel the request of another.
"""

from __future__ import annotations

import re
from typing import Literal

import msgspec
from msgspec import Struct

from uwserver.adapter import Lines, Undecodable, decode
from uwserver.ports import Json, Refused

LINE_LIMIT = 1 << 20
"""Longest request, bytes."""

Status = Literal["SUCCESS", "FAILED", "PREEMPTED"]

_ID = re.compile(rb"[^\s]{1,79}")
_NAME = re.compile(r"[^\s]{1,256}")


class Request(Struct, frozen=True):
    """A call; `args` are positional."""

    id: str
    component: str
    service: str
    args: tuple[object, ...] = ()


class Cancel(Struct, frozen=True):
    """The client cancels what it began under this id."""

    id: str


class Malformed(Struct, frozen=True):
    """A line that cannot be understood. The next one can. `id` is "" where the line has none."""

    id: str
    text: str


class RequestDecoder(Lines):
    """Turns the bytes of one connection into requests: `receive` stores, `next_event` parses."""

    def __init__(self, limit: int = LINE_LIMIT) -> None:
        super().__init__(limit)

    def next_event(self) -> Request | Cancel | Malformed | None:
        """Return the next line's meaning; None until more bytes come."""
        try:
            line = self.next_line()
        except Refused as refused:
            return Malformed("", refused.fault.text)
        return None if line is None else parse(line)


def parse(line: bytes) -> Request | Cancel | Malformed:
    """Return the meaning of one line, without its end."""
    found = _ID.match(line)
    if found is None or len(line.split(None, 1)[0]) > 79:
        return Malformed("", "a request begins with its id, at most 79 characters without a blank")
    try:
        id = found[0].decode()
        words = line.decode().split(None, 3)
    except UnicodeDecodeError as error:
        return Malformed("", f"no UTF-8 at byte {error.start}")
    if words[1:] == ["cancel"]:
        return Cancel(id)
    if len(words) < 3:
        return Malformed(id, "write: ID COMPONENT SERVICE [JSON list of arguments], or ID cancel")
    component, service = words[1:3]
    if not (_NAME.fullmatch(component) and _NAME.fullmatch(service)):
        return Malformed(id, "names have at most 256 characters")
    try:
        args = decode(words[3].encode(), "json") if len(words) > 3 else []
    except Undecodable as error:
        return Malformed(id, f"the arguments are no JSON: {error}")
    if not isinstance(args, list):
        return Malformed(id, f"the arguments are a JSON list, [1.5, true], not {_shown(words[3])}")
    return Request(id, component, service, tuple(args))


def answer(id: str, status: Status, value: Json = None) -> bytes:
    """Return the line of an answer. A value of None is left out, as clients expect it. NaN and infinity become null."""
    text = b"" if value is None else b" " + msgspec.json.encode(value)
    return f"{id or '-'} {status}".encode() + text + b"\n"


def _shown(text: str) -> str:
    return text if len(text) <= 40 else text[:40] + "..."
