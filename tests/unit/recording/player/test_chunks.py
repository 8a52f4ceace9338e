"""MCAP files by their chunks: with an index, without, growing, cut off, and hostile."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from uwserver.logfiles.readers.mcap_records import MAGIC
from uwserver.recording.player.chunks import Chunks, McapMessage, NotPlayable, renamed


def write(
    path: Path, chunks: int = 5, finish: bool = True, compression: CompressionType = CompressionType.ZSTD
) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        writer.add_metadata("head", {"a": "b"})
        schema = writer.register_schema("x", "jsonschema", b"{}")
        often, rare = (writer.register_channel(name, "json", schema) for name in ("rov/often", "rov/rare"))
        for k in range(chunks):
            for n in range(10):
                writer.add_message(often, 100 * k + n, b"o%d" % (10 * k + n), 0)
            if k == 2:
                writer.add_message(rare, 100 * k + 50, b"rare", 0)
            writer.flush()
        if finish:
            writer.finish()


def all_of(chunks: Chunks) -> list[McapMessage]:
    return [message for k in range(len(chunks.chunks)) for message in chunks.messages(k)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "x.mcap"


@pytest.mark.parametrize("finish", [True, False])
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE])
def test_a_file_with_an_index_and_one_without_say_the_same(
    path: Path, finish: bool, compression: CompressionType
) -> None:
    write(path, finish=finish, compression=compression)
    chunks = Chunks(path)
    assert chunks.has_index == chunks.is_finished == finish
    assert chunks.metadata == {"head": {"a": "b"}}
    assert [(chunk.start_ns, chunk.end_ns) for chunk in chunks.chunks] == [
        (0, 9), (100, 109), (200, 250), (300, 309), (400, 409)]  # fmt: skip
    assert len(all_of(chunks)) == 51
    numbers = {channel.topic: number for number, channel in chunks.channels.items()}
    assert set(numbers) == {"rov/often", "rov/rare"}
    assert list(chunks.holding(numbers["rov/rare"])) == [2]
    assert chunks.last_with(numbers["rov/rare"], 5) == 2
    assert chunks.last_with(numbers["rov/rare"], 2) == -1
    assert chunks.last_with(numbers["rov/often"], 4) == 3
    chunks.close()


def test_with_an_index_nothing_else_is_unpacked(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(path)
    unpacked: list[int] = []
    whole = Chunks._unpacked
    monkeypatch.setattr(
        Chunks, "_unpacked", lambda self, chunk: (unpacked.append(chunk.start_ns), whole(self, chunk))[1]
    )
    chunks = Chunks(path)
    assert unpacked == []
    chunks.messages(3)
    chunks.messages(3)
    assert unpacked == [300]
    chunks.close()


def test_a_file_that_grows_is_followed_to_its_end(path: Path) -> None:
    write(path)
    whole = path.read_bytes()
    path.write_bytes(b"")
    seen = []
    with path.open("r+b") as file:
        file.write(whole[:60])
        file.flush()
        chunks = Chunks(path)
        for end in range(61, len(whole) + 1, 7):
            file.write(whole[file.tell() : end])
            file.flush()
            chunks.refresh()
            seen.append(len(chunks.chunks))
        file.write(whole[file.tell() :])
    chunks.refresh()
    assert seen == sorted(seen)
    assert chunks.is_finished
    assert len(all_of(chunks)) == 51
    assert not chunks.refresh()
    chunks.close()


@pytest.mark.parametrize("data", [b"", b"ROSBAG V2.0", MAGIC[:-1]])
def test_another_file_is_told(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    with pytest.raises(NotPlayable, match="not an MCAP file"):
        Chunks(path)


def test_a_cut_file_gives_all_but_its_end(path: Path) -> None:
    write(path)
    whole = path.read_bytes()
    counts = set()
    for end in range(len(MAGIC), len(whole), 11):
        path.write_bytes(whole[:end])
        chunks = Chunks(path)
        counts.add(len(all_of(chunks)))
        assert not chunks.has_index
        chunks.close()
    assert counts <= {0, 10, 20, 31, 41, 51}
    assert {0, 51} <= counts


def test_lengths_that_lie_cost_nothing(path: Path) -> None:
    write(path, chunks=2)
    whole = path.read_bytes()
    for at in range(len(MAGIC), len(whole) - 8, 5):
        path.write_bytes(whole[:at] + struct.pack("<Q", 1 << 60) + whole[at + 8 :])
        try:
            chunks = Chunks(path)
        except NotPlayable:
            continue
        try:
            assert len(all_of(chunks)) <= 20
        except NotPlayable as fault:
            assert "allowed" in str(fault) or "shorter" in str(fault) or "compression" in str(fault)  # noqa: PT017
        chunks.close()


def test_a_chunk_that_would_unpack_to_too_much_is_refused(path: Path) -> None:
    write(path, chunks=1)
    chunks = Chunks(path)
    body = bytearray(path.read_bytes())
    struct.pack_into("<Q", body, chunks.chunks[0].offset + 16, 1 << 40)
    chunks.close()
    path.write_bytes(body)
    chunks = Chunks(path)
    with pytest.raises(NotPlayable, match="at most 268435456"):
        chunks.messages(0)
    chunks.close()


def test_a_file_that_shrinks_or_is_replaced_is_told(path: Path) -> None:
    write(path, finish=False)
    chunks = Chunks(path)
    assert not chunks.is_replaced
    other = path.with_name("other")
    other.write_bytes(path.read_bytes())
    other.replace(path)
    assert chunks.is_replaced
    assert len(all_of(chunks)) == 51, "the one that was opened is there"
    chunks.close()
    chunks = Chunks(path)
    path.write_bytes(b"")
    with pytest.raises(NotPlayable, match="shorter"):
        chunks.refresh()
    with pytest.raises(NotPlayable, match="shorter"):
        chunks.messages(1)
    chunks.close()


def test_only_a_first_level_has_another_name() -> None:
    names = {"rov": "ghost"}
    assert renamed("rov/imu", names) == "ghost/imu"
    assert renamed("rov", names) == "ghost"
    assert renamed("auv/rov", names) == "auv/rov"
