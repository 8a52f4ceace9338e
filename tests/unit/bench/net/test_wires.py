"""Framings of the bench's peers: whole messages out of pieces of any size."""

from __future__ import annotations

import pytest
from uwserver_bench.net.wires import Datagrams, JsonLines, MsgpackFrames, Refusal, TimedMessage, ask

MESSAGES = [
    {"id": 1, "result": {"tick": 3}},
    {"method": "sample", "params": {"value": {"u": [0.1, None]}}},
    {"id": "\n"},
]


@pytest.mark.parametrize("make", [JsonLines, MsgpackFrames])
@pytest.mark.parametrize("size", [1, 3, 7, 1000])
def test_messages_come_whole_out_of_pieces(make, size):
    stream = b"".join(make().encode(message) for message in MESSAGES)
    reader = make()
    found = [message for k in range(0, len(stream), size) for message in reader.feed(stream[k : k + size])]
    assert found == MESSAGES


def test_a_datagram_is_a_message():
    assert [Datagrams().feed(Datagrams().encode(message)) for message in MESSAGES] == [[m] for m in MESSAGES]


class Scripted:
    """Answers each request with a sample first, then as told."""

    def __init__(self, answer: dict) -> None:
        self.answer = answer
        self.waiting: list[TimedMessage] = []

    def send(self, method, params, identity) -> None:
        self.waiting = [
            TimedMessage(1, {"method": "sample", "params": {}}),
            TimedMessage(2, {"id": identity, **self.answer}),
        ]

    def receive(self, timeout_s) -> list[TimedMessage]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def fileno(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_ask_gives_the_result_and_keeps_the_rest():
    seen: list[TimedMessage] = []
    assert ask(Scripted({"result": 5}), "ping", seen=seen) == 5
    assert [message.body["method"] for message in seen] == ["sample"]


def test_ask_raises_what_the_server_refused():
    with pytest.raises(Refusal, match="ping: no"):
        ask(Scripted({"error": {"message": "no"}}), "ping")


def test_ask_does_not_wait_for_ever():
    with pytest.raises(TimeoutError, match="ping"):
        ask(Scripted({"id": "another"}), "ping", timeout_s=0.01)
