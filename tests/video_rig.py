"""A camera whose pictures tell their number, the adapter `video` over it, and how alike two pictures are."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from uwserver_adapters.video import VideoAdapter
from uwserver_adapters.video.config import VideoConfig

from uwserver.ports import Buffer, Field, Layout, Port, Sample
from uwserver.testing import FakeContext

PATIENCE_S = 60.0
RATE_HZ = 25.0
STEP_NS = 40_000_000
WIDTH, HEIGHT = 160, 120
_BLOCK, _BITS = 8, 12


def camera(path: str = "rov/camera", dtype: Any = "uint8", shape: tuple[int, ...] = (-1, -1, 3)) -> Port:
    """A port with pictures."""
    image = Field("image", "1", "what it sees", type="buffer", buffer=Layout(dtype, shape))
    return Port(path, "sensor", "camera", (Field("exposure", "s", "of the picture"), image), "Camera.", rate_hz=RATE_HZ)


CAMERA = camera()
DEPTH = Port("rov/depth", "sensor", "pressure", (Field("depth", "m", "depth"),), "Depth.", rate_hz=25.0)


def picture(number: int, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    """A smooth picture with a square that moves, and its number in blocks of black and white at the top."""
    y, x = np.mgrid[0:height, 0:width]
    shown = np.stack([x * 255 // width, y * 255 // height, np.full_like(x, 90)], axis=2).astype(np.uint8)
    at = 10 + number * 3 % (width - 40)
    shown[height // 2 : height // 2 + 20, at : at + 20] = (250, 240, 30)
    for bit in range(_BITS):
        shown[:_BLOCK, bit * _BLOCK : (bit + 1) * _BLOCK] = 235 if number >> bit & 1 else 16
    return shown


def number_of(shown: NDArray[np.uint8]) -> int:
    """Number of a picture that was decoded."""
    blocks = shown[2:6, : _BITS * _BLOCK].mean(axis=(0, 2)).reshape(_BITS, _BLOCK)[:, 2:6].mean(axis=1)
    return sum(1 << bit for bit in range(_BITS) if blocks[bit] > 127)


def psnr(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio of two pictures, dB."""
    error = float(np.mean((one.astype(float) - other.astype(float)) ** 2))
    return math.inf if error == 0.0 else 10.0 * math.log10(255.0**2 / error)


def sample(number: int, path: str = CAMERA.path, shown: NDArray[Any] | None = None) -> Sample:
    """A sample with a picture."""
    t_ns = number * STEP_NS
    return Sample(path, number, t_ns, t_ns, True, (0.01, Buffer.of(picture(number) if shown is None else shown)))


def context(*ports: Port) -> FakeContext:
    """A world with these ports; default: a camera and a depth sensor."""
    return FakeContext(ports={port.path: port for port in ports or (CAMERA, DEPTH)})


@asynccontextmanager
async def serving(fake: FakeContext | None = None, **config: Any) -> AsyncIterator[FakeContext]:
    """The adapter, ready; port 0 unless told."""
    fake = fake or context()
    ready = asyncio.Event()
    config.setdefault("rtsp_port", 0)
    task = asyncio.ensure_future(VideoAdapter(VideoConfig(**config), fake).run(ready))
    try:
        waiting = asyncio.ensure_future(ready.wait())
        await asyncio.wait([task, waiting], timeout=PATIENCE_S, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            waiting.cancel()
            task.result()
        yield fake
        assert not task.done()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@asynccontextmanager
async def filming(fake: FakeContext, path: str = CAMERA.path) -> AsyncIterator[None]:
    """Pictures one after the other, in wall time."""

    async def run() -> None:
        for number in range(1 << _BITS):
            fake.put([sample(number, path)])
            await asyncio.sleep(1.0 / RATE_HZ)

    task = asyncio.ensure_future(run())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
