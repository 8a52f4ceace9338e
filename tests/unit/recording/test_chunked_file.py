"""An MCAP file written in chunks is, byte for byte, the one that the library would have written."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from uwserver.recording.chunked_file import ChunkedFile

LIBRARY, CHUNK = "uwserver test", 2000


class Both:
    """The same said to the library and to ours."""

    def __init__(self) -> None:
        self.theirs, self.ours = io.BytesIO(), io.BytesIO()
        self._theirs: Any = Writer(self.theirs, chunk_size=CHUNK)
        self._theirs.start("", LIBRARY)
        self._ours = ChunkedFile(self.ours, LIBRARY, CHUNK)

    def channel(self, topic: str) -> int:
        """With a schema of its own."""
        schema = self._theirs.register_schema(topic, "jsonschema", b"{}" * 40)
        assert self._ours.register_schema(topic, "jsonschema", b"{}" * 40) == schema
        about = {"kind": "imu", "doc": "ä"}
        channel: int = self._theirs.register_channel(topic, "json", schema, about)
        assert self._ours.register_channel(topic, "json", schema, about) == channel
        return channel

    def messages(self, heads: list[tuple[int, int, int, int]], bodies: list[bytes]) -> None:
        """Theirs one by one, ours at once."""
        for (channel, sequence, log_ns, publish_ns), data in zip(heads, bodies, strict=True):
            self._theirs.add_message(channel, log_ns, data, publish_ns, sequence)
        self._ours.add_messages(heads, [*bodies, b""])

    def all(self, method: str, *args: object) -> None:
        """A method that both have."""
        getattr(self._theirs, method)(*args)
        getattr(self._ours, method)(*args)

    def attachment(self, data: bytes) -> None:
        """A file in the file."""
        self._theirs.add_attachment(0, 0, "state", "application/msgpack", data)
        self._ours.add_attachment("state", "application/msgpack", data)


@pytest.fixture
def both() -> Both:
    return Both()


def random_messages(channels: list[int], count: int, seed: int) -> tuple[list[tuple[int, int, int, int]], list[bytes]]:
    rng = np.random.default_rng(seed)
    heads = [
        (channels[int(k)], int(rng.integers(2**32)), int(rng.integers(2**62)), int(rng.integers(2**62)))
        for k in rng.integers(len(channels), size=count)
    ]
    return heads, [rng.bytes(int(size)) for size in rng.integers(0, 300, size=count)]


def test_it_is_the_file_of_the_library(both: Both) -> None:
    both.all("add_metadata", "uwserver", {"seed": "3", "scenario": "{}" * 900})
    channels = [both.channel(f"rov/{k}") for k in range(30)]  # more than a chunk, without a message
    both.attachment(b"state" * 1000)
    for seed in range(20):
        both.messages(*random_messages(channels, 37, seed))
        if seed % 4 == 0:
            both.all("flush")
        if seed % 5 == 0:
            channels.append(both.channel(f"late/{seed}"))
    both.messages([(channels[0], 0, 5, 6)], [bytes(3 * CHUNK)])
    both.all("finish")
    assert both.ours.getvalue() == both.theirs.getvalue()


def test_one_without_messages_too(both: Both) -> None:
    both.channel("rov/imu")
    both.all("flush")
    both.all("finish")
    assert both.ours.getvalue() == both.theirs.getvalue()


def test_what_was_flushed_can_be_read_before_the_end(both: Both) -> None:
    channel = both.channel("rov/imu")
    both.messages([(channel, 1, 10, 9), (channel, 2, 20, 19)], [b"one", b"two"])
    both.all("flush")
    assert both.ours.getvalue() == both.theirs.getvalue()
    both.all("finish")
    both.ours.seek(0)
    found = [(m.data, m.log_time, m.publish_time, m.sequence) for _, _, m in make_reader(both.ours).iter_messages()]
    assert found == [(b"one", 10, 9, 1), (b"two", 20, 19, 2)]


def test_a_message_by_itself(both: Both) -> None:
    channel = both.channel("rov/imu")
    both._theirs.add_message(channel, 7, b"x", 6, 5)
    both._ours.add_message((channel, 5, 7, 6), b"x")
    both.all("finish")
    assert both.ours.getvalue() == both.theirs.getvalue()
