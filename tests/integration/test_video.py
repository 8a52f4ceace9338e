"""Video as players take it: GStreamer and FFmpeg decode what the adapter sends, and the pictures are those that were sent."""

from __future__ import annotations

import asyncio
import shutil
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from uwserver_adapters.video.config import StreamTable
from video_rig import HEIGHT, PATIENCE_S, WIDTH, filming, number_of, picture, psnr, serving

av = pytest.importorskip("av", reason="PyAV is not installed")

GSTREAMER = shutil.which("gst-launch-1.0")
PICTURES = 30
ALIKE_DB = 30.0
"""Of H.264 at this size and these bits; another picture of the series has less than 25."""


def are_those_that_were_sent(found: list[NDArray[np.uint8]]) -> None:
    assert len(found) >= PICTURES // 2
    numbers = [number_of(shown) for shown in found]
    assert numbers == sorted(set(numbers)), numbers
    for number, shown in zip(numbers, found, strict=True):
        assert shown.shape == (HEIGHT, WIDTH, 3)
        assert psnr(shown, picture(number)) > ALIKE_DB, (number, psnr(shown, picture(number)))


def by_ffmpeg(url: str, **options: str) -> list[NDArray[np.uint8]]:
    found = []
    with av.open(url, options={"timeout": "20000000", "analyzeduration": "500000", **options}, timeout=30) as container:
        for frame in container.decode(video=0):
            found.append(frame.to_ndarray(format="rgb24"))
            if len(found) == PICTURES:
                break
    return found


async def by_gstreamer(tmp_path: Path, *source: str) -> list[NDArray[np.uint8]]:
    """Frames as raw RGB; it ends by itself after some."""
    if GSTREAMER is None:
        pytest.skip("gst-launch-1.0 is not installed (Debian: gstreamer1.0-tools, -plugins-good, -plugins-bad, -libav)")
    out = tmp_path / "frames.rgb"
    process = await asyncio.create_subprocess_exec(
        GSTREAMER, "-q", *source, "!", "videoconvert", "!", "video/x-raw,format=RGB", "!", "identity", f"eos-after={PICTURES}",
        "!", "filesink", f"location={out}", stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        _, told = await asyncio.wait_for(process.communicate(), PATIENCE_S)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode == 0, told.decode()
    data = np.fromfile(out, np.uint8)
    return list(data[: len(data) // (HEIGHT * WIDTH * 3) * HEIGHT * WIDTH * 3].reshape(-1, HEIGHT, WIDTH, 3))


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize("codec", ["h264", "jpeg"])
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_ffmpeg_by_rtsp(transport: str, codec: Any) -> None:
    async def whole() -> None:
        async with serving(streams={"front": StreamTable(port="rov/camera", codec=codec)}) as fake, filming(fake):
            url = f"{fake.stats.address}front"
            are_those_that_were_sent(await asyncio.to_thread(by_ffmpeg, url, rtsp_transport=transport))

    asyncio.run(asyncio.wait_for(whole(), 2 * PATIENCE_S))


@pytest.mark.parametrize("codec", ["h264", "jpeg"])
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_gstreamer_by_rtsp(transport: str, codec: Any, tmp_path: Path) -> None:
    async def whole() -> None:
        async with serving(codec=codec) as fake, filming(fake):
            url = f"{fake.stats.address}rov/camera"
            source = ["rtspsrc", f"location={url}", f"protocols={transport}", "latency=0", "!"]
            chain = ["rtph264depay", "!", "avdec_h264"] if codec == "h264" else ["rtpjpegdepay", "!", "jpegdec"]
            are_those_that_were_sent(await by_gstreamer(tmp_path, *source, *chain))

    asyncio.run(asyncio.wait_for(whole(), 2 * PATIENCE_S))


def test_the_chain_of_qgroundcontrol(tmp_path: Path) -> None:
    """A receiver that nobody told anything but the port, and that comes later than the stream."""
    port = free_port()

    async def whole() -> None:
        streams = {"front": StreamTable(port="rov/camera", rtp=f"127.0.0.1:{port}")}
        async with serving(streams=streams, rtsp=False) as fake, filming(fake):
            await asyncio.sleep(0.5)
            caps = "application/x-rtp,media=(string)video,clock-rate=(int)90000,encoding-name=(string)H264"
            source = ["udpsrc", f"port={port}", f"caps={caps}", "!", "rtpjitterbuffer", "latency=0", "!"]
            chain = ["rtph264depay", "!", "h264parse", "!", "avdec_h264"]
            are_those_that_were_sent(await by_gstreamer(tmp_path, *source, *chain))

    asyncio.run(asyncio.wait_for(whole(), 2 * PATIENCE_S))
