"""Pictures as JPEG by sockets: who asks for it gets it, others the pixels; encoded once."""

from __future__ import annotations

import asyncio
import importlib.util
import io
import json
import re
import threading

import numpy as np
import pytest
import uwclient
from uwserver_adapters.native import service
from uwserver_adapters.sockets import SocketsAdapter
from video_rig import CAMERA, DEPTH, PATIENCE_S, context, number_of, picture, psnr, sample

from uwserver.adapter import pictures
from uwserver.packages import install_command
from uwserver.ports import Sample
from uwserver.testing import FakeContext

Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")


async def serve(fake: FakeContext, work) -> None:
    ready = asyncio.Event()
    task = asyncio.ensure_future(SocketsAdapter(SocketsAdapter.Config(port=0), fake).run(ready))
    try:
        await asyncio.wait_for(ready.wait(), PATIENCE_S)
        host, port = fake.stats.address.split(":")
        await asyncio.wait_for(work(lambda **more: uwclient.AsyncClient.connect(host, int(port), **more)), PATIENCE_S)
        assert not task.done()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_who_asks_for_jpeg_gets_it_and_others_the_pixels(encoding):
    fake = context()

    async def work(connect) -> None:
        async with (
            await connect(encoding=encoding) as one,
            await connect(encoding=encoding) as two,
            await connect(encoding=encoding) as raw,
        ):
            for client in (one, two):
                await client.subscribe("rov/*", pictures="jpeg")
            await raw.subscribe("rov/*")
            fake.put([sample(5), Sample(DEPTH.path, 0, 0, 0, True, (3.5,))])
            for client in (one, two):
                told = await client.read(CAMERA.path)
                assert isinstance(told["image"], bytes)
                shown = np.asarray(Image.open(io.BytesIO(told["image"])))
                assert number_of(shown) == 5
                assert psnr(shown, picture(5)) > 25.0
                assert told["exposure"] == 0.01
                assert (await client.read(DEPTH.path))["depth"] == 3.5
            np.testing.assert_array_equal((await raw.read(CAMERA.path)).array("image"), picture(5))
            assert fake.stats.encoded == 4, "each port once in each form"
            nothing = Sample(CAMERA.path, 1, 0, 0, False, (None, None))
            fake.put([nothing])
            assert dict((await one.read(CAMERA.path)).value) == {"exposure": None, "image": None}
            assert fake.stats.errors == 0
            assert await one.unsubscribe("rov/*") == await two.unsubscribe("rov/*") == 1
            fake.put([sample(6)])
            await raw.read(CAMERA.path)
            assert fake.stats.encoded == 7

    asyncio.run(serve(fake, work))


def test_nobody_waits_for_a_jpeg_but_who_asked_for_it_and_he_gets_all_in_order(monkeypatch):
    fake = context()
    gate, threads = threading.Event(), set()

    def slow(shown, quality=80):
        threads.add(threading.current_thread() is threading.main_thread())
        assert gate.wait(PATIENCE_S)
        return b"a picture"

    monkeypatch.setattr(pictures, "jpeg", slow)

    async def work(connect) -> None:
        async with await connect() as one, await connect() as raw:
            await one.subscribe("rov/*", pictures="jpeg")
            await raw.subscribe("rov/*")
            fake.put([sample(5), Sample(DEPTH.path, 0, 0, 0, True, (3.5,))])
            assert (await raw.read(DEPTH.path))["depth"] == 3.5
            fake.put([sample(6), Sample(DEPTH.path, 1, 0, 0, True, (4.5,))])
            told: list[str] = []

            async def of(path: str, count: int) -> None:
                for _ in range(count):
                    read = await one.read(path)
                    told.append(f"{path} {read.seq}")

            reading = [asyncio.ensure_future(of(path, 2)) for path in (CAMERA.path, DEPTH.path)]
            asked = asyncio.ensure_future(one.describe())
            await raw.describe()
            await asyncio.sleep(0.1)
            assert told == []
            assert not asked.done(), "what was asked later is answered later"
            gate.set()
            await asyncio.gather(*reading, asked)
            numbers = {CAMERA.path: (5, 6), DEPTH.path: (0, 1)}
            for path, expected in numbers.items():
                assert [each for each in told if each.startswith(path)] == [f"{path} {seq}" for seq in expected]
            assert threads == {False}

    asyncio.run(serve(fake, work))


def test_other_forms_and_servers_without_a_library_say_so(monkeypatch):
    fake = context()

    async def work(connect) -> None:
        async with await connect() as client:
            with pytest.raises(uwclient.CallRefused, match='"pictures" is "raw" or "jpeg"'):
                await client.subscribe("rov/*", pictures="png")
            monkeypatch.setattr(service, "can_encode_jpeg", lambda: False)
            with pytest.raises(uwclient.CallRefused, match=re.escape(install_command("uwserver[pictures]"))):
                await client.subscribe("rov/*", pictures="jpeg")
            await client.subscribe("rov/*", pictures="raw")

    asyncio.run(serve(fake, work))


@pytest.mark.skipif(importlib.util.find_spec("zenoh") is None, reason="eclipse-zenoh is not installed")
def test_by_zenoh_it_has_a_key_of_its_own():
    import zenoh
    from uwserver_adapters.zenoh_bus import ZenohAdapter

    async def whole() -> None:
        fake, ready = context(), asyncio.Event()
        config = ZenohAdapter.Config(listen=("tcp/127.0.0.1:0",), scouting=False)
        task = asyncio.ensure_future(ZenohAdapter(config, fake).run(ready))
        peer = None
        try:
            await asyncio.wait_for(ready.wait(), PATIENCE_S)
            options = (
                f'{{connect: {{endpoints: ["{fake.stats.address}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
            )
            peer = await asyncio.to_thread(zenoh.open, zenoh.Config.from_json5(options))
            came = []
            subscriber = peer.declare_subscriber("uw/uwserver/@jpeg/rov/camera", came.append)
            while not came:
                fake.put([Sample(CAMERA.path, 0, 0, 0, False, (None, None)), sample(7)])
                await asyncio.sleep(0.02)
            shown = np.asarray(Image.open(io.BytesIO(came[0].payload.to_bytes())))
            assert number_of(shown) == 7
            assert str(came[0].encoding) == "image/jpeg"
            meta = json.loads(came[0].attachment.to_bytes())
            assert (meta["port"], meta["seq"], meta["field"]) == ("rov/camera", 7, "image")
            subscriber.undeclare()
            while fake.subscriptions:
                await asyncio.sleep(0.02)
            fake.set_ports([DEPTH])
            assert fake.stats.errors == 0
        finally:
            if peer is not None:
                peer.close()
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    asyncio.run(asyncio.wait_for(whole(), 2 * PATIENCE_S))


@pytest.mark.skipif(importlib.util.find_spec("zenoh") is None, reason="eclipse-zenoh is not installed")
def test_by_zenoh_the_option_is_refused():
    from uwserver_adapters.zenoh_bus import ZenohAdapter

    async def whole() -> None:
        fake, ready = context(), asyncio.Event()
        config = ZenohAdapter.Config(listen=("tcp/127.0.0.1:0",), scouting=False)
        task = asyncio.ensure_future(ZenohAdapter(config, fake).run(ready))
        try:
            await asyncio.wait_for(ready.wait(), PATIENCE_S)
            connected = await uwclient.connect_zenoh_async("uwserver", [fake.stats.address], timeout=PATIENCE_S)
            async with connected as client:
                with pytest.raises(uwclient.CallRefused, match="over zenoh pictures come as they are"):
                    await client.subscribe("rov/*", pictures="jpeg")
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    asyncio.run(asyncio.wait_for(whole(), 2 * PATIENCE_S))
