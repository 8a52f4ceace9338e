"""RTSP 1.0 (RFC 2326) as bytes: a client's requests and interleaved packets, and answers. Sans-IO.

Bytes may come in pieces of any size. Something too long, or no request, ends the conversation with an answer that says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NamedTuple

HEAD_LIMIT: Final = 4096
"""Longest head of a request, bytes."""
BODY_LIMIT: Final = 4096
"""Longest body of a request, bytes. Clients send none, or a few names of parameters."""
VERSION: Final = "RTSP/1.0"

_REASONS: Final[Mapping[int, str]] = {
    200: "OK", 400: "Bad Request", 404: "Not Found", 405: "Method Not Allowed", 406: "Not Acceptable", 413: "Request Entity Too Large",
    451: "Parameter Not Understood", 453: "Not Enough Bandwidth", 454: "Session Not Found", 455: "Method Not Valid in This State",
    457: "Invalid Range", 459: "Aggregate Operation Not Allowed", 461: "Unsupported Transport", 501: "Not Implemented",
    503: "Service Unavailable", 505: "RTSP Version Not Supported", 551: "Option not supported",
}  # fmt: skip
_SEQ_LIMIT: Final = 10
_DOLLAR: Final = 0x24
_END: Final = re.compile(rb"\r?\n\r?\n")
_LINE: Final = re.compile(r"([A-Z_]{1,32}) ([\x21-\x7e]{1,1024}) (RTSP/[0-9]\.[0-9])")
_FIELD: Final = re.compile(r"([!#$%&'*+\-.^_`|~0-9A-Za-z]{1,64})[ \t]*:[ \t]*([^\x00-\x08\x0a-\x1f\x7f]*)")
_DIGITS: Final = re.compile(r"[0-9]{1,9}")


class Request(NamedTuple):
    """A request.

    Attributes:
        method, uri, version: the first line.
        headers: values by names in lower case; of several with one name the first counts.
        body: bytes.
    """

    method: str
    uri: str
    version: str
    headers: Mapping[str, str]
    body: bytes = b""


class Interleaved(NamedTuple):
    """A packet of RTP or RTCP between requests."""

    channel: int
    data: bytes


class Malformed(NamedTuple):
    """Bytes that are no request. It is not known where the next one begins.

    Attributes:
        status: status of the answer.
        text: what is wrong.
    """

    status: int
    text: str


Event = Request | Interleaved | Malformed


class Reader:
    """Splits the bytes of one client into events. After `Malformed` it takes nothing more."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._searched = 0
        self._head: Request | None = None  # a request whose body is not complete yet
        self._body = 0
        self._is_lost = False

    def receive(self, data: bytes) -> None:
        """Store bytes, in pieces of any size."""
        if not self._is_lost:
            self._buffer += data

    def next_event(self) -> Event | None:
        """Return what came next; None until more bytes come."""
        if self._is_lost:
            return None
        if self._head is not None:
            return self._whole(self._head)
        if not self._searched:  # blank lines between requests are ignored
            del self._buffer[: len(self._buffer) - len(self._buffer.lstrip(b"\r\n"))]
        if not self._buffer:
            return None
        if self._buffer[0] == _DOLLAR:
            return self._interleaved()
        end = _END.search(self._buffer, max(self._searched - 3, 0), HEAD_LIMIT + 4)
        if end is None:
            if len(self._buffer) >= HEAD_LIMIT + 4:
                return self._lost(413, f"the head of a request has at most {HEAD_LIMIT} bytes")
            self._searched = len(self._buffer)
            return None
        at = end.end()
        del end  # the match holds the buffer, which could not be shortened
        return self._request(at)

    def _interleaved(self) -> Interleaved | None:
        if len(self._buffer) < 4:
            return None
        end = 4 + int.from_bytes(self._buffer[2:4], "big")
        if len(self._buffer) < end:
            return None
        event = Interleaved(self._buffer[1], bytes(self._buffer[4:end]))
        del self._buffer[:end]
        return event

    def _request(self, at: int) -> Event | None:
        lines = re.split("\r?\n", bytes(self._buffer[:at]).decode("latin-1").rstrip("\r\n"))
        first = _LINE.fullmatch(lines[0])
        if first is None:
            return self._lost(400, f"this is no {VERSION} request")
        headers: dict[str, str] = {}
        for line in lines[1:]:
            entry = _FIELD.fullmatch(line)
            if entry is None:
                return self._lost(400, "a header line is not `name: value`")
            headers.setdefault(entry[1].lower(), entry[2].strip())
        length = headers.get("content-length", "0")
        if _DIGITS.fullmatch(length) is None or int(length) > BODY_LIMIT:
            return self._lost(413, f"Content-Length must be a whole number up to {BODY_LIMIT}")
        del self._buffer[:at]
        self._searched = 0
        self._body = int(length)
        self._head = Request(first[1], first[2], first[3], headers)
        return self._whole(self._head)

    def _whole(self, head: Request) -> Request | None:
        """Return a request with its body; None until the body is complete."""
        if len(self._buffer) < self._body:
            return None
        request = head._replace(body=bytes(self._buffer[: self._body]))
        del self._buffer[: self._body]
        self._head = None
        return request

    def _lost(self, status: int, text: str) -> Malformed:
        self._is_lost = True
        self._buffer.clear()
        return Malformed(status, text)


def sequence_number(request: Request) -> str:
    """Return the header `CSeq`, which the answer repeats; "" if it is not valid."""
    seq = request.headers.get("cseq", "")
    return seq if seq.isascii() and seq.isdigit() and len(seq) <= _SEQ_LIMIT else ""


def answer(status: int, seq: str, headers: Mapping[str, str] | None = None, body: str = "") -> bytes:
    """Return an answer.

    Args:
        status: status code.
        seq: the request's `CSeq`; "" for none.
        headers: further headers, whose values contain no line ends.
        body: text of the body; `headers` gives its type.
    """
    lines = [f"{VERSION} {status} {_REASONS[status]}"]
    if seq:
        lines.append(f"CSeq: {seq}")
    lines += [f"{name}: {value}" for name, value in (headers or {}).items()]
    if body:
        lines.append(f"Content-Length: {len(body.encode())}")
    return ("\r\n".join(lines) + "\r\n\r\n" + body).encode()


class Transport(NamedTuple):
    """One way in which a client offers to receive packets.

    Attributes:
        is_tcp: within this connection, between the answers.
        pair: for RTP and RTCP, two successive channels, or two ports of the client; None if it gives none.
        destination: receiver that the client names; "" for none.
    """

    is_tcp: bool
    pair: tuple[int, int] | None
    destination: str


def transports(text: str) -> list[Transport]:
    """Return the ways in a header `Transport` that can be served, in the client's order."""
    found = []
    for offer in text.split(","):
        protocol, *options = [part.strip() for part in offer.split(";")]
        given = {
            name.strip().lower(): value.strip() for name, _, value in (option.partition("=") for option in options)
        }
        is_tcp = protocol.upper() == "RTP/AVP/TCP"
        if not is_tcp and protocol.upper() not in ("RTP/AVP", "RTP/AVP/UDP"):
            continue
        mode = given.get("mode", "play").strip('"').lower()
        if "multicast" in given or mode != "play":
            continue
        pair = _channels(given.get("interleaved", "")) if is_tcp else _pair(given.get("client_port", ""), 65535)
        found.append(Transport(is_tcp, pair, given.get("destination", "")))
    return found


def _channels(text: str) -> tuple[int, int] | None:
    """Return two channels. RTCP uses the channel after that of RTP, and both are one byte."""
    pair = _pair(text, 255)
    return pair if pair is not None and pair[1] == pair[0] + 1 else None


def _pair(text: str, most: int) -> tuple[int, int] | None:
    first, dash, second = text.partition("-")
    if _DIGITS.fullmatch(first) is None or (dash and _DIGITS.fullmatch(second) is None):
        return None
    low = int(first)
    high = int(second) if dash else low + 1
    return (low, high) if low != high and max(low, high) <= most else None
