"""Answers of HTTP/1.1 without a socket. One connection gets one answer."""

from __future__ import annotations

from typing import NamedTuple

from uwserver.adapter.http import Request


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
