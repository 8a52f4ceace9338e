"""Reads the heads of HTTP/1.1 requests without a body."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NamedTuple

__all__ = ["HEAD_END", "HEAD_LIMIT", "Request", "parse"]

HEAD_END: Final = b"\r\n\r\n"
"""Ends the head of a request."""
HEAD_LIMIT = 16 << 10
"""Longest head of a request that servers take, bytes."""
_FIRST: Final = re.compile(r"([!#$%&'*+\-.^_`|~0-9A-Za-z]+) ([!-~]+) HTTP/1\.[01]")
_HEADER: Final = re.compile(r"([!#$%&'*+\-.^_`|~0-9A-Za-z]+):([^\r\n\0]*)")
"""No part of it matches in two ways, so no peer can make the match slow."""


class Request(NamedTuple):
    """A request.

    Attributes:
        method, target: as they were sent.
        headers: all values of each header, by its name in lower case.
    """

    method: str
    target: str
    headers: Mapping[str, tuple[str, ...]]

    @property
    def path(self) -> str:
        """The target without a question mark and what follows it."""
        return self.target.partition("?")[0]

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
    return Request(request[1], request[2], {name: tuple(values) for name, values in headers.items()})
