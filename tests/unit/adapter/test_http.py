"""Heads of requests: what they say, what is none, and that none of them takes time that others need."""

from __future__ import annotations

import time

import pytest

from uwserver.adapter.http import HEAD_LIMIT, parse


def test_a_head_is_read() -> None:
    request = parse(b"GET /a?b HTTP/1.1\r\nHost: \t here \t\r\nX:1\r\nx: 2\r\nEmpty:")
    assert request is not None
    assert (request.method, request.path) == ("GET", "/a")
    assert request.headers == {"host": ("here",), "x": ("1", "2"), "empty": ("",)}
    assert (request.header("host"), request.header("x")) == ("here", "")


@pytest.mark.parametrize("line", [b"x: a\nHost: b", b"x: \n", b"x: a\rb", b"x: \0", b" x: a", b"x : a", b"x", b""])
def test_what_is_no_header_is_no_request(line: bytes) -> None:
    assert parse(b"GET / HTTP/1.1\r\n" + line) is None


@pytest.mark.parametrize("line", [b"x:" + b" " * 900 + b"\n", b"x:a" + b" " * 15_000 + b"b", b"x:\r\n" * 4000 + b"x:"])
def test_no_head_takes_long(line: bytes) -> None:
    head = b"GET / HTTP/1.1\r\n" + line
    assert len(head) <= HEAD_LIMIT + 100
    before = time.process_time()
    parse(head)
    assert time.process_time() - before < 0.05
