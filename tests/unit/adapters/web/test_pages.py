"""States, status, events and pictures: what pages get, and what it costs while there is none, or one that does not read."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import socket
import struct
import threading
from typing import Any

import numpy as np
import pytest
from uwserver_adapters.web import pictures
from uwserver_adapters.web.connection import WebConnection
from web_rig import Stage, ask, code_of, play, state_of
from websockets.exceptions import ConnectionClosed

from uwserver.ports import Buffer, Event, Field, Layout, Port, Sample
from uwserver.testing import FakeContext, sample_of

SONAR = Port(
    "rov/sonar", "sensor", "scanning_sonar",
    (Field("head_angle", "rad", "x"), Field("range", "m", "x"), Field("gain", "dB", "x"),
     Field("intensities", "1", "x", type="buffer", buffer=Layout("uint8", (4,)))),
    "Sonar.", rate_hz=10.0,
)  # fmt: skip


async def frame_of(page: Any) -> bytes:
    """The next binary message."""

    async def heard() -> bytes:
        async for message in page:
            if isinstance(message, bytes):
                return message
        raise AssertionError("the view left")

    return await asyncio.wait_for(heard(), 60.0)


def test_a_state_is_what_the_bytes_say() -> None:
    async def scene(stage: Stage) -> None:
        stage.context.scene_state = state_of(7_000_000_000)
        async with stage.page() as page:
            assert (await ask(page, "view", frames=True))["result"]["frames"] is True
            frame = await frame_of(page)
        assert struct.unpack_from("<BBHIq", frame) == (1, 0, 3, 3, 7_000_000_000)
        numbers = np.frombuffer(frame, "<f4", 21, 16).reshape(3, 7)
        assert (numbers == stage.context.scene_state.poses).all()
        assert frame[16 + 84 :] == struct.pack("<H3b", 3, -127, 0, 127)

    play(scene)


def test_a_view_that_hides_poses_tells_none() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await ask(page, "view", frames=True)
            assert await frame_of(page) == struct.pack("<BBHIqH", 1, 2, 0, 3, 0, 0)

    play(scene, exact_poses=False)


def test_nothing_is_looked_at_while_no_page_draws() -> None:
    async def scene(stage: Stage) -> None:
        await asyncio.sleep(0.2)
        assert stage.adapter._front is None, "nothing is even loaded"
        async with stage.page() as page:
            assert (await ask(page, "ping"))["result"] == {}
            await asyncio.sleep(0.2)
            assert stage.context.scene_requests == 0
            await ask(page, "view", frames=True)
            await frame_of(page)
            await ask(page, "view", frames=False)
            asked = stage.context.scene_requests
            await asyncio.sleep(0.3)
            assert stage.context.scene_requests <= asked + 1
        assert stage.context.subscriptions == frozenset()

    play(scene)


def test_a_state_is_looked_up_once_for_all_pages() -> None:
    async def scene(stage: Stage) -> None:
        pages = [await stage.page() for _ in range(5)]
        for page in pages:
            await ask(page, "view", frames=True)
        before = stage.context.scene_requests
        for n in range(6):
            stage.context.scene_state = state_of(n + 1)
            frames = [await frame_of(page) for page in pages]
            assert len({id(frame) for frame in frames}) == 5
        assert stage.context.scene_requests - before < 5 * 6
        for page in pages:
            await page.close()

    play(scene, frames_hz=20.0)


def test_while_nothing_changes_a_state_comes_twice_a_second() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await ask(page, "view", frames=True)
            await frame_of(page)
            asked = stage.context.scene_requests
            await frame_of(page)
            assert stage.context.scene_requests - asked >= 5, "it goes on to ask, but says the same only now and then"

    play(scene, frames_hz=60.0)


def test_who_does_not_read_gets_no_more_and_the_others_go_on() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as deaf, stage.page() as page:
            for each in (deaf, page):
                await ask(each, "view", frames=True)
            deaf.transport.pause_reading()
            (slow,) = [c for c in stage.adapter.peers if isinstance(c, WebConnection) and c.serial == 1]
            kernel = slow.transport.get_extra_info("socket")
            assert kernel.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) <= 4 << 16
            state = state_of()
            big = state._replace(poses=np.zeros((3000, 7)))
            for n in range(60):
                stage.context.scene_state = big._replace(t_ns=n + 1)
                assert len(await frame_of(page)) > 80_000
            assert slow.waiting <= 100_000, "at most one state waits in this process"
            assert not slow.is_clear
            deaf.transport.abort()  # else its end would wait for what it does not read

    play(scene, frames_hz=120.0)


def test_the_status_comes_twice_a_second_and_says_who_steers() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await ask(page, "hello", version=1, name="helm")
            await ask(page, "call", service="web/lease/take", args={"vehicle": "rov"})
            async for message in page:
                told = json.loads(message)
                if told.get("method") == "status":
                    break
        status = told["params"]
        assert status["lease"] == {"rov": {"page": 1, "owner": "helm"}, "auv": None}
        assert (status["pages"], status["paused"], status["t"]) == (1, False, 1.5)

    play(scene)


def test_events_reach_pages() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await ask(page, "ping")
            stage.context.say(Event("reset", 5, 20, "back to the start"))
            async for message in page:
                told = json.loads(message)
                if told.get("method") == "event":
                    break
            assert told["params"]["event"] == "reset"

    play(scene)


def test_the_status_tells_what_is_recorded() -> None:
    recorder = {"path": "/data/dive.mcap", "recording": True, "since_ns": 2_500_000_000, "bytes": 70, "error": ""}

    async def scene(stage: Stage) -> None:
        for now, is_recording in ((recorder, True), ({**recorder, "recording": False}, False)):
            stage.context.scripts["world/status"] = lambda args, now=now: {"recorder": now}
            async with stage.page() as page:
                while (told := json.loads(await asyncio.wait_for(page.recv(), 60.0))).get("method") != "status":
                    pass
            assert told["params"]["recording"] is is_recording
            assert told["params"]["recorder"] == {
                "name": "dive.mcap", "path": "/data/dive.mcap", "bytes": 70, "since_ns": 2_500_000_000, "error": "",
            }  # fmt: skip

    play(scene)


def test_a_page_that_subscribes_gets_samples_states_and_status() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await ask(page, "view", frames=True)
            await ask(page, "subscribe", pattern="rov/depth", delivery="latest")
            heard: dict[str, int] = {"frame": 0, "sample": 0, "status": 0}

            async def hear() -> None:
                while min(heard.values()) < 3:
                    message = await page.recv()
                    kind = "frame" if isinstance(message, bytes) else json.loads(message).get("method")
                    heard[kind] = heard.get(kind, 0) + 1

            async def live() -> None:
                for n in range(100_000):
                    stage.context.state = state_of(n + 1)
                    stage.context.emit("rov/depth")
                    await asyncio.sleep(0.01)

            world = asyncio.create_task(live())
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(hear(), 60.0)
            world.cancel()
            assert min(heard.values()) >= 3, heard

    play(scene)


def test_what_is_enough_of_a_port_is_said_but_not_of_pictures() -> None:
    async def scene(stage: Stage) -> None:
        assert stage.adapter.decimations == {}
        async with stage.page() as page:
            await ask(page, "subscribe", pattern="rov/*", rate_hz=1.0)
            for sample in (stage.context.emit() for _ in range(3)):
                assert sample
            assert set(stage.adapter.decimations) == {"rov/imu", "rov/sonar"}
            await ask(page, "view", pictures=["rov/sonar"])
            assert set(stage.adapter.decimations) == {"rov/imu"}

    play(scene, with_sonar())


def test_after_the_last_viewer_no_pictures_are_made() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await ask(page, "view", pictures=["rov/sonar"])
            assert stage.context.subscriptions == {"rov/sonar"}
        for _ in range(6000):
            if stage.context.subscriptions == frozenset():
                return
            await asyncio.sleep(0.01)
        raise AssertionError("the sonar is still wanted")

    play(scene, with_sonar())


def with_sonar() -> FakeContext:
    return FakeContext(scene_state=state_of(), ports={SONAR.path: SONAR, "rov/imu": FakeContext().ports["rov/imu"]})


def ping(seq: int) -> Sample:
    row = Buffer(dtype="uint8", shape=(4,), data=bytes((seq, 1, 2, 3)))
    return Sample(SONAR.path, seq, 1000 + seq, 2000 + seq, True, (0.5, 30.0, 0.0, row))


def test_what_is_subscribed_of_the_same_tick_is_no_reason_to_leave_a_picture_out() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            number = (await ask(page, "view", pictures=["rov/sonar"]))["result"]["pictures"]["rov/sonar"]
            await ask(page, "subscribe", pattern="rov/imu")
            imu = sample_of(stage.context.ports["rov/imu"])
            stage.context.put([imu, ping(3)])
            frame = await frame_of(page)
            assert struct.unpack_from("<BBH", frame) == (2, 3, number)

    play(scene, with_sonar())


def test_a_row_of_sonar_comes_as_bytes_and_the_next_one_when_it_was_seen() -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            number = (await ask(page, "view", pictures=["rov/sonar"]))["result"]["pictures"]["rov/sonar"]
            assert stage.context.subscriptions == {"rov/sonar"}
            for seq in range(5):
                stage.context.put([ping(seq)])
            frame = await frame_of(page)
            assert struct.unpack_from("<BBHHHq", frame) == (2, 3, number, 4, 1, 1000)
            assert struct.unpack_from("<ff4B", frame, 16) == (0.5, 30.0, 0, 1, 2, 3)
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(frame_of(page), 0.3)
            assert "result" in await ask(page, "seen", pictures=[number])
            stage.context.put([ping(9)])
            assert (await frame_of(page))[24] == 9, "what came meanwhile is not sent late"
            await ask(page, "view", pictures=[])
            assert stage.context.subscriptions == frozenset()

    play(scene, with_sonar())


def camera(dtype: Any = "uint8", shape: tuple[int, ...] = (-1, -1, 3), *more: Field) -> Port:
    table = Field("table", "1", "x", type="buffer", buffer=Layout("float32", (-1,)))
    image = Field("image", "1", "x", type="buffer", buffer=Layout(dtype, shape))
    return Port("rov/camera", "sensor", "camera", (table, image, *more), "Camera.", rate_hz=10.0)


def shot(array: np.ndarray[Any, Any], *more: float) -> Sample:
    return Sample("rov/camera", 0, 1000, 2000, True, (Buffer.of(np.zeros(3, np.float32)), Buffer.of(array), *more))


def seen_of(port: Port, sample: Sample) -> tuple[tuple[int, ...], bytes]:
    """Head and data of the frame in which a page gets a sample."""
    found: list[bytes] = []

    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            await ask(page, "view", pictures=[port.path])
            stage.context.put([sample])
            found.append(await frame_of(page))

    play(scene, FakeContext(scene_state=state_of(), ports={port.path: port}))
    return struct.unpack_from("<BBHHHq", found[0]), found[0][16:]


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_pictures_of_cameras_come_as_jpeg(dtype: Any) -> None:
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    shape = (30, 40, 3) if dtype == "uint8" else (30, 40)
    port = camera(dtype, (-1, -1, 3) if dtype == "uint8" else (-1, -1))
    head, data = seen_of(port, shot(np.full(shape, 100 if dtype == "uint8" else 10_000, dtype)))
    assert head == (2, 1, 0, 40, 30, 1000)
    shown = np.asarray(image.open(io.BytesIO(data))).astype(int)
    assert shown.shape[:2] == (30, 40)
    assert np.abs(shown - (100 if dtype == "uint8" else 128)).max() <= 2


def test_numbers_of_a_sonar_and_pictures_without_a_library_come_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    echoes = np.arange(12, dtype=np.uint8).reshape(3, 4)
    port = camera("uint8", (-1, -1), Field("range", "m", "x"))
    assert seen_of(port, shot(echoes, 30.0)) == ((2, 0, 0, 4, 3, 1000), echoes.tobytes())
    monkeypatch.setattr(pictures, "can_encode_jpeg", lambda: False)
    colours = np.arange(36, dtype=np.uint8).reshape(3, 4, 3)
    assert seen_of(camera(), shot(colours)) == ((2, 0, 0, 4, 3, 1000), colours.tobytes())


def test_one_picture_of_a_port_is_in_work_and_those_who_wait_share_it(monkeypatch: pytest.MonkeyPatch) -> None:
    go_on, made = threading.Event(), []

    def slow(port: Port, sample: Sample, number: int) -> bytes:
        assert go_on.wait(60.0)
        made.append(sample.seq)
        return bytes(16)

    monkeypatch.setattr(pictures, "jpeg_frame", slow)

    async def scene(stage: Stage) -> None:
        async with stage.page() as one, stage.page() as other:
            for page in (one, other):
                await ask(page, "view", pictures=["rov/camera"])
            for _ in range(5):
                stage.context.put([shot(np.zeros((4, 4, 3), np.uint8))])
            await ask(one, "ping")
            go_on.set()
            for page in (one, other):
                assert await frame_of(page) == bytes(16)
            assert made == [0]

    play(scene, FakeContext(scene_state=state_of(), ports={"rov/camera": camera()}))


@pytest.mark.parametrize(
    ("params", "code"),
    [({"pictures": ["rov/nothing"]}, "unknown_port"), ({"pictures": ["rov/imu"]}, "bad_argument"), ({"pictures": "rov/sonar"}, "bad_argument"),
     ({"pictures": [7]}, "bad_argument"), ({"frames": 1}, "bad_argument"), ({"pictures": ["rov/sonar"] * 33}, "too_large"),
     ({"frame": True}, "bad_argument")],
)  # fmt: skip
def test_a_view_that_cannot_be_is_refused(params: dict[str, Any], code: str) -> None:
    async def scene(stage: Stage) -> None:
        async with stage.page() as page:
            assert code_of(await ask(page, "view", **params)) == code
            assert code_of(await ask(page, "seen", pictures=["x"])) == "bad_argument"

    play(scene, with_sonar())


def test_more_pages_than_there_is_room_for_are_told() -> None:
    async def scene(stage: Stage) -> None:
        pages = [await stage.page() for _ in range(3)]
        for page in pages[:2]:
            await ask(page, "ping")
        await pages[2].send('{"method":"ping"}')

        async def heard_out() -> None:
            while True:
                await pages[2].recv()

        with pytest.raises(ConnectionClosed, match="max_pages"):
            await asyncio.wait_for(heard_out(), 60.0)
        for page in pages:
            await page.close()

    play(scene, max_pages=2)
