"""The codec suite must see the faults it is there for."""

from __future__ import annotations

import pytest

from uwserver.testing import CodecCase, check_codec

NEED_DATA = object()


class Lines:
    """A codec of lines, right or with one fault."""

    def __init__(self, fault: str = "") -> None:
        self.fault = fault
        self.rest = b""

    def receive(self, data: bytes) -> None:
        self.rest = data if self.fault == "forgets pieces" else self.rest + data

    def next_event(self) -> object:
        if self.fault == "endless" and self.rest:
            return "again"
        line, separator, rest = self.rest.partition(b"\n")
        if not separator:
            if self.fault == "hasty" and line:
                self.rest = b""
                return line.decode()
            return NEED_DATA
        self.rest = b"" if self.fault == "one a piece" else rest
        if line.startswith(b"?") and self.fault == "raises":
            raise ValueError(line)
        if line.startswith(b"?") and self.fault == "lost":
            self.rest = b""
            self.receive = lambda data: None  # type: ignore[method-assign]
        return line.decode()


CASES = [
    CodecCase("one", b"one\n", ("one",)),
    CodecCase("two", b"a\nb\n", ("a", "b")),
    CodecCase("written", b"ok\n", write=lambda _: b"ok\n"),
]


def check(fault: str) -> None:
    check_codec(lambda: Lines(fault), CASES, need_data=NEED_DATA, garbage=[b"???\n"], resynchronises=True)


def test_right() -> None:
    check("")


@pytest.mark.parametrize(
    ("fault", "phrase"),
    [
        ("forgets pieces", "byte by byte"),
        ("endless", "without end"),
        ("hasty", "byte by byte"),
        ("one a piece", "two"),
        ("lost", "after garbage"),
    ],
)
def test_faults_are_seen(fault: str, phrase: str) -> None:
    with pytest.raises(AssertionError, match=phrase):
        check(fault)


def test_exceptions_are_not_hidden() -> None:
    with pytest.raises(ValueError, match=r"\?"):
        check("raises")


def test_wrong_bytes_are_seen() -> None:
    with pytest.raises(AssertionError, match="the table says"):
        check_codec(Lines, [CodecCase("x", b"x\n", write=lambda _: b"y\n")], need_data=NEED_DATA)
