"""The RTSP session of a connection, at most one and of one stream: requests in, answers out. Sans-IO.

The session ends with its connection, so pictures never go to an address that has not completed a TCP handshake.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Protocol
from urllib.parse import unquote, urlsplit

from uwserver.adapter import did_you_mean
from uwserver_adapters.video.rtsp import VERSION, Request, Transport, answer, sequence_number, transports

PUBLIC: Final = "OPTIONS, DESCRIBE, SETUP, PLAY, PAUSE, GET_PARAMETER, SET_PARAMETER, TEARDOWN"
CONTROL: Final = "video"
"""Name of a stream's only medium, below the stream's path."""
LOWEST_PORT: Final = 1024
"""Lowest UDP port of a client. Ports below belong to services of its machine."""
_SDP: Final = "application/sdp"


class Described(Protocol):
    """A stream that can be requested.

    Attributes:
        name: its path.
    """

    name: str

    def description(self) -> list[str]:
        """Return its lines in a session description."""


class Media(Protocol):
    """How packets reach the client."""

    def interleave(self, channel: int) -> None:
        """Send packets between the answers: RTP on this channel, and RTCP on the next."""

    def open_udp(self, pair: tuple[int, int]) -> tuple[int, int] | None:
        """Send packets to these ports of the client's own address. Returns our ports, or None without any."""

    def play(self, stream: str) -> None:
        """Begin with the next key picture."""

    def pause(self) -> None:
        """Send no more pictures for now. May be called again."""


class Session:
    """The session of one client.

    Args:
        serial: number of the session, hexadecimal.
        streams: streams that can be requested, by name; may change.
        media: how packets reach the client.
        host: the client's host, as a destination would name it.
        keep_alive_s: time-out that is told to the client.
        allows_udp: whether a client may request datagrams.

    Attributes:
        is_playing: pictures are being sent.
        stream: name of the stream that was set up; "" for none.
    """

    def __init__(
        self, serial: str, streams: Mapping[str, Described], media: Media, host: str, keep_alive_s: float, allows_udp: bool,
    ) -> None:  # fmt: skip
        self.is_playing = False
        self.stream = ""
        self._serial = serial
        self._streams = streams
        self._media = media
        self._host = host
        self._keep_alive_s = keep_alive_s
        self._allows_udp = allows_udp
        self._methods: dict[str, Callable[[Request, str], bytes]] = {
            "OPTIONS": self._options, "DESCRIBE": self._describe, "SETUP": self._set_up, "PLAY": self._play, "PAUSE": self._pause,
            "GET_PARAMETER": self._get_parameter, "SET_PARAMETER": self._get_parameter, "TEARDOWN": self._tear_down,
        }  # fmt: skip

    def answer(self, request: Request) -> bytes:
        """Carry out a request, and return the answer."""
        seq = sequence_number(request)
        if not seq:
            return _refused(400, "", "a request needs a header CSeq with its number")
        if request.version != VERSION:
            return _refused(505, seq, f"only {VERSION} is supported here")
        if "require" in request.headers:
            return answer(551, seq, {"Unsupported": _plain(request.headers["require"])})
        method = self._methods.get(request.method)
        if method is None:
            return answer(501, seq, {"Public": PUBLIC})
        if request.headers.get("session", self._serial).partition(";")[0].strip() != self._serial:
            return _refused(454, seq, "this connection has no such session")
        return method(request, seq)

    def end(self) -> None:
        """End the session: the client has gone, or counts as gone."""
        self.stream = ""
        self._stop()

    def _stop(self) -> None:
        if self.is_playing:
            self.is_playing = False
            self._media.pause()

    # -- methods --------------------------------------------------------------------------------------------------------------------

    def _options(self, request: Request, seq: str) -> bytes:
        return answer(200, seq, {"Public": PUBLIC})

    def _describe(self, request: Request, seq: str) -> bytes:
        accept = request.headers.get("accept", _SDP).lower()
        if _SDP not in accept and "*/*" not in accept:
            return _refused(406, seq, f"streams are described as {_SDP}")
        stream = self._found(request)
        if stream is None:
            return self._unknown(request, seq)
        lines = [
            "v=0", f"o=- {int(self._serial, 16)} 1 IN IP4 0.0.0.0", f"s={_plain(stream.name)}", "c=IN IP4 0.0.0.0", "t=0 0",
            "a=control:*", "a=range:npt=now-", *stream.description(), f"a=control:{CONTROL}",
        ]  # fmt: skip
        base = _plain(request.uri).rstrip("/") + "/"
        return answer(200, seq, {"Content-Type": _SDP, "Content-Base": base}, "\r\n".join(lines) + "\r\n")

    def _set_up(self, request: Request, seq: str) -> bytes:
        stream = self._found(request)
        if stream is None:
            return self._unknown(request, seq)
        if self.is_playing:
            return _refused(455, seq, "PAUSE or TEARDOWN first")
        if self.stream not in ("", stream.name):
            return _refused(459, seq, "a connection carries one stream: open another connection for the other stream")
        for offer in transports(request.headers.get("transport", "")):
            agreed = self._agreed(offer)
            if agreed:
                self.stream = stream.name
                session = f"{self._serial};timeout={self._keep_alive_s:.0f}"
                return answer(200, seq, {"Transport": agreed, "Session": session})
        udp = ", or RTP/AVP;unicast;client_port=5000-5001 to your own address" if self._allows_udp else ""
        return _refused(461, seq, f"offer RTP/AVP/TCP;unicast;interleaved=0-1{udp}")

    def _agreed(self, offer: Transport) -> str:
        """Return the header `Transport` for an accepted offer, "" for one that is not accepted."""
        if offer.is_tcp:
            first, second = offer.pair or (0, 1)
            self._media.interleave(first)
            return f"RTP/AVP/TCP;unicast;interleaved={first}-{second}"
        if not self._allows_udp or offer.pair is None or min(offer.pair) < LOWEST_PORT:
            return ""
        if offer.destination not in ("", self._host):
            return ""
        ours = self._media.open_udp(offer.pair)
        if ours is None:
            return ""
        return f"RTP/AVP;unicast;client_port={offer.pair[0]}-{offer.pair[1]};server_port={ours[0]}-{ours[1]}"

    def _play(self, request: Request, seq: str) -> bytes:
        if not self.stream:
            return _refused(455, seq, "SETUP first")
        if self.stream not in self._streams:
            return self._unknown(request, seq)
        if not self.is_playing:
            self.is_playing = True
            self._media.play(self.stream)
        return answer(200, seq, {"Session": self._serial, "Range": "npt=now-"})

    def _pause(self, request: Request, seq: str) -> bytes:
        if not self.stream:
            return _refused(455, seq, "SETUP first")
        self._stop()
        return answer(200, seq, {"Session": self._serial})

    def _get_parameter(self, request: Request, seq: str) -> bytes:
        """Answer a keep-alive, which names no parameters. No parameters are known."""
        if request.body.strip():
            return answer(451, seq)
        return answer(200, seq, {"Session": self._serial} if self.stream else {})

    def _tear_down(self, request: Request, seq: str) -> bytes:
        self.end()
        return answer(200, seq)

    # -- streams --------------------------------------------------------------------------------------------------------------------

    def _found(self, request: Request) -> Described | None:
        name = _name(request.uri)
        found = self._streams.get(name)
        if found is None and name.endswith(f"/{CONTROL}"):
            found = self._streams.get(name[: -len(CONTROL) - 1])
        return found

    def _unknown(self, request: Request, seq: str) -> bytes:
        known = sorted(self._streams)
        there = ", ".join(known[:16]) or "none: the world has no sensor with pictures"
        name = _name(request.uri)[:200]
        return _refused(404, seq, f"no stream has this name{did_you_mean(name, known)}; there are: {there}")


def _name(uri: str) -> str:
    try:
        return unquote(urlsplit(uri).path).strip("/")
    except ValueError:
        return ""


def _plain(text: str) -> str:
    """Return a text of a peer or a scenario with only characters that may stand in a line."""
    return "".join(char if "\x20" <= char <= "\x7e" else "?" for char in text)[:1024]


def _refused(status: int, seq: str, text: str) -> bytes:
    return answer(status, seq, {"Content-Type": "text/plain"}, f"{_plain(text)}\r\n")
