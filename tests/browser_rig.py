"""What browsers really send, recorded from Chromium 150 and Firefox ESR 140 with a page of another origin; the body is the test's."""

from __future__ import annotations

from typing import NamedTuple

_CHROMIUM = "User-Agent: Mozilla/5.0 (X11; Linux x86_64) AppleWebKit/537.36 (KHTML, like Gecko) Chrome/150.0.0.0 Safari/537.36\r\n"
_FIREFOX = "User-Agent: Mozilla/5.0 (X11; Linux x86_64; rv:140.0) Gecko/20100101 Firefox/140.0\r\n"
_HINTS = 'sec-ch-ua-platform: "Linux"\r\n'
_BRANDS = 'sec-ch-ua: "Not;A=Brand";v="8", "Chromium";v="150"\r\n'


class Sent(NamedTuple):
    """One request: name of browser and cause, head without its last blank line, and whether it has a body."""

    name: str
    head: str
    has_body: bool

    def bytes_of(self, host: str, origin: str, body: bytes) -> bytes:
        """As it goes over the wire."""
        body = body if self.has_body else b""
        return self.head.format(host=host, origin=origin, size=len(body)).encode() + b"\r\n" + body


SENT = (
    Sent(
        "chromium fetch no-cors",
        "POST /nocors HTTP/1.1\r\nHost: {host}\r\nConnection: keep-alive\r\nContent-Length: {size}\r\n" + _HINTS + _CHROMIUM + _BRANDS
        + "Content-Type: text/plain;charset=UTF-8\r\nsec-ch-ua-mobile: ?0\r\nAccept: */*\r\nOrigin: {origin}\r\nSec-Fetch-Site: cross-site\r\n"
        "Sec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: empty\r\nReferer: {origin}/\r\nAccept-Encoding: gzip, deflate, br, zstd\r\n",
        True,
    ),
    Sent(
        "chromium preflight",
        "OPTIONS /preflight HTTP/1.1\r\nHost: {host}\r\nConnection: keep-alive\r\nAccept: */*\r\nAccess-Control-Request-Method: PUT\r\n"
        "Access-Control-Request-Headers: x-a\r\nOrigin: {origin}\r\n" + _CHROMIUM + "Sec-Fetch-Mode: cors\r\nSec-Fetch-Site: cross-site\r\n"
        "Sec-Fetch-Dest: empty\r\nReferer: {origin}/\r\nAccept-Encoding: gzip, deflate, br, zstd\r\n",
        False,
    ),
    Sent(
        "chromium websocket",
        "GET /ws HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\nPragma: no-cache\r\nCache-Control: no-cache\r\n" + _CHROMIUM
        + "Upgrade: websocket\r\nOrigin: {origin}\r\nSec-WebSocket-Version: 13\r\nAccept-Encoding: gzip, deflate, br, zstd\r\n"
        "Sec-WebSocket-Key: JgAbycNVJsbLjeOAVx8b8w==\r\nSec-WebSocket-Extensions: permessage-deflate; client_max_window_bits\r\n",
        False,
    ),
    Sent(
        "chromium image",
        "GET /img HTTP/1.1\r\nHost: {host}\r\nConnection: keep-alive\r\n" + _HINTS + _CHROMIUM + _BRANDS + "sec-ch-ua-mobile: ?0\r\n"
        "Accept: image/avif,image/webp,image/apng,image/svg+xml,image/*,*/*;q=0.8\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\n"
        "Sec-Fetch-Dest: image\r\nSec-Fetch-Storage-Access: active\r\nReferer: {origin}/\r\nAccept-Encoding: gzip, deflate, br, zstd\r\n",
        False,
    ),
    Sent(
        "chromium form",
        "POST /form HTTP/1.1\r\nHost: {host}\r\nConnection: keep-alive\r\nContent-Length: {size}\r\nCache-Control: max-age=0\r\n" + _BRANDS
        + "sec-ch-ua-mobile: ?0\r\n" + _HINTS + "Upgrade-Insecure-Requests: 1\r\nContent-Type: text/plain\r\n" + _CHROMIUM
        + "Origin: {origin}\r\nAccept: text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8\r\nSec-Fetch-Site: cross-site\r\n"
        "Sec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: iframe\r\nReferer: {origin}/\r\nAccept-Encoding: gzip, deflate, br, zstd\r\n",
        True,
    ),
    Sent(
        "firefox fetch no-cors",
        "POST /nocors HTTP/1.1\r\nHost: {host}\r\n" + _FIREFOX + "Accept: */*\r\nAccept-Language: en-US,en;q=0.5\r\n"
        "Accept-Encoding: gzip, deflate, br, zstd\r\nReferer: {origin}/\r\nContent-Type: text/plain;charset=UTF-8\r\nContent-Length: {size}\r\n"
        "Origin: {origin}\r\nConnection: keep-alive\r\nSec-Fetch-Dest: empty\r\nSec-Fetch-Mode: no-cors\r\nSec-Fetch-Site: cross-site\r\n"
        "Priority: u=4\r\n",
        True,
    ),
    Sent(
        "firefox preflight",
        "OPTIONS /preflight HTTP/1.1\r\nHost: {host}\r\n" + _FIREFOX + "Accept: */*\r\nAccept-Language: en-US,en;q=0.5\r\n"
        "Accept-Encoding: gzip, deflate, br, zstd\r\nAccess-Control-Request-Method: PUT\r\nAccess-Control-Request-Headers: x-a\r\n"
        "Referer: {origin}/\r\nOrigin: {origin}\r\nConnection: keep-alive\r\nSec-Fetch-Dest: empty\r\nSec-Fetch-Mode: cors\r\n"
        "Sec-Fetch-Site: cross-site\r\nPriority: u=4\r\n",
        False,
    ),
    Sent(
        "firefox websocket",
        "GET /ws HTTP/1.1\r\nHost: {host}\r\n" + _FIREFOX + "Accept: */*\r\nAccept-Language: en-US,en;q=0.5\r\n"
        "Accept-Encoding: gzip, deflate, br, zstd\r\nSec-WebSocket-Version: 13\r\nOrigin: {origin}\r\n"
        "Sec-WebSocket-Extensions: permessage-deflate\r\nSec-WebSocket-Key: +Xw+pNIP0lld68TRDIDMxQ==\r\nConnection: Upgrade\r\n"
        "Sec-Fetch-Dest: empty\r\nSec-Fetch-Mode: websocket\r\nSec-Fetch-Site: cross-site\r\nPragma: no-cache\r\nCache-Control: no-cache\r\n"
        "Upgrade: websocket\r\n",
        False,
    ),
    Sent(
        "firefox beacon",
        "POST /beacon HTTP/1.1\r\nHost: {host}\r\n" + _FIREFOX + "Accept: */*\r\nAccept-Language: en-US,en;q=0.5\r\n"
        "Accept-Encoding: gzip, deflate, br, zstd\r\nContent-Type: text/plain;charset=UTF-8\r\nContent-Length: {size}\r\nOrigin: {origin}\r\n"
        "Connection: keep-alive\r\nReferer: {origin}/\r\nSec-Fetch-Dest: empty\r\nSec-Fetch-Mode: no-cors\r\nSec-Fetch-Site: cross-site\r\n"
        "Priority: u=6\r\n",
        True,
    ),
    Sent(
        "firefox form",
        "POST /form HTTP/1.1\r\nHost: {host}\r\n" + _FIREFOX + "Accept: text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8\r\n"
        "Accept-Language: en-US,en;q=0.5\r\nAccept-Encoding: gzip, deflate, br, zstd\r\nContent-Type: text/plain\r\nContent-Length: {size}\r\n"
        "Origin: {origin}\r\nConnection: keep-alive\r\nReferer: {origin}/\r\nUpgrade-Insecure-Requests: 1\r\nSec-Fetch-Dest: iframe\r\n"
        "Sec-Fetch-Mode: navigate\r\nSec-Fetch-Site: cross-site\r\nPriority: u=4\r\n",
        True,
    ),
)  # fmt: skip
