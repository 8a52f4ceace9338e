"""Requests of RTSP in pieces of any size, and what is none."""

from __future__ import annotations

import pytest
from uwserver_adapters.video import rtsp
from uwserver_adapters.video.rtsp import (
    BODY_LIMIT,
    HEAD_LIMIT,
    Interleaved,
    Malformed,
    Reader,
    Request,
    Transport,
    answer,
    transports,
)

DESCRIBE = b"DESCRIBE rtsp://h:8554/front RTSP/1.0\r\nCSeq: 2\r\nAccept: application/sdp\r\n\r\n"
KEEP = b"GET_PARAMETER * RTSP/1.0\nCSeq: 3\nContent-Length: 4\ncontent-length: 9\n\nabcd"
REPORT = b"$\x01\x00\x08" + b"\x81\xc9\x00\x01abcd"
STREAM = b"\r\n" + DESCRIBE + REPORT + KEEP + b"\r\n\r\n" + DESCRIBE
EVENTS = [
    Request("DESCRIBE", "rtsp://h:8554/front", "RTSP/1.0", {"cseq": "2", "accept": "application/sdp"}),
    Interleaved(1, REPORT[4:]),
    Request("GET_PARAMETER", "*", "RTSP/1.0", {"cseq": "3", "content-length": "4"}, b"abcd"),
    Request("DESCRIBE", "rtsp://h:8554/front", "RTSP/1.0", {"cseq": "2", "accept": "application/sdp"}),
]


def read(data: bytes, size: int) -> list[object]:
    reader, found = Reader(), []
    for start in range(0, len(data), size):
        reader.receive(data[start : start + size])
        while (event := reader.next_event()) is not None:
            found.append(event)
    return found


@pytest.mark.parametrize("size", [1, 2, 3, 5, 1000])
def test_requests_and_packets_in_pieces(size):
    assert read(STREAM, size) == EVENTS


@pytest.mark.parametrize("size", [1, 1 << 20])
@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"RTSP/1.0 200 OK\r\nCSeq: 1\r\n\r\n", 400),
        (b"DESCRIBE rtsp://h/ RTSP/1.0 x\r\n\r\n", 400),
        (b"describe rtsp://h/ RTSP/1.0\r\n\r\n", 400),
        (b"\xff\xfe\r\n\r\n", 400),
        (b"OPTIONS * RTSP/1.0\r\nno header\r\n\r\n", 400),
        (b"OPTIONS * RTSP/1.0\r\nCSeq: \x00\r\n\r\n", 400),
        (b"OPTIONS * RTSP/1.0\r\nContent-Length: -1\r\n\r\n", 413),
        (b"OPTIONS * RTSP/1.0\r\nContent-Length: 99999999999\r\n\r\n", 413),
        (b"OPTIONS * RTSP/1.0\r\nContent-Length: %d\r\n\r\n" % (BODY_LIMIT + 1), 413),
        (b"OPTIONS * RTSP/1.0\r\nX: " + b"x" * HEAD_LIMIT + b"\r\n\r\n", 413),
        (b"x" * 100_000, 413),
    ],
)
def test_what_is_no_request_ends_it(data, status, size):
    events = read(data + DESCRIBE, size)
    assert isinstance(events[-1], Malformed)
    assert [event.status for event in events if isinstance(event, Malformed)] == [status]


def test_half_a_request_waits():
    reader = Reader()
    for part in (DESCRIBE[:-1], KEEP[:-1], b"$\x00\xff\xff" + bytes(1000)):
        reader = Reader()
        reader.receive(part)
        assert reader.next_event() is None
        assert reader.next_event() is None


def test_a_head_is_read_once_however_its_body_comes(monkeypatch):
    heads: list[bytes] = []
    whole = rtsp.Reader._request
    monkeypatch.setattr(rtsp.Reader, "_request", lambda self, at: heads.append(b"") or whole(self, at))
    body = b"a\r\n\r\n$\x00" * 100
    asked = b"SET_PARAMETER * RTSP/1.0\r\nCSeq: 3\r\nContent-Length: %d\r\n\r\n" % len(body)
    first, second = read(asked + body + DESCRIBE, 1)
    assert (first.body, second.method, len(heads)) == (body, "DESCRIBE", 2)


@pytest.mark.parametrize(
    ("text", "offers"),
    [
        ("RTP/AVP/TCP;unicast;interleaved=2-3", [Transport(True, (2, 3), "")]),
        ("RTP/AVP/TCP", [Transport(True, None, "")]),
        ("RTP/AVP;unicast;client_port=5000-5001", [Transport(False, (5000, 5001), "")]),
        ("RTP/AVP/UDP; unicast; client_port=5000 ;mode=\"PLAY\"", [Transport(False, (5000, 5001), "")]),
        ("RTP/AVP;multicast;client_port=5000-5001,RTP/AVP/TCP;interleaved=0-1", [Transport(True, (0, 1), "")]),
        ("RTP/AVP;client_port=5000-5001;destination=10.0.0.9", [Transport(False, (5000, 5001), "10.0.0.9")]),
        ("RTP/AVP;client_port=70000-70001", [Transport(False, None, "")]),
        ("RTP/AVP;client_port=5-5", [Transport(False, None, "")]),
        ("RTP/AVP/TCP;interleaved=255-256", [Transport(True, None, "")]),
        ("RTP/AVP/TCP;interleaved=255-0", [Transport(True, None, "")]),
        ("RTP/AVP/TCP;interleaved=255", [Transport(True, None, "")]),
        ("RTP/AVP/TCP;interleaved=2-4", [Transport(True, None, "")]),
        ("RTP/AVP/TCP;interleaved=254-255", [Transport(True, (254, 255), "")]),
        ("RTP/AVP/TCP;mode=record", []),
        ("RTP/SAVP;client_port=5000-5001", []),
        ("", []),
    ],
)  # fmt: skip
def test_ways_that_a_client_offers(text, offers):
    assert transports(text) == offers


def test_an_answer():
    assert answer(200, "7", {"Session": "a"}, "é") == (
        b"RTSP/1.0 200 OK\r\nCSeq: 7\r\nSession: a\r\nContent-Length: 2\r\n\r\n\xc3\xa9"
    )
    assert answer(404, "") == b"RTSP/1.0 404 Not Found\r\n\r\n"
