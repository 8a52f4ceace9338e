"""Recordings as columns: the same numbers as the library of the format gives, and what comes of files that are broken or not ours."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from playback_rig import recorded as dived

from uwserver.ports import Buffer, Field
from uwserver.recording.format import METADATA
from uwserver.recording.parts import Rotation
from uwserver.recording.report.reading import ACROSS, Echoes, Recorded, columns_of, read_recording

CHUNK = 0x06
HEAD = {"scenario": '{"name":"x","scenario":{},"vehicles":{}}'}


@pytest.mark.parametrize(
    ("port", "field"), [("rov/imu_noisy", "w_S"), ("rov/depth_noisy", "depth"), ("rov/truth/pose", "q_NB")]
)
def test_columns_are_what_the_library_reads(run: Path, recorded: Recorded, port: str, field: str) -> None:
    with run.open("rb") as file:
        messages = [json.loads(m.data) for _, _, m in make_reader(file).iter_messages(topics=[port])]
    series = recorded.series[port]
    told = np.array([np.atleast_1d(m["value"][field]) for m in messages], dtype=float)
    np.testing.assert_array_equal(series.columns[field], told)
    np.testing.assert_array_equal(series.t, [m["t_ns"] / 1e9 for m in messages])
    np.testing.assert_array_equal(series.seq, [m["seq"] for m in messages])
    assert series.fields[field].unit == {"w_S": "rad/s", "depth": "m", "q_NB": "1"}[field]


def test_bodies_without_truth_have_their_poses(recorded: Recorded) -> None:
    poses = recorded.poses["other"]
    assert "other/truth/pose" not in recorded.series
    assert 140 <= len(poses) <= 160  # 30 a second
    np.testing.assert_allclose(poses[0, 1:4], (5.0, 5.0, 3.0), atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 4:], axis=1), 1.0)


def test_events_and_end(recorded: Recorded) -> None:
    assert [event.event for event in recorded.events] == ["fault", "shutdown"]
    assert recorded.end_s == pytest.approx(5.0, abs=0.01)
    assert recorded.remarks == ()


@pytest.mark.parametrize("share", [0.6, 0.9])
def test_a_file_that_was_cut_is_read_as_far_as_it_goes(
    run: Path, recorded: Recorded, tmp_path: Path, share: float
) -> None:
    whole = run.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(len(whole) * share)])
    found = read_recording(cut)
    assert any("cut off" in remark for remark in found.remarks)
    assert 0 < len(found.series["rov/imu_noisy"].t) <= len(recorded.series["rov/imu_noisy"].t)


_CHUNK = 6


def _chunk_in_the_middle(data: bytes | bytearray) -> tuple[int, int]:
    """Return where the content of a chunk begins, and its length, bytes. Records follow the magic of 8 bytes: opcode, u64 length, content."""
    chunks, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == _CHUNK:
            chunks.append((at + 9, length))
        at += 9 + length
    return chunks[len(chunks) // 2]


def test_damage_in_the_middle_is_told(run: Path, tmp_path: Path) -> None:
    whole = bytearray(run.read_bytes())
    begin, length = _chunk_in_the_middle(whole)  # in an index of messages it would harm nothing that is read
    whole[begin + length // 2 : begin + length] = bytes(length - length // 2)
    (tmp_path / "bad.mcap").write_bytes(whole)
    found = read_recording(tmp_path / "bad.mcap")
    assert any("damaged" in remark or "cut off" in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("content", "told"),
    [(b"", "damaged at its start"), (b"PK\x03\x04" * 99, "damaged at its start"), (None, "not written by")],
)
def test_what_is_no_recording_of_ours_is_refused(tmp_path: Path, content: bytes | None, told: str) -> None:
    file = tmp_path / "other.mcap"
    file.write_bytes(recording([], {}) if content is None else content)
    with pytest.raises(ValueError, match=told):
        read_recording(file)


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="not a regular file"):
        read_recording(tmp_path)


def test_a_chunk_that_would_fill_the_memory_is_not_unpacked(tmp_path: Path) -> None:
    data = bytearray(recording([{"seq": 0, "t_ns": 1, "valid": True, "value": {"x": 1.0}}]))
    place = 8  # behind the magic: records of code and length
    while data[place] != CHUNK:
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    data[place + 25 : place + 33] = (1 << 40).to_bytes(8, "little")  # its uncompressed size, behind two times
    (tmp_path / "x.mcap").write_bytes(data)
    found = read_recording(tmp_path / "x.mcap")
    assert found.series == {}
    assert found.remarks


@pytest.mark.parametrize(
    "message",
    [
        b"{", b"[]", b'{"value":{"x":"high"},"t_ns":1}', b'{"value":{"x":[1,2]},"t_ns":1}', b'{"value":{"x":1},"t_ns":-5}',
        b'{"value":{"x":1},"t_ns":9999999999999999999}', b'{"value":7,"t_ns":1}', b'{"value":{"x":1,"v":[1,2,"z"]},"t_ns":1}',
    ],
)  # fmt: skip
def test_messages_that_do_not_fit_are_counted_and_the_others_stay_whole(tmp_path: Path, message: bytes) -> None:
    good = {"seq": 1, "t_ns": 2_000_000_000, "valid": True, "value": {"x": 4.0, "v": [1.0, None, 3.0]}}
    (tmp_path / "x.mcap").write_bytes(recording([message, good]))
    found = read_recording(tmp_path / "x.mcap")
    assert any("1 messages of a/b do not fit" in remark for remark in found.remarks)
    np.testing.assert_array_equal(found.series["a/b"].columns["v"], [[1.0, np.nan, 3.0]])
    np.testing.assert_array_equal(found.series["a/b"].columns["x"], [[4.0]])


def recording(messages: list[dict[str, object] | bytes], head: dict[str, str] | None = None) -> bytes:
    """A file with one sensor of a number and a vector."""
    file = io.BytesIO()
    writer = Writer(file)
    writer.start()
    if head is None or head:
        writer.add_metadata(METADATA, head or HEAD)
    number = {"type": ["number", "null"], "description": "a; unit m"}
    vector = {"type": ["array", "null"], "items": number, "maxItems": 3, "description": "b; unit m; frame N"}
    schema = {"description": "", "properties": {"value": {"properties": {"x": number, "v": vector}}}}
    number_of = writer.register_schema("a/b", "jsonschema", json.dumps(schema).encode())
    channel = writer.register_channel("a/b", "json", number_of, {"kind": "pressure", "direction": "sensor", "doc": ""})
    for message in messages:
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        writer.add_message(channel, 10, data, 10)
    writer.finish()
    return file.getvalue()


def test_a_recording_in_parts_is_read_as_one(tmp_path: Path) -> None:
    dived(tmp_path / "one.mcap", 840)
    dived(tmp_path / "run.mcap", 840, rotation=Rotation(most_s=1.0))
    parts = [tmp_path / "run.mcap", *(tmp_path / f"run.000{k}.mcap" for k in (2, 3, 4))]
    assert all(part.exists() for part in parts)
    one, whole = read_recording(tmp_path / "one.mcap"), read_recording(tmp_path / "run.mcap")
    assert set(whole.series) == set(one.series)
    for path, series in one.series.items():
        np.testing.assert_array_equal(whole.series[path].t, series.t)
        for name, column in series.columns.items():
            np.testing.assert_array_equal(whole.series[path].columns[name], column)
    np.testing.assert_array_equal(whole.poses["rov"], one.poses["rov"])
    assert (whole.end_s, whole.remarks, whole.path) == (one.end_s, (), parts[0])
    late = read_recording(parts[2])
    assert 0 < len(late.poses["rov"]) < len(one.poses["rov"])

    whole_last = parts[3].read_bytes()
    parts[3].write_bytes(whole_last[: len(whole_last) * 4 // 5])
    (remark,) = read_recording(parts[0]).remarks
    assert "The part run.0004.mcap is cut off" in remark
    parts[2].unlink()
    with pytest.raises(ValueError, match=r"its part run\.0003\.mcap is missing"):
        read_recording(parts[0])


def as_told(array: np.ndarray) -> Any:
    """As a recording holds it."""
    return msgspec.to_builtins(Buffer.of(array))


@pytest.mark.parametrize("count", [3, ACROSS, 1000])
def test_a_row_has_the_peaks_of_neighbours(count: int) -> None:
    column = Echoes(1)
    row = np.arange(count, dtype=np.float32)[::-1].copy()
    column.add(as_told(row))
    (kept,) = column.whole(1)
    assert (kept[0], kept.max()) == (count - 1, count - 1)
    assert kept[-1] == pytest.approx(0 if count <= ACROSS else count - 1 - (ACROSS - 1) * count // ACROSS)
    assert np.all(np.diff(kept) <= 0.0)


def test_complex_echoes_have_their_amplitude_and_pictures_their_strongest_beam() -> None:
    wave = np.zeros((5, 2), np.float32)
    wave[3] = 3.0, -4.0
    for dimensions, value in ((1, wave), (2, wave[:, None]), (2, np.abs(wave) * 1.25)):
        column = Echoes(dimensions)
        column.add(as_told(np.ascontiguousarray(value)))
        kept = column.whole(1)[0]
        assert np.unique(kept).tolist() == [0.0, 5.0]
        assert int(kept.argmax()) == -(-3 * ACROSS // 5)


def test_only_echoes_of_sonars_and_numbers_have_columns() -> None:
    fields = {
        "range": Field("range", "m", ""),
        "image": Field("image", "1", "", type="bytes"),
        "azimuth": Field("azimuth", "rad", "", type="bytes"),
        "name": Field("name", "1", "", type="str"),
    }
    assert [name for name, _ in columns_of("SonarImage", fields)] == ["range", "image"]
    assert [name for name, _ in columns_of("Image", fields)] == ["range"]


@pytest.mark.parametrize(
    "value", [{"base64": "AAAA"}, {"dtype": "uint8", "shape": [4], "base64": "AA=="}, 7, [1, 2], "x"]
)
def test_echoes_that_are_none_are_refused(value: Any) -> None:
    """Neither plain bytes of an image, nor fewer bytes than a shape asks for, nor what is no buffer; nothing of them is kept."""
    column = Echoes(2)
    with pytest.raises((ValueError, TypeError, msgspec.MsgspecError)):
        column.add(value)
    assert not column.numbers
    column.add(None)
    assert np.isnan(column.whole(1)).all()
