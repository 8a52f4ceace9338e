"""Pictures of a log as MP4, decoded again."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from video_rig import CAMERA, DEPTH, HEIGHT, STEP_NS, WIDTH, camera, number_of, picture, psnr, sample

from uwserver.adapter.foxglove import codec
from uwserver.adapter.foxglove.channels import Foreign
from uwserver.adapter.pictures import jpeg
from uwserver.cli.recordings.export import export
from uwserver.logfiles.export import video
from uwserver.ports import Sample
from uwserver.recording.writer import RecordingWriter

av = pytest.importorskip("av", reason="PyAV is not installed")
BACK = camera("rov/back", "uint8", (-1, -1))


class Viewers:
    """What is written for other viewers: the same pictures in JPEG."""

    def of(self, told: object, port: Any = None) -> Iterator[Foreign]:
        if isinstance(told, Sample) and told.valid and port is not DEPTH:
            data = codec.compressed_image(told.t_ns, port.path, jpeg(told.value[1].array()))  # type: ignore[union-attr]  # a buffer
            yield Foreign(f"/{port.path}", "foxglove.CompressedImage", told.t_sent_ns, data)


def recording(path: Path, samples: list[Sample]) -> Path:
    ports = {port.path: port for port in (CAMERA, BACK, DEPTH)}
    with path.open("wb") as file:
        writer = RecordingWriter(file, {"scenario": "{}"}, ports, Viewers())  # type: ignore[arg-type]  # as much of it as is used
        for told in samples:
            writer.sample(told, ports)
        writer.finish()
    return path


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    nothing = Sample(CAMERA.path, 0, 0, 0, False, (None, None))
    shots = [sample(number) for number in (1, 2, 3, 10, 11)]
    grey = [sample(number, BACK.path, np.full((30, 41), 100, np.uint8)) for number in (1, 2)]
    depth = [Sample(DEPTH.path, 0, 0, 0, True, (1.0,))]
    return recording(tmp_path / "dive.mcap", [nothing, *depth, *shots, *grey])


def run(*args: object) -> Any:
    return CliRunner().invoke(export, [str(arg) for arg in args])


def decoded(path: Path) -> list[tuple[float, np.ndarray[Any, Any]]]:
    with av.open(str(path)) as container:
        return [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]


@pytest.mark.parametrize("topic", ["rov/camera", "/rov/camera"], ids=["ours", "compressed"])
def test_each_picture_is_there_at_its_time(dive: Path, topic: str) -> None:
    result = run(dive, "--to", "mp4", "--topics", topic)
    assert result.exit_code == 0, result.output
    assert f"5 pictures of {topic}, {WIDTH} x {HEIGHT}" in result.output
    found = decoded(dive.with_suffix(".mp4"))
    assert [number_of(shown) for _, shown in found] == [1, 2, 3, 10, 11]
    assert [round(t * 1e9 / STEP_NS) for t, _ in found] == [0, 1, 2, 9, 10]
    for (_, shown), number in zip(found, (1, 2, 3, 10, 11), strict=True):
        assert psnr(shown, picture(number)) > 30.0


def test_grey_pictures_with_an_odd_side(dive: Path) -> None:
    assert run(dive, "--to", "mp4", "--topics", "rov/back").exit_code == 0
    (_, shown), _ = decoded(dive.with_suffix(".mp4"))
    assert shown.shape == (30, 40, 3)
    assert np.abs(shown.astype(int) - 100).max() <= 4


def test_one_topic_is_to_be_chosen(dive: Path) -> None:
    result = run(dive, "--to", "mp4")
    assert result.exit_code == 1
    assert "choose one by --topics: rov/camera, rov/back" in result.output
    result = run(dive, "--to", "mp4", "--topics", "rov/depth")
    assert result.exit_code == 1
    assert "none of these topics contains pictures: rov/depth" in result.output
    assert list(dive.parent.iterdir()) == [dive]


def test_a_picture_of_another_size_is_stretched_and_told(tmp_path: Path) -> None:
    path = recording(tmp_path / "dive.mcap", [sample(1), sample(2, shown=picture(2, 320, 240))])
    result = run(path, "--to", "mp4", "-o", tmp_path / "made.mp4")
    assert "1 of them had another size and were stretched" in result.output
    assert [shown.shape for _, shown in decoded(tmp_path / "made.mp4")] == [(HEIGHT, WIDTH, 3)] * 2


def blank_png(side: int) -> bytes:
    """Black, of so many pixels each way: some kilobytes for hundreds of megabytes."""

    def part(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    body = zlib.compress(bytes((3 * side + 1) * side))
    head = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", body) + part(b"IEND", b"")


def test_a_compressed_picture_that_would_be_too_large_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "MOST_PIXELS", 64 * 64)
    photo = jpeg(np.zeros((72, 80, 3), np.uint8))
    for data in (blank_png(65), photo):
        assert video._picture_of({"format": "x", "data": data}, av) is None
    shown = video._picture_of({"format": "png", "data": blank_png(64)}, av)
    assert shown is not None
    assert shown.shape == (64, 64, 3)
