"""Video as players take it: GStreamer and FFmpeg decode what the adapter sends, and the pictures are those that were sent."""

from __future__ import annotations

import asyncio
import contextlib
import re
import shlex
import shutil
import socket
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from server_process import Peer
from server_process import serving as serving_process
from uwserver_adapters.video.config import StreamTable, VideoConfig
from video_rig import HEIGHT, PATIENCE_S, WIDTH, filming, number_of, picture, psnr, serving

av = pytest.importorskip("av", reason="PyAV is not installed")

ROOT = Path(__file__).parents[2]
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


@pytest.mark.parametrize("source", ["rtspsrc", "udpsrc"])
def test_the_commands_of_the_page_show_what_its_table_serves(source: str) -> None:
    if GSTREAMER is None:
        pytest.skip("gst-launch-1.0 is not installed")
    page = (ROOT / "docs/how-to/video.md").read_text()
    _, table = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (line,) = [line for line in page.splitlines() if line.startswith(f"gst-launch-1.0 {source} ")]
    port = free_port()
    given = msgspec.toml.decode(table.replace(":5600", f":{port}").replace(":14550", f":{free_port()}"))["adapters"][
        "video"
    ]
    config = msgspec.convert({**given, "rtsp_port": 0}, VideoConfig)
    assert config.mavlink
    assert config.streams

    async def whole() -> None:
        fields = {name: getattr(config, name) for name in config.__struct_fields__}
        async with serving(**fields) as fake, filming(fake):
            words = line.replace("rtsp://127.0.0.1:8554/", fake.stats.address).replace("port=5600", f"port={port}")
            words = re.sub("autovideosink.*", f"fakesink num-buffers={PICTURES}", words)
            process = await asyncio.create_subprocess_exec(*shlex.split(words), stdout=asyncio.subprocess.DEVNULL)
            try:
                assert await asyncio.wait_for(process.wait(), PATIENCE_S) == 0
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()

    asyncio.run(asyncio.wait_for(whole(), 2 * PATIENCE_S))


CAMERA = '''
"""A camera whose pictures count the samples."""
import sys
sys.path.insert(0, {tests!r})
from video_rig import picture
from uwserver.ports import Buffer, Field, Layout
from uwserver.sensors import IdealSensor, SensorTable


class CountingConfig(SensorTable, tag="counting", kw_only=True, frozen=True):
    """Has no keys."""

    def build(self, mount):
        return Counting()


class Counting(IdealSensor):
    doc = "Counts."
    fields = (Field("image", "1", "picture", type="buffer", buffer=Layout("uint8", (-1, -1, 3))),)

    def measure(self, scope):
        return True, [Buffer.of(picture(round(scope.t_ns * 20e-9)))]


SENSORS = (CountingConfig,)
'''
SCENARIO = """
schema = 1
extensions = ["counting.py"]
[vehicles.rov]
model = "bluerov2"
[vehicles.rov.sensors.camera]
kind = "counting"
rate_hz = 20
[adapters.tcp]
kind = "sockets"
port = 0
[adapters.video]
kind = "video"
rtsp_port = 0
[adapters.web]
kind = "web"
port = 0
"""


def test_a_world_s_camera_from_the_server_to_the_player(tmp_path: Path) -> None:
    (tmp_path / "counting.py").write_text(CAMERA.format(tests=str(Path(__file__).parents[1])))
    (tmp_path / "camera.toml").write_text(SCENARIO)
    with serving_process(tmp_path / "camera.toml") as (address, _), contextlib.closing(Peer(address)) as peer:
        adapter = peer.call("world/status")["result"]["value"]["adapters"]["video"]
        assert adapter["details"]["streams"]["rov/camera"]["encoded"] == 0
        found = by_ffmpeg(f"{adapter['address']}rov/camera", rtsp_transport="tcp")
        are_those_that_were_sent(found)
        adapter = peer.call("world/status")["result"]["value"]["adapters"]["video"]
        assert adapter["encoded"] >= PICTURES
        assert adapter["errors"] == 0
