"""Recognises peers that speak another protocol by their first bytes: HTTP, or TLS on a plain port. They get one answer and are closed.

Any web page can make a browser send a request to any port of this machine. A port that reads lines would skip the head of such a request as
nonsense and obey its body. So a peer is recognised before a byte of it is read as the port's own protocol.
"""

from __future__ import annotations

import re
from typing import Final, Literal

from uwserver.adapter.bounds import STRANGER_LIMIT

Speech = Literal["unknown", "own", "http", "tls"]
"""What a peer speaks: not known yet; neither HTTP nor TLS, so perhaps the port's own protocol; HTTP (RFC 9112, and the preface of RFC 9113); TLS
(RFC 8446)."""

HEAD_LIMIT = STRANGER_LIMIT
"""Bytes after which a target that has not ended is taken for one of HTTP, and a method that has not ended for none: browsers use short methods."""

# The rest of a word: a method is any token (RFC 9110, 5.6.2), a target is anything without a blank.
_TOKEN: Final = re.compile(rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]*")
_TARGET: Final = re.compile(rb"[^ \n]*")
_VERSION: Final = b"HTTP/"
# A handshake record (22), version 3.x, its length, and in it a ClientHello (1); or the beginning of this.
_HELLO: Final = re.compile(rb"\x16(?:\x03(?:[\x00-\x04](?:.(?:.\x01?)?)?)?)?", re.DOTALL)
_HELLO_SIZE: Final = 6

TLS_ALERT: Final = b"\x15\x03\x01\x00\x02\x02\x28"
"""The fatal alert handshake_failure, after which a client ends at once and says why."""


class FirstBytes:
    """The first bytes of a peer, until they show what it speaks. They may come in pieces of any size; each byte is examined once.

    Attributes:
        held: all bytes so far.
        speech: the protocol that they show.
    """

    def __init__(self) -> None:
        self.held = bytearray()
        self.speech: Speech = "unknown"
        self._words = [_TOKEN, _TARGET]
        self._at = 0

    def receive(self, data: bytes) -> None:
        """Take in bytes, until `speech` is known."""
        self.held += data
        if self.held.startswith(b"\x16"):
            self.speech = self._of_record()
        else:
            self.speech = self._of_line()
            if self.speech == "unknown" and len(self.held) > HEAD_LIMIT:
                self.speech = "own" if self._words[0] is _TOKEN else "http"

    def _of_record(self) -> Speech:
        head = bytes(self.held[:_HELLO_SIZE])
        if _HELLO.fullmatch(head) is None:
            return "own"
        return "tls" if len(head) == _HELLO_SIZE else "unknown"

    def _of_line(self) -> Speech:
        """Recognise a line that begins with METHOD SP target SP HTTP/."""
        while self._words:
            found = self._words[0].match(self.held, self._at)
            assert found is not None
            self._at = found.end()
            if self._at == len(self.held):
                return "unknown"
            if self.held[self._at] != ord(" ") or self._at == 0:
                return "own"
            self._at += 1
            del self._words[0]
        said = bytes(self.held[self._at : self._at + len(_VERSION)])
        if not _VERSION.startswith(said):
            return "own"
        return "http" if said == _VERSION else "unknown"


def http_answer(
    status: str, text: str, headers: str = "", *, kind: str = "text/plain; charset=utf-8", body: bool = True
) -> bytes:
    """Return a whole HTTP answer, after which the connection must be closed. No page of another origin can read it.

    Args:
        status: code and phrase.
        text: the body.
        headers: further header lines, each with its CRLF.
        kind: media type of the body.
        body: whether to send the body, which an answer to HEAD must not do.
    """
    data = text.encode()
    head = (
        f"HTTP/1.1 {status}\r\n{headers}Content-Type: {kind}\r\nContent-Length: {len(data)}\r\n"
        "X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + (data if body else b"")


REFUSALS: Final[dict[Speech, tuple[str, bytes]]] = {
    "http": (
        "a peer speaks HTTP here, perhaps a web page in a browser: nothing of its request was obeyed",
        http_answer(
            "400 Bad Request", "This port of uwserver does not speak HTTP: nothing of this request was obeyed.\n"
        ),
    ),
    "tls": ("a peer speaks TLS here: this port is plain, see tls_cert of adapters that have it", TLS_ALERT),
}
"""For each protocol the reason for the log, and what the peer is sent."""
