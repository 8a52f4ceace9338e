"""HTTP/1.1 without a socket: reads the heads of requests without a body, and builds answers. One connection gets one answer."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NamedTuple

HEAD_LIMIT = 16 << 10
"""Longest head of a request, bytes."""
END: Final = b"\r\n\r\n"

_FIRST: Final = re.compile(r"([!#$%&'*+\-.^_`|~0-9A-Za-z]+) ([!-~]+) HTTP/1\.[01]")
_HEADER: Final = re.compile(r"([!#$%&'*+\-.^_`|~0-9A-Za-z]+):([^\r\n\0]*)")
"""No part of it matches in two ways, so no peer can make the match slow."""


class Request(NamedTuple):
    """A request.

    Attributes:
        method: as it was sent.
        path: without a question mark and what follows it.
        headers: all values of each header, by its name in lower case.
    """

    method: str
    path: str
    headers: Mapping[str, tuple[str, ...]]

    def header(self, name: str) -> str:
        """Return the only value of a header; "" for none or several, which is just as wrong."""
        values = self.headers.get(name, ())
        return values[0] if len(values) == 1 else ""


def parse(head: bytes) -> Request | None:
    """Return the request of a head, which is given without its last empty line; None if it is not valid."""
    first, *lines = head.decode("latin-1").split("\r\n")
    request = _FIRST.fullmatch(first)
    headers: dict[str, list[str]] = {}
    for line in lines:
        header = _HEADER.fullmatch(line)
        if header is None:
            return None
        headers.setdefault(header[1].lower(), []).append(header[2].strip(" \t"))
    if request is None:
        return None
    return Request(request[1], request[2].partition("?")[0], {name: tuple(values) for name, values in headers.items()})


class Answer(NamedTuple):
    """An answer, after which the connection is closed.

    Attributes:
        status: code and phrase.
        body: the body, which is not sent for HEAD.
        kind: content type; "" without a body.
        headers: further headers.
    """

    status: str
    body: bytes = b""
    kind: str = "text/plain; charset=utf-8"
    headers: tuple[tuple[str, str], ...] = ()

    def head(self) -> bytes:
        """Return everything before the body. Pages of other origins can neither read the answer nor use it as a script, style or picture."""
        lines = [
            f"HTTP/1.1 {self.status}",
            f"Content-Length: {len(self.body)}",
            "X-Content-Type-Options: nosniff",
            "Referrer-Policy: no-referrer",
            "Cross-Origin-Resource-Policy: same-origin",
            "Connection: close",
        ]
        if self.kind:
            lines.append(f"Content-Type: {self.kind}")
        lines += [f"{name}: {value}" for name, value in self.headers]
        return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1", "replace")


def text(status: str, body: str, *headers: tuple[str, str]) -> Answer:
    """Return an answer with a short text."""
    return Answer(status, body.encode() + b"\n", headers=headers)


def takes_gzip(request: Request) -> bool:
    """Return whether the peer accepts gzip."""
    for offer in ",".join(request.headers.get("accept-encoding", ())).split(","):
        name, _, weight = offer.partition(";")
        if name.strip().lower() in ("gzip", "*"):
            return weight.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False


def is_same(request: Request, etag: str) -> bool:
    """Return whether the peer already has this version."""
    known = ",".join(request.headers.get("if-none-match", ()))
    return etag in {each.strip().removeprefix("W/") for each in known.split(",")}
