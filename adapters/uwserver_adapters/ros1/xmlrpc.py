"""XML-RPC as ROS 1 uses it, without sockets: calls and answers in HTTP, with limits as the port is open to everybody.

A web page can make its browser send a POST to any port. A call must therefore have a content type that a page cannot send without permission, must
have no `Origin`, and must name this host.
"""

from __future__ import annotations

import contextlib
import re
import xmlrpc.client
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from uwserver.adapter import is_host_known
from uwserver.ports import Refused

HEAD_LIMIT = 8 << 10
BODY_LIMIT = 64 << 10
"""Most bytes of a call or an answer: a list of a thousand nodes."""
TAGS, NESTED = 8192, 100
"""Most tags of a call or an answer, and most arrays and structures, which alone can be nested."""
SLICE = 2 << 10
"""Bytes of a call or an answer that are parsed at once. Most tags in them, ``<a/>``, take half a millisecond."""
PATHS = ("/", "/RPC2")

_ATTRIBUTE = re.compile(rb"<[^<>?!\s]+\s[^<>]*=")


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


class Body:
    """A call or an answer, parsed slice by slice, so that none keeps the loop from its other work.

    Args:
        data: the whole text.

    Raises:
        Refused: it has more tags than `TAGS`, more arrays and structures than `NESTED`, attributes, or declarations.
    """

    def __init__(self, data: bytes) -> None:
        if b"<!" in data:
            # Entities of a declaration may expand without end.
            raise Refused("parse_error", "declarations are not read")
        if data.count(b"<") > TAGS:
            raise Refused("parse_error", f"it has more than {TAGS} tags")
        if data.count(b"<array") + data.count(b"<struct") > NESTED:
            raise Refused("parse_error", f"it has more than {NESTED} arrays and structures")
        if _ATTRIBUTE.search(data):
            raise Refused("parse_error", "tags of XML-RPC have no attributes")
        self._data = data
        self._parsed = 0
        self._parser, self._found = xmlrpc.client.getparser()

    def parse_slice(self) -> bool:
        """Parse the next `SLICE` bytes. Returns whether there are more.

        Raises:
            Refused: this is no XML-RPC.
        """
        with _refusing():
            self._parser.feed(self._data[self._parsed : self._parsed + SLICE])
            self._parsed += SLICE
            return self._parsed < len(self._data)

    def end(self) -> tuple[tuple[Any, ...], str | None]:
        """Return the values, and the name of the method; None for an answer.

        Raises:
            Refused: this is no XML-RPC, or an answer says that the call failed.
        """
        with _refusing():
            self._parser.close()
            return self._found.close(), self._found.getmethodname()


@contextlib.contextmanager
def _refusing() -> Iterator[None]:
    try:
        yield
    except xmlrpc.client.Fault as fault:
        raise Refused("internal", str(fault.faultString)[:200]) from None
    # The standard library's reader raises errors of many kinds for hostile texts.
    except Exception as error:  # noqa: BLE001
        raise Refused("parse_error", f"this is no XML-RPC: {str(error)[:100]}") from None


class Requests:
    """Splits the bytes of one connection into calls: `receive` stores, `next_call` parses.

    Args:
        hosts: names by which this node may be called, besides addresses and localhost.

    Attributes:
        size: bytes of the last call.
    """

    def __init__(self, hosts: Sequence[str] = ()) -> None:
        self._hosts = hosts
        self._buffer = bytearray()
        self._expected: int | None = None
        self._body: Body | None = None
        self.size = 0

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        self._buffer += data

    def next_call(self) -> Call | None:
        """Return the next call; None while it `is_parsing`, and until more bytes come.

        Raises:
            BadHttp: the request is refused. The connection must be ended.
        """
        try:
            if self._body is None:
                self._body = self._next_body()
            if self._body is None or self._body.parse_slice():
                return None
            args, method = self._body.end()
        except BadHttp:
            raise
        except Refused as refused:
            raise BadHttp("400 Bad Request", refused.fault.text) from None
        self._body = None
        if method is None:
            raise BadHttp("400 Bad Request", "a methodCall is needed")
        return Call(method, args)

    @property
    def is_parsing(self) -> bool:
        """Whether a call has been received of which a part is not parsed yet."""
        return self._body is not None

    def _next_body(self) -> Body | None:
        if self._expected is None:
            end = self._buffer.find(b"\r\n\r\n")
            if (end if end >= 0 else len(self._buffer)) > HEAD_LIMIT:
                raise BadHttp("431 Request Header Fields Too Large", f"a head has at most {HEAD_LIMIT} bytes")
            if end < 0:
                return None
            self._expected = self._length(bytes(self._buffer[:end]))
            del self._buffer[: end + 4]
        if len(self._buffer) < self._expected:
            return None
        self.size, self._expected = self._expected, None
        data = bytes(self._buffer[: self.size])
        del self._buffer[: self.size]
        return Body(data)

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


class Answer:
    """Collects the bytes of an answer: `receive` until `is_whole`, or until the connection ends."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._end = -1
        self._length = BODY_LIMIT

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size.

        Raises:
            Refused: there are too many.
        """
        self._buffer += data
        if self._end < 0:
            self._end = self._buffer.find(b"\r\n\r\n", 0, HEAD_LIMIT)
            for line in bytes(self._buffer[: max(self._end, 0)]).lower().split(b"\r\n"):
                name, _, value = line.partition(b":")
                if name == b"content-length" and value.strip().isdigit():
                    self._length = min(int(value[:20]), BODY_LIMIT + 1)
        if len(self._buffer) > HEAD_LIMIT + BODY_LIMIT or self._length > BODY_LIMIT:
            raise Refused("overload", f"its answer is longer than {BODY_LIMIT} bytes")

    @property
    def is_whole(self) -> bool:
        """Whether the body has the announced length: not every node closes the connection after its answer."""
        return self._end >= 0 and len(self._buffer) - self._end - 4 >= self._length

    def body(self) -> Body:
        """Return what is to be parsed, and given to `result`.

        Raises:
            Refused: the answer is wrong.
        """
        first = bytes(self._buffer[:HEAD_LIMIT]).partition(b"\r\n")[0].split(b" ")
        if self._end < 0 or len(first) < 2 or first[1] != b"200":
            raise Refused("internal", f"it answered {bytes(self._buffer[:60])!r}")
        return Body(bytes(self._buffer[self._end + 4 :]))


def result(body: Body) -> Any:
    """Return the value of a parsed answer.

    Raises:
        Refused: the answer is wrong, or says that the call failed.
    """
    (value,), _ = body.end()
    if not isinstance(value, list) or len(value) != 3:
        raise Refused("internal", "its answer is not [code, text, value]")
    code, text, found = value
    if code != 1:
        raise Refused("internal", str(text)[:200])
    return found
