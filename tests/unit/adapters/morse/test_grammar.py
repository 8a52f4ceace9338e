"""Requests and answers of MORSE, byte by byte."""

import pytest
from uwserver_adapters.morse.grammar import Cancel, Malformed, Request, RequestDecoder, answer, parse

from uwserver.testing.codecs import read_all

# As pymorse and people with `nc` write them.
LINES = [
    (b"0 simulation details []\n", Request("0", "simulation", "details")),
    (b"1 simulation details\n", Request("1", "simulation", "details")),
    (b'2 simulation get_stream_port ["heavy.pose"]\n', Request("2", "simulation", "get_stream_port", ("heavy.pose",))),
    (b"id3  heavy.waypoint\tgoto  [1, 2.5, -3, true, null]\r\n", Request("id3", "heavy.waypoint", "goto", (1, 2.5, -3, True, None))),
    (b'4 a b ["x y", {"k": [1]}]\n', Request("4", "a", "b", ("x y", {"k": [1]}))),
    (b"4 cancel\n", Cancel("4")),
]  # fmt: skip


@pytest.mark.parametrize(("line", "event"), LINES)
def test_table_of_bytes(line: bytes, event: object) -> None:
    assert read_all(RequestDecoder(), [line], None) == [event]
    assert read_all(RequestDecoder(), [line[i : i + 1] for i in range(len(line))], None) == [event]


def test_requests_in_one_piece_and_split_ones_are_all_taken() -> None:
    """MORSE died of a request that came in two pieces."""
    data = b"".join(line for line, _ in LINES)
    for cut in range(0, len(data), 7):
        assert read_all(RequestDecoder(), [data[:cut], data[cut:]], None) == [event for _, event in LINES]


@pytest.mark.parametrize(
    ("line", "id", "text"),
    [
        (b"x" * 80, "", "at most 79"),
        (b"7", "7", "COMPONENT SERVICE"),
        (b"7 simulation", "7", "COMPONENT SERVICE"),
        (b"7 a b {1", "7", "no JSON"),
        (b"7 a b 1.5", "7", "JSON list"),
        (b'7 a b {"x": 1}', "7", "JSON list"),
        (b"7 a b [NaN]", "7", "no JSON"),
        (b"7 a \xff\xfe []", "", "no UTF-8"),
        (b"7 " + b"a" * 257 + b" b []", "7", "256"),
        (b"7 a b " + b"[" * 100_000, "7", "JSON"),
    ],
)
def test_malformed_lines_are_told_under_their_id(line: bytes, id: str, text: str) -> None:
    event = parse(line)
    assert isinstance(event, Malformed)
    assert event.id == id
    assert text in event.text
    assert len(event.text) < 300


def test_a_line_that_is_too_long_costs_no_other() -> None:
    decoder = RequestDecoder(100)
    events = read_all(decoder, [b"1 a b [" + b"1," * 100 + b"1]\n2 a b []\n"], None)
    assert isinstance(events[0], Malformed)
    assert events[1] == Request("2", "a", "b")


@pytest.mark.parametrize(
    ("value", "line"),
    [
        (None, b"3 SUCCESS\n"),
        (False, b"3 SUCCESS false\n"),
        (0, b"3 SUCCESS 0\n"),
        ([], b"3 SUCCESS []\n"),
        ("", b'3 SUCCESS ""\n'),
        ({"a": [1.5, None]}, b'3 SUCCESS {"a":[1.5,null]}\n'),
        (float("nan"), b"3 SUCCESS null\n"),
    ],
)
def test_answers(value: object, line: bytes) -> None:
    """False, zero and empty lists are told as they are: MORSE left them out."""
    assert answer("3", "SUCCESS", value) == line  # type: ignore[arg-type]


def test_an_answer_to_a_line_without_id_can_be_read() -> None:
    assert answer("", "FAILED", "a\nb") == b'- FAILED "a\\nb"\n'
