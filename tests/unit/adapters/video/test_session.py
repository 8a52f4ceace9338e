"""One client of RTSP: what it may ask, in which order, and where pictures may go."""

from __future__ import annotations

import pytest
from uwserver_adapters.video.rtsp import Request
from uwserver_adapters.video.session import Session

HOST = "192.0.2.7"
TCP = "RTP/AVP/TCP;unicast;interleaved=0-1"
UDP = "RTP/AVP;unicast;client_port=5000-5001"


class Described:
    def __init__(self, name: str) -> None:
        self.name = name

    def description(self) -> list[str]:
        return ["m=video 0 RTP/AVP 96", "a=rtpmap:96 H264/90000"]


class Media:
    def __init__(self) -> None:
        self.said: list[object] = []

    def interleave(self, channel: int) -> None:
        self.said.append(("tcp", channel))

    def open_udp(self, pair: tuple[int, int]) -> tuple[int, int] | None:
        self.said.append(("udp", *pair))
        return 6000, 6001

    def play(self, stream: str) -> None:
        self.said.append(("play", stream))

    def pause(self) -> None:
        self.said.append("pause")


class Client:
    def __init__(self, allows_udp: bool = True) -> None:
        self.media, self.streams = Media(), {name: Described(name) for name in ("front", "rov/camera")}
        self.session = Session("abc1", self.streams, self.media, HOST, 10.0, allows_udp)
        self.seq = 0

    def ask(self, method: str, uri: str = "rtsp://h:8554/front", **headers: str) -> tuple[int, dict[str, str], str]:
        self.seq += 1
        fields = {"cseq": str(self.seq), **{name.replace("_", "-").lower(): text for name, text in headers.items()}}
        head, _, body = self.session.answer(Request(method, uri, "RTSP/1.0", fields)).decode().partition("\r\n\r\n")
        first, *lines = head.split("\r\n")
        answers = dict(line.split(": ", 1) for line in lines)
        assert answers["CSeq"] == str(self.seq)
        assert int(answers.get("Content-Length", 0)) == len(body)
        return int(first.split()[1]), answers, body


def test_a_whole_conversation():
    client = Client()
    status, headers, _ = client.ask("OPTIONS", "*")
    assert (status, set(headers["Public"].split(", "))) == (
        200, {"OPTIONS", "DESCRIBE", "SETUP", "PLAY", "PAUSE", "GET_PARAMETER", "SET_PARAMETER", "TEARDOWN"},
    )  # fmt: skip
    status, headers, body = client.ask("DESCRIBE", accept="application/sdp")
    assert (status, headers["Content-Base"]) == (200, "rtsp://h:8554/front/")
    assert body.startswith("v=0\r\no=- ")
    assert body.endswith("m=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\na=control:video\r\n")
    status, headers, _ = client.ask("SETUP", "rtsp://h:8554/front/video", transport=TCP)
    assert (status, headers["Transport"], headers["Session"]) == (200, TCP, "abc1;timeout=10")
    assert client.ask("PLAY", session="abc1")[0] == 200
    assert client.ask("GET_PARAMETER", session="abc1")[0] == 200
    assert client.ask("PAUSE", session="abc1")[0] == 200
    assert client.ask("PLAY", session="abc1")[0] == 200
    assert client.ask("TEARDOWN", session="abc1")[0] == 200
    assert client.media.said == [("tcp", 0), ("play", "front"), "pause", ("play", "front"), "pause"]
    client.session.end()
    assert client.media.said[-2:] == [("play", "front"), "pause"]


def test_datagrams_go_to_the_client_s_own_address_alone():
    client = Client()
    assert client.ask("SETUP", transport=f"{UDP};destination=203.0.113.5")[0] == 461
    assert client.ask("SETUP", transport="RTP/AVP;unicast;client_port=53-54")[0] == 461
    assert client.ask("SETUP", transport="RTP/AVP;multicast;client_port=5000-5001")[0] == 461
    assert client.ask("SETUP", transport="RTP/AVP;unicast")[0] == 461
    assert client.media.said == []
    status, headers, _ = client.ask("SETUP", transport=f"{UDP};destination={HOST}")
    assert (status, headers["Transport"]) == (200, f"{UDP};server_port=6000-6001")
    assert client.media.said == [("udp", 5000, 5001)]


def test_where_datagrams_are_not_allowed_the_connection_is_offered():
    client = Client(allows_udp=False)
    status, _, body = client.ask("SETUP", transport=UDP)
    assert status == 461
    assert body == "offer RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
    assert client.ask("SETUP", transport=f"{UDP},{TCP}")[1]["Transport"] == TCP


@pytest.mark.parametrize(
    "uri",
    [
        "rtsp://h/front",
        "rtsp://h/front/",
        "rtsp://h:1/front/video",
        "/front",
        "rtsp://h/%66ront",
        "rtsp://h/rov/camera/video",
    ],
)
def test_names_of_a_stream(uri):
    assert Client().ask("SETUP", uri, transport=TCP)[0] == 200


@pytest.mark.parametrize(
    "uri", ["*", "rtsp://h/", "rtsp://h/frnt", "rtsp://[/front", "rtsp://h/../etc/passwd", "rtsp://h/video"]
)
def test_other_names_are_told_what_there_is(uri):
    status, _, body = Client().ask("DESCRIBE", uri)
    assert status == 404
    assert body.endswith("there are: front, rov/camera\r\n")
    assert ('did you mean "front"?' in body) is uri.endswith("frnt")


def test_what_is_refused():
    client = Client()
    assert client.ask("PLAY")[0] == 455
    assert client.ask("PAUSE")[0] == 455
    assert client.ask("RECORD")[0] == 501
    assert client.ask("DESCRIBE", accept="text/html")[0] == 406
    assert client.ask("OPTIONS", session="other")[0] == 454
    assert client.ask("OPTIONS", require="funky")[:2] == (551, {"CSeq": "6", "Unsupported": "funky"})
    assert client.ask("SETUP", transport=TCP)[0] == 200
    assert client.ask("SETUP", "rtsp://h/rov/camera", transport=TCP)[0] == 459
    assert client.ask("PLAY")[0] == 200
    assert client.ask("SETUP", transport=TCP)[0] == 455
    del client.streams["front"]
    client.ask("PAUSE")
    assert client.ask("PLAY")[0] == 404


@pytest.mark.parametrize("seq", [None, "", "x", "-1", "1 ", "9" * 11, "\u00b2"])
def test_a_request_has_a_number(seq):
    session = Client().session
    found = session.answer(Request("OPTIONS", "*", "RTSP/1.0", {} if seq is None else {"cseq": seq}))
    assert found.startswith(b"RTSP/1.0 400 ")
    assert b"CSeq:" not in found


def test_another_version_is_refused():
    assert Client().session.answer(Request("OPTIONS", "*", "RTSP/2.0", {"cseq": "1"})).startswith(b"RTSP/1.0 505 ")


def test_what_a_client_says_makes_no_lines_of_an_answer():
    client = Client()
    for method, uri, headers in (
        ("DESCRIBE", "rtsp://h/front?\x85x: y", {}),
        ("OPTIONS", "*", {"require": "a\x0bb\x85c\u2028d"}),
        ("DESCRIBE", "rtsp://h/%0d%0aX:%20y", {}),
    ):
        data = client.session.answer(Request(method, uri, "RTSP/1.0", {"cseq": "1", **headers}))
        head = data.partition(b"\r\n\r\n")[0]
        assert all(32 <= byte < 127 for byte in head.replace(b"\r\n", b""))
        assert b"\r\nX:" not in data
