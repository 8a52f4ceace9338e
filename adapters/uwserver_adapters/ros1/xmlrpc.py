"""XML-RPC as ROS 1 uses it, without sockets: calls and answers in HTTP, with limits as the port is open to everybody.

A web page can make its browser send a POST to any port. A call must therefore have a content type that a page cannot send without permission, must
have no `Origin`, and must name this host.
"""

from __future__ import annotations

import xmlrpc.client
from collections.abc import Sequence
from typing import Any, NamedTuple

from uwserver.adapter import is_host_known
from uwserver.ports import Refused

HEAD_LIMIT = 8 << 10
BODY_LIMIT = 1 << 20
PATHS = ("/", "/RPC2")


class Call(NamedTuple):
    """A call of a method by another node."""

    method: str
    args: tuple[Any, ...]


class BadHttp(Refused):
    """A request of HTTP that is refused.

    Attributes:
        status: status of the answer, such as ``403 Forbidden``.
    """

    def __init__(self, status: str, text: str) -> None:
        super().__init__("invalid_request", text)
        self.status = status


class Requests:
    """Splits the bytes of one connection into calls: `receive` stores, `next_call` parses.

    Args:
        hosts: names by which this node may be called, besides addresses and localhost.
    """

    def __init__(self, hosts: Sequence[str] = ()) -> None:
        self._hosts = hosts
        self._buffer = bytearray()

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        self._buffer += data

    def next_call(self) -> Call | None:
        """Return the next call; None until more bytes come.

        Raises:
            BadHttp: the request is refused. The connection must be ended.
        """
        end = self._buffer.find(b"\r\n\r\n")
        if (end if end >= 0 else len(self._buffer)) > HEAD_LIMIT:
            raise BadHttp("431 Request Header Fields Too Large", f"a head has at most {HEAD_LIMIT} bytes")
        if end < 0:
            return None
        length = self._length(bytes(self._buffer[:end]))
        if len(self._buffer) < end + 4 + length:
            return None
        body = bytes(self._buffer[end + 4 : end + 4 + length])
        del self._buffer[: end + 4 + length]
        try:
            args, method = _loads(body)
        except Refused as refused:
            raise BadHttp("400 Bad Request", refused.fault.text) from None
        if method is None:
            raise BadHttp("400 Bad Request", "a methodCall is needed")
        return Call(method, args)

    def _length(self, head: bytes) -> int:
        """Return the length of the body, bytes, after checking whether the head allows to read it."""
        first, *lines = head.decode("latin-1").split("\r\n")
        words = first.split(" ")
        if len(words) != 3 or words[0] != "POST":
            raise BadHttp("405 Method Not Allowed", "nodes of ROS 1 are called by POST")
        if words[1] not in PATHS:
            raise BadHttp("404 Not Found", f"calls go to {' or '.join(PATHS)}")
        fields = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        if len(fields) < len(lines):
            raise BadHttp("400 Bad Request", "a field stands twice in the head")
        if "origin" in fields:
            raise BadHttp("403 Forbidden", "a page of a browser calls no node")
        if not is_host_known(fields.get("host", ""), self._hosts):
            raise BadHttp("403 Forbidden", "this node is not known by that name: allowed_hosts")
        if fields.get("content-type", "").partition(";")[0].strip().lower() != "text/xml":
            raise BadHttp("415 Unsupported Media Type", "XML-RPC is text/xml")
        length = fields.get("content-length", "")
        if "transfer-encoding" in fields or not length.isascii() or not length.isdigit():
            raise BadHttp("411 Length Required", "a call says its Content-Length")
        if len(length) > 9 or int(length) > BODY_LIMIT:
            raise BadHttp("413 Content Too Large", f"a call has at most {BODY_LIMIT} bytes")
        return int(length)


def _loads(body: bytes) -> tuple[tuple[Any, ...], str | None]:
    if b"<!" in body:
        # Entities of a declaration may expand without end.
        raise Refused("parse_error", "declarations are not read")
    try:
        return xmlrpc.client.loads(body)
    except xmlrpc.client.Fault as fault:
        raise Refused("internal", str(fault.faultString)[:200]) from None
    # The standard library's reader raises errors of many kinds for hostile texts.
    except Exception as error:  # noqa: BLE001
        raise Refused("parse_error", f"this is no XML-RPC: {str(error)[:100]}") from None


def http_answer(status: str, body: bytes = b"", kind: str = "text/plain") -> bytes:
    """Return an answer of HTTP. The connection ends after all but a success."""
    close = "" if status.startswith("200") else "Connection: close\r\n"
    head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n{close}\r\n"
    return head.encode() + body


def told(code: int, text: str, value: Any) -> bytes:
    """Return the answer of a method: a code, which is 1 for success, a text, and a value."""
    body = xmlrpc.client.dumps(([code, text, value],), methodresponse=True, allow_none=True).encode()
    return http_answer("200 OK", body, "text/xml")


def request(host: str, path: str, method: str, args: Sequence[Any]) -> bytes:
    """Return a call of another node; the connection ends after its answer."""
    body = xmlrpc.client.dumps(tuple(args), method).encode()
    head = f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return head.encode() + body


def result(answered: bytes) -> Any:
    """Return the value of a complete answer.

    Raises:
        Refused: the answer is wrong, or says that the call failed.
    """
    head, _, body = answered.partition(b"\r\n\r\n")
    first = head.partition(b"\r\n")[0].split(b" ")
    if len(first) < 2 or first[1] != b"200":
        raise Refused("internal", f"it answered {head[:60]!r}")
    (value,), _ = _loads(body)
    if not isinstance(value, list) or len(value) != 3:
        raise Refused("internal", "its answer is not [code, text, value]")
    code, text, found = value
    if code != 1:
        raise Refused("internal", str(text)[:200])
    return found
