"""Video: cost of a picture in each encoding, and whether a video stream delays the ticks of a world."""

from __future__ import annotations

import importlib.util
import socket
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from uwserver.adapter.pictures import can_encode_jpeg, jpeg
from uwserver.simulation.clock import SystemTime
from uwserver_bench.processes import BenchFailed, Served, processor_s, serving
from uwserver_bench.report import Row
from uwserver_bench.server import STATUS
from uwserver_bench.swarm.swarm_scenario import SERVED

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30
H264_BAR_MS, JPEG_BAR_MS, LATENESS_BAR_MS = 6.0, 2.0, 1.0
_MISSING = "pip install 'uwserver[video]'"
_KINDS = 16

CAMERA = f'''
"""A camera without a world: pictures that move, made once."""

import numpy as np

from uwserver.ports import Buffer, Field, Layout
from uwserver.sensors import IdealSensor, SensorTable

from uwserver_bench.web.video import pictures


class StillConfig(SensorTable, tag="still", kw_only=True, frozen=True):
    """Has no keys."""

    def build(self, mount):
        return Still()


class Still(IdealSensor):
    doc = "Pictures that move."
    fields = (Field("image", "1", "picture", type="buffer", buffer=Layout("uint8", ({HEIGHT}, {WIDTH}, 3))),)

    def __init__(self):
        self.shown = [Buffer.of(shown) for shown in pictures()]

    def measure(self, scope):
        return True, [self.shown[int(scope.t_ns * {RATE_HZ} // 1_000_000_000) % {_KINDS}]]


SENSORS = (StillConfig,)
'''

SCENARIO = f"""
schema = 1
extensions = ["still.py"]
[world]
rate_hz = 240
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 5.0]
[vehicles.rov.sensors.camera]
kind = "still"
rate_hz = {RATE_HZ}
"""

_ADAPTER = """
[adapters.video]
kind = "video"
rtsp = false
[adapters.video.streams.front]
port = "rov/camera"
rtp = "127.0.0.1:{port}"
"""


def pictures() -> list[NDArray[np.uint8]]:
    """Return moving pictures with the haze, blobs and grain of a view under water."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    found = []
    for k in range(_KINDS):
        veil = 90 + 60 * y / HEIGHT + 20 * np.sin((x + 8 * k) / 37.0) * np.cos((y - 5 * k) / 29.0)
        grain = rng.normal(0.0, 3.0, (HEIGHT, WIDTH))
        colours = np.stack([0.4 * veil, veil, 1.1 * veil], axis=2) + grain[:, :, None]
        found.append(colours.clip(0, 255).astype(np.uint8))
    return found


def bench_video(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on video.

    Args:
        quick: short repeats.
        say: gets a line of progress.

    Raises:
        BenchFailed: a process did not work as expected.
    """
    repeats, count, seconds = (1, 30, 2.0) if quick else (5, 200, 8.0)
    has_h264 = importlib.util.find_spec("av") is not None
    shown = pictures()
    say("video: encoders")
    rows = [_h264(shown, repeats, count, has_h264), _jpeg(shown, repeats, count)]
    alone, beside, shares = [], [], []
    for repeat in range(repeats if has_h264 else 0):
        say(f"video: a stream beside a world, {repeat + 1} of {repeats}")
        late, share = _served(seconds, "")
        alone.append(late)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.bind(("127.0.0.1", 0))
            late, busy = _served(seconds, _ADAPTER.format(port=receiver.getsockname()[1]))
        beside.append(late)
        shares.append(max(0.0, busy - share))
    note = "" if has_h264 else _MISSING
    title = f"{WIDTH} x {HEIGHT} at {RATE_HZ}/s in H.264 beside a vehicle at 240 Hz"
    return [
        *rows,
        Row("video", f"{title}: added share of a core", "cores", tuple(shares), note=note),
        Row("video", f"{title}: tick lateness p99", "ms", tuple(beside), at_most=LATENESS_BAR_MS, note=note),
        Row("video", "the same without the stream: tick lateness p99", "ms", tuple(alone), note=note),
    ]


def _h264(shown: list[NDArray[np.uint8]], repeats: int, count: int, is_there: bool) -> Row:
    title = f"H.264 of a picture of {WIDTH} x {HEIGHT}, with its packets: processor time"
    if not is_there:
        return Row("video", title, "ms", (), at_most=H264_BAR_MS, note=_MISSING)
    from uwserver_adapters.video.encoder import H264Encoder

    values = []
    for _ in range(repeats):
        encoder = H264Encoder(RATE_HZ, 4_000_000, "ultrafast")
        encoder.encode(shown[0], True)
        values.append(_cost_ms(lambda k, encoder=encoder: encoder.encode(shown[k % _KINDS], False), count))  # type: ignore[misc]  # bound now
    return Row("video", title, "ms", tuple(values), at_most=H264_BAR_MS)


def _jpeg(shown: list[NDArray[np.uint8]], repeats: int, count: int) -> Row:
    title = f"JPEG of a picture of {WIDTH} x {HEIGHT}: processor time"
    if not can_encode_jpeg():
        return Row("video", title, "ms", (), at_most=JPEG_BAR_MS, note="pip install 'uwserver[pictures]'")
    values = tuple(_cost_ms(lambda k: jpeg(shown[k % _KINDS]), count) for _ in range(repeats))
    return Row("video", title, "ms", values, at_most=JPEG_BAR_MS)


def _cost_ms(encode: Callable[[int], object], count: int) -> float:
    began = time.process_time()
    for k in range(count):
        encode(k)
    return (time.process_time() - began) / count * 1e3


def _served(seconds: float, adapter: str) -> tuple[float, float]:
    """Return the p99 of the lateness in ms, and the number of cores that the server uses."""
    clock = SystemTime()
    with tempfile.TemporaryDirectory(prefix="uwserver-bench-") as folder:
        Path(folder, "still.py").write_text(CAMERA, encoding="utf-8")
        file = Path(folder, "video.toml")
        file.write_text(SCENARIO + SERVED + adapter, encoding="utf-8")
        with serving(file) as served:
            clock.wait(1.0, Event())
            before, since = processor_s(served.pid), clock.now_ns()
            clock.wait(seconds, Event())
            after, wall_ns = processor_s(served.pid), clock.now_ns() - since
            if before is None or after is None:
                raise BenchFailed("this system does not tell what a process spends: video cannot be measured here")
            _check(served, bool(adapter))
            late_ms = float(served.ask(STATUS)["value"]["lateness"]["p99_s"]) * 1e3
    return late_ms, (after - before) / (wall_ns * 1e-9)


def _check(served: Served, is_streaming: bool) -> None:
    adapters = served.ask(STATUS)["value"]["adapters"]
    if is_streaming and not adapters.get("video", {}).get("encoded"):
        raise BenchFailed(f"no picture was encoded: {adapters.get('video', 'no adapter `video` is installed')}")
