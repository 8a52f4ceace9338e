"""Pictures to clients: one JPEG each, for those alone who take it, and on a thread where they can wait."""

from __future__ import annotations

import asyncio
import itertools
import threading

import numpy as np
import pytest
from uwserver_adapters.native import fanout

from uwserver.ports import Buffer, Field, Layout, Port, Sample

NUMBERS = tuple(f"f{k}" for k in range(6))
CAMERA = Port(
    "rov/camera",
    "sensor",
    "camera",
    (*(Field(name, "1", "x") for name in NUMBERS), Field("image", "1", "x", type="buffer", buffer=Layout("uint8", (-1, -1, 3)))),
    "Camera.",
    rate_hz=10.0,
)  # fmt: skip
SHOT = Sample(CAMERA.path, 0, 1, 1, True, (*[1.0] * 6, Buffer.of(np.zeros((48, 64, 3), np.uint8))))


@pytest.fixture
def encoders(monkeypatch):
    """Threads that encoded a picture, one entry each time."""
    found: list[threading.Thread] = []
    real = fanout.with_jpeg

    def noted(port: Port, sample: Sample) -> Sample:
        found.append(threading.current_thread())
        return real(port, sample)

    monkeypatch.setattr(fanout, "with_jpeg", noted)
    return found


async def told(theatre, talker, count: int) -> None:
    theatre.context.put([SHOT])
    for _ in range(6000):
        if theatre.context.stats.encoded >= count:
            break
        await asyncio.sleep(0.01)
    await asyncio.sleep(0.05)


@pytest.mark.parametrize(("more", "pictures"), [((), 0), (("image",), 1)])
def test_a_picture_is_encoded_once_and_only_for_who_takes_it(stage, encoders, more, pictures):
    """Each of 60 selections of fields, none with the picture, had a JPEG of its own made on the loop: 73 ms for one picture."""
    pytest.importorskip("simplejpeg")

    async def scene() -> None:
        theatre = stage()
        theatre.context.set_ports([CAMERA])
        talker = theatre.talker()
        chosen = [fields for size in (1, 2, 3) for fields in itertools.combinations(NUMBERS, size)][:20]
        for fields in chosen:
            await talker.result("subscribe", {"pattern": CAMERA.path, "fields": [*fields, *more], "pictures": "jpeg"})
        await told(theatre, talker, len(chosen))
        assert theatre.context.stats.encoded == len(chosen)
        assert len(encoders) == pictures
        assert threading.current_thread() not in encoders

    asyncio.run(scene())
