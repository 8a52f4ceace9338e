"""WebSocket (RFC 6455) as one more framing of the same requests: the handshake, and messages to requests and back, without a socket.

Text messages carry JSON, and binary messages carry msgpack. The server answers in the encoding of the first message.
"""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from websockets.frames import Close, Frame, Opcode
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response
from websockets.server import ServerProtocol

from uwserver.adapter import MESSAGE_LIMIT, host_name, http_answer, is_host_known, is_loopback
from uwserver.ports import ErrorCode, Fault
from uwserver_adapters.native.codec import LINE_LIMIT, Codec, Control
from uwserver_adapters.native.messages import (
    EXAMPLE,
    JSON,
    MSGPACK,
    Malformed,
    Request,
    id_of_json,
    id_of_msgpack,
    parse_json,
    parse_msgpack,
)

HTTP_ANSWER = (
    b"HTTP/1.1 426 Upgrade Required\r\nUpgrade: websocket\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n\r\n"
    b"This is uwserver: it speaks JSON lines, msgpack frames and WebSocket here, it serves no pages.\n"
    b"In a browser: new WebSocket('ws://HOST:PORT'). In a shell:\n"
    b"printf '" + EXAMPLE.encode() + b"\\n' | nc HOST PORT\n"
)

WEB_LIMIT = LINE_LIMIT + 4096
"""Longest message that is read, in one or more frames, bytes. A message that is longer than `LINE_LIMIT` is refused; above this limit the connection
ends."""
FRAMES = 64
"""Frames that are parsed in one step. Frames that complete no message must not take the loop's time from other peers."""
_OVERHEAD = 1 << 10
_SHORT_HEAD = 2
_END_OF_REQUEST = b"\r\n\r\n"
_CLOSE_REASON_LIMIT = 123
_CLOSE_CODES: Mapping[ErrorCode, int] = {
    "too_large": 1009, "parse_error": 1007, "invalid_request": 1002, "denied": 1008, "version": 1008, "overload": 1013, "shutdown": 1001,
}  # fmt: skip
_INTERNAL = 1011
_GOING_AWAY = 1001

# The library logs every connection at level info.
_quiet: Final = logging.getLogger(f"{__name__}.frames")
_quiet.setLevel(logging.WARNING)


class Handshake:
    """The opening of a connection that began with a GET of HTTP.

    Args:
        origins: origins of pages that may connect, see `allows`.
        hosts: names of this server besides its addresses, see `is_host_known`.
        page: address of the page of this server, to which a browser on this machine is sent; "" for none.
        speaks: makes the codec of a peer that is let in; default: the native protocol.
        check: returns a further objection of the adapter to a request for a WebSocket, or None.

    Attributes:
        answer: the answer to the request; None until the request is complete.
        codec: the codec of a peer that was let in.
        fault: why the peer was not let in; None if it only asked for a page.
    """

    def __init__(
        self,
        origins: Sequence[str],
        hosts: Sequence[str],
        page: str = "",
        speaks: Callable[[ServerProtocol], WebSocketCodec] | None = None,
        check: Callable[[HttpRequest], Fault | None] = lambda _: None,
    ) -> None:
        self._page = page
        self._speaks = speaks or WebSocketCodec
        self._check = check
        self.answer: bytes | None = None
        self.codec: WebSocketCodec | None = None
        self.fault: Fault | None = None
        self._origins = origins
        self._hosts = hosts
        self._tail = b""
        self._protocol = ServerProtocol(max_size=WEB_LIMIT, logger=_quiet)

    @property
    def refusal(self) -> tuple[str, str]:
        """Cause and text for `Refusals.note`, if the peer was not let in."""
        if self.fault is None:
            return "http", "a peer asked for a page, which is not served here"
        where = self.fault.where
        return {"allowed_origins": "origin", "allowed_hosts": "host"}.get(where, where), self.fault.text

    def receive(self, data: bytes) -> bytes:
        """Take bytes, in pieces of any size, until there is an answer; return the bytes after the request, which are for the codec."""
        end = (self._tail + data).find(_END_OF_REQUEST)
        taken = len(data) if end < 0 else end + len(_END_OF_REQUEST) - len(self._tail)
        self._tail = (self._tail + data)[1 - len(_END_OF_REQUEST) :]
        self._protocol.receive_data(data[:taken])
        for event in self._protocol.events_received():
            if isinstance(event, HttpRequest):
                self.answer = self._respond(event)
        if self.answer is None and self._protocol.handshake_exc is not None:
            self.fault = Fault(
                "invalid_request", f"no valid HTTP request ({self._protocol.handshake_exc})", "handshake"
            )
            self.answer = b"".join(self._protocol.data_to_send()) or HTTP_ANSWER
        return data[taken:]

    def _respond(self, request: HttpRequest) -> bytes:
        if "Upgrade" not in request.headers:
            return self._elsewhere(request) if self._page else HTTP_ANSWER
        self.fault = self._objection(request.headers.get_all("Origin"), request.headers.get_all("Host"))
        self.fault = self.fault or self._check(request)
        if self.fault is not None:
            return self._send(self._protocol.reject(403, self.fault.text + "\n"))
        response = self._protocol.accept(request)
        if response.status_code != 101:
            self.fault = Fault("invalid_request", (response.body or b"").decode().strip(), "handshake")
        answer = self._send(response)
        if self.fault is None:
            self.codec = self._speaks(self._protocol)
        return answer

    def _elsewhere(self, request: HttpRequest) -> bytes:
        """Return an answer that names the page. A browser on this machine goes there by itself."""
        text = (
            f"This is uwserver: it speaks JSON lines, msgpack frames and WebSocket here. Its page is at {self._page}\n"
        )
        accepts = ",".join(request.headers.get_all("Accept"))
        is_asked_for = all(site in ("none", "same-origin") for site in request.headers.get_all("Sec-Fetch-Site"))
        is_here = all(is_loopback(host_name(host)) for host in request.headers.get_all("Host"))
        if is_asked_for and "text/html" in accepts and is_here:
            return http_answer("307 Temporary Redirect", text, f"Location: {self._page}\r\nCache-Control: no-store\r\n")
        return http_answer("426 Upgrade Required", text, "Upgrade: websocket\r\n")

    def _objection(self, origins: Sequence[str], hosts: Sequence[str]) -> Fault | None:
        for origin in origins:
            if not allows(self._origins, origin):
                text = f"pages of {origin[:200]} may not connect to this server: name that origin in allowed_origins of the adapter"
                return Fault("denied", text, "allowed_origins")
        if not set(origins) - {"null"} and not all(is_host_known(host, self._hosts) for host in hosts):
            # A page whose name was made to point here (DNS rebinding) sends its own name.
            text = f"{hosts[0][:200]} is no name of this server that it knows: add it to allowed_hosts of the adapter, or use the address"
            return Fault("denied", text, "allowed_hosts")
        return None

    def _send(self, response: Response) -> bytes:
        self._protocol.send_response(response)
        return b"".join(self._protocol.data_to_send())


def allows(patterns: Sequence[str], origin: str) -> bool:
    """Return whether a page of an origin may connect. A pattern is an origin, an origin with ``:*`` for any port, or ``*`` for every page."""
    for pattern in patterns:
        if pattern in ("*", origin):
            return True
        if pattern.endswith(":*") and re.fullmatch(re.escape(pattern[:-1]) + r"\d{1,5}", origin):
            return True
    return False


def _text_frame(body: bytes) -> bytes:
    return Frame(Opcode.TEXT, body).serialize(mask=False)


def _binary_frame(body: bytes) -> bytes:
    return Frame(Opcode.BINARY, body).serialize(mask=False)


class WebSocketCodec(Codec):
    """The codec of one connection after its handshake.

    Args:
        protocol: the protocol of the library in its state after the handshake.
    """

    def __init__(self, protocol: ServerProtocol) -> None:
        super().__init__(JSON, _text_frame)
        self.limit = WEB_LIMIT
        self._protocol = protocol
        self._buffer = bytearray()
        self._events: deque[Request | Malformed | Control] = deque()
        self._opcode: Opcode | None = None
        self._message = bytearray()
        self._unfinished = 0
        self._rest = 0
        self._has_heard = False
        self._lost = False

    def receive(self, data: bytes) -> None:
        """Store bytes. After a fault or the peer's end, nothing is taken any more."""
        if not self._lost:
            self._buffer += data

    def next_event(self) -> Request | Malformed | Control | None:
        """Return the next message, or pongs and the like that are due; an empty `Control` after many frames without any of these."""
        for _ in range(FRAMES):
            if self._events:
                return self._events.popleft()
            piece = self._next_piece()
            if not piece:
                return None
            self._feed(piece)
        return self._events.popleft() if self._events else Control(b"", False)

    def _next_piece(self) -> bytes:
        """Return what is there of one frame, large or small, and nothing of the next frame; empty if more bytes must come first."""
        if self._lost:
            return b""
        if not self._rest:
            self._rest = _frame_size(self._buffer)
        piece = bytes(self._buffer[: self._rest])
        del self._buffer[: self._rest]
        self._rest -= len(piece)
        return piece

    def ending(self, fault: Fault | None) -> bytes:
        """Return a close frame; its reason is as much of the fault's text as fits."""
        if self._protocol.close_rcvd is not None:
            return b""
        code = _GOING_AWAY if fault is None else _CLOSE_CODES.get(fault.code, _INTERNAL)
        text = "" if fault is None else fault.text
        reason = text.encode()[:_CLOSE_REASON_LIMIT].decode(errors="ignore")
        return Frame(Opcode.CLOSE, Close(code, reason).serialize()).serialize(mask=False)

    def _feed(self, piece: bytes) -> None:
        self._unfinished += len(piece)
        self._protocol.receive_data(piece)
        ended = False
        for frame in self._protocol.events_received():
            if isinstance(frame, Frame) and not self._lost:
                self._unfinished = 0
                ended = ended or frame.opcode is Opcode.CLOSE
                self._take(frame)
        due = b"".join(self._protocol.data_to_send())
        if self._lost:
            return
        if self._protocol.close_sent is not None and not ended:
            self._fail(self._protocol.close_sent)
        elif ended:
            self._end(Control(due, True))
        elif self._unfinished + len(self._message) > self.limit + _OVERHEAD:
            self._end(Malformed(_too_large(self.limit), fatal=True))
        elif due:
            self._events.append(Control(due, False))

    def _take(self, frame: Frame) -> None:
        if frame.opcode in (Opcode.TEXT, Opcode.BINARY):
            self._opcode = frame.opcode
            self._message = bytearray(frame.data)
        elif frame.opcode is Opcode.CONT:
            self._message += frame.data
        else:
            return
        if len(self._message) > self.limit:
            self._end(Malformed(_too_large(self.limit), fatal=True))
        elif frame.fin:
            body, self._message = bytes(self._message), bytearray()
            self._complete(body, self._opcode is Opcode.TEXT)

    def _complete(self, body: bytes, is_text: bool) -> None:
        if not self._has_heard:
            self._has_heard = True
            if not is_text:
                self.encoding, self.frame = MSGPACK, _binary_frame
        if len(body) > LINE_LIMIT:
            self._events.append(Malformed(_too_large(LINE_LIMIT), id_of_json(body) if is_text else id_of_msgpack(body)))
        elif not is_text:
            self._events.append(parse_msgpack(body))
        elif body.isascii() or len(body) > MESSAGE_LIMIT or _is_utf8(body):
            # A longer text is refused anyway if it is not ASCII.
            self._events.append(parse_json(body))
        else:
            fault = Fault("parse_error", "a text message must be UTF-8; msgpack goes into a binary one")
            self._end(Malformed(fault, fatal=True))

    def _fail(self, close: Close) -> None:
        if close.code == 1009:
            fault = Fault("too_large", f"at most {self.limit} bytes a message")
        else:
            fault = Fault("invalid_request", f"not as RFC 6455 has it: {close.reason}")
        self._end(Malformed(fault, fatal=True))

    def _end(self, last: Malformed | Control) -> None:
        self._lost = True
        self._buffer.clear()
        self._message.clear()
        self._events.append(last)


def _too_large(limit: int) -> Fault:
    return Fault("too_large", f"a message holds at most {limit} bytes")


def _frame_size(start: bytearray) -> int:
    """Return the number of bytes of the frame that begins here, with its head (RFC 6455, 5.2); 0 if too little of the head is there."""
    if len(start) < _SHORT_HEAD:
        return 0
    is_masked, short = start[1] >> 7, start[1] & 0x7F
    width = {126: 2, 127: 8}.get(short, 0)
    head = _SHORT_HEAD + width
    if len(start) < head:
        return 0
    size = int.from_bytes(start[_SHORT_HEAD:head], "big") if width else short
    return head + 4 * is_masked + size


def _is_utf8(body: bytes) -> bool:
    try:
        body.decode()
    except UnicodeDecodeError:
        return False
    return True
