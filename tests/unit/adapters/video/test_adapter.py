"""Who gets pictures, when they are encoded, and what clients that are slow, silent, dead or too many cost."""

from __future__ import annotations

import asyncio
import re
import socket
import struct
import threading
from collections.abc import Coroutine
from contextlib import AsyncExitStack
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import pytest
from msgspec.structs import replace
from uwserver_adapters.video import adapter as adapter_module
from uwserver_adapters.video import config as config_module
from uwserver_adapters.video import connection as connection_module
from uwserver_adapters.video import stream as stream_module
from uwserver_adapters.video.config import StreamTable, VideoConfig
from uwserver_adapters.video.encoder import Coded
from video_rig import CAMERA, DEPTH, STEP_NS, camera, context, picture, sample, serving

from uwserver.adapter import CannotServe
from uwserver.packages import install_command
from uwserver.ports import Event
from uwserver.testing import FakeContext

PATIENCE_S = 120.0
FRONT = StreamTable(port="rov/camera", codec="jpeg")
H264 = StreamTable(port="rov/camera")


def bounded(work: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(work, PATIENCE_S))


async def until(said: Any) -> None:
    while not said():
        await asyncio.sleep(0.005)


class Player:
    """A client of RTSP, by hand."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer, self.seq = reader, writer, 0
        self.packets: list[bytes] = []

    @classmethod
    async def connect(cls, fake: FakeContext, stack: AsyncExitStack, limit: int = 1 << 16) -> Player:
        host, _, port = fake.stats.address.removeprefix("rtsp://").rstrip("/").rpartition(":")
        player = cls(*await asyncio.open_connection(host, int(port), limit=limit))
        stack.callback(player.writer.close)
        return player

    async def ask(self, method: str, name: str = "front", **headers: str) -> tuple[int, str]:
        """Status and all of the answer; packets that come before it are kept."""
        self.seq += 1
        fields = "".join(f"{key}: {value}\r\n" for key, value in headers.items())
        self.writer.write(f"{method} rtsp://h/{name} RTSP/1.0\r\nCSeq: {self.seq}\r\n{fields}\r\n".encode())
        return await self.answer()

    async def answer(self) -> tuple[int, str]:
        while (first := await self.reader.readexactly(1)) == b"$":
            await self._packet()
        head = (first + await self.reader.readuntil(b"\r\n\r\n")).decode()
        return int(head.split()[1]), head

    async def _packet(self) -> bytes:
        channel, size = struct.unpack(">BH", await self.reader.readexactly(3))
        data = await self.reader.readexactly(size)
        if channel == 0:
            self.packets.append(data)
        return data

    async def play(self, name: str = "front", transport: str = "RTP/AVP/TCP;interleaved=0-1") -> None:
        assert (await self.ask("SETUP", name, Transport=transport))[0] == 200
        assert (await self.ask("PLAY", name))[0] == 200

    async def picture(self) -> list[bytes]:
        """Packets of the next picture."""
        found: list[bytes] = []
        while not (found and found[-1][1] & 0x80):
            assert await self.reader.readexactly(1) == b"$"
            await self._packet()
            found += self.packets
            self.packets.clear()
        return found


def kinds(packets: list[bytes]) -> set[int]:
    """Types of the NAL units that begin in these packets."""
    found = set()
    for packet in packets:
        kind = packet[12] & 0x1F
        found.add(packet[13] & 0x1F if kind == 28 else kind)
    return found


def test_nothing_is_encoded_for_nobody_and_once_for_many():
    async def whole() -> None:
        async with serving(streams={"front": FRONT}) as fake, AsyncExitStack() as stack:
            assert fake.subscriptions == frozenset()
            players = [await Player.connect(fake, stack) for _ in range(5)]
            for player in players:
                await player.play()
            assert fake.subscriptions == {"rov/camera"}
            for number in range(3):
                fake.put([sample(number), replace(sample(number), port="rov/depth")])
                found = [await player.picture() for player in players]
                assert all(other == found[0] for other in found)
            assert (fake.stats.encoded, fake.stats.samples_sent) == (3, 15)
            for player in players[:3]:
                assert (await player.ask("TEARDOWN"))[0] == 200
            assert fake.subscriptions == {"rov/camera"}
            players[3].writer.transport.abort()
            players[4].writer.close()
            await until(lambda: fake.subscriptions == frozenset())
            assert fake.stats.peers == 3

    bounded(whole())


def test_a_stream_with_a_target_always_runs():
    async def whole() -> None:
        loop = asyncio.get_running_loop()
        came: asyncio.Queue[bytes] = asyncio.Queue()

        class Receiver(asyncio.DatagramProtocol):
            def datagram_received(self, data: bytes, addr: object) -> None:
                came.put_nowait(data)

        transport, _ = await loop.create_datagram_endpoint(Receiver, local_addr=("127.0.0.1", 0))
        try:
            port = transport.get_extra_info("sockname")[1]
            table = StreamTable(port="rov/camera", codec="jpeg", rtp=(f"127.0.0.1:{port}",))
            async with serving(streams={"front": table}, rtsp=False) as fake:
                assert fake.subscriptions == {"rov/camera"}
                fake.put([sample(3)])
                packets = [await came.get()]
                while not packets[-1][1] & 0x80:
                    packets.append(await came.get())
                assert [struct.unpack_from(">H", packet, 2)[0] for packet in packets] == [
                    (struct.unpack_from(">H", packets[0], 2)[0] + k) & 0xFFFF for k in range(len(packets))
                ]
                assert {packet[1] & 0x7F for packet in packets} == {26}
        finally:
            transport.abort()

    bounded(whole())


def test_who_comes_begins_with_a_key_picture_at_once(monkeypatch):
    pytest.importorskip("av", reason="PyAV is not installed")
    monkeypatch.setattr(stream_module, "FORCE_S", 3600.0)

    async def whole() -> None:
        async with serving(streams={"front": H264}) as fake, AsyncExitStack() as stack:
            first = await Player.connect(fake, stack)
            await first.play()
            fake.put([sample(0)])
            assert {5, 7, 8} <= kinds(await first.picture())
            fake.put([sample(1)])
            assert kinds(await first.picture()) == {1}
            monkeypatch.setattr(stream_module, "FORCE_S", 0.0)
            second = await Player.connect(fake, stack)
            await second.play()
            fake.put([sample(2)])
            packets = await second.picture()
            assert {5, 7, 8} <= kinds(packets)
            assert await first.picture() == packets
            # Those who come again and again have no key picture each time.
            monkeypatch.setattr(stream_module, "FORCE_S", 3600.0)
            third = await Player.connect(fake, stack)
            await third.play()
            fake.put([sample(3)])
            assert kinds(await second.picture()) == {1}
            _, described = await third.ask("DESCRIBE")
            assert "200 OK" in described
            body = (await third.reader.readexactly(int(described.split("Content-Length: ")[1].split()[0]))).decode()
            assert "sprop-parameter-sets=" in body
            assert third.packets == []

    bounded(whole())


def test_stamps_go_on_after_a_reset():
    async def whole() -> None:
        async with serving(streams={"front": FRONT}) as fake, AsyncExitStack() as stack:
            player = await Player.connect(fake, stack)
            await player.play()
            stamps = []
            for number in (100, 101, 0, 1):
                fake.put([sample(number)])
                stamps.append(struct.unpack_from(">I", (await player.picture())[0], 4)[0])
            assert [(b - a) & 0xFFFF_FFFF for a, b in pairwise(stamps)] == [STEP_NS * 9 // 100_000] * 3

    bounded(whole())


class Stuck:
    """An encoder that waits until the test lets it go on, and says what it got."""

    go_on: ClassVar[threading.Event] = threading.Event()
    made: ClassVar[list[Stuck]] = []

    def __init__(self, *_: object) -> None:
        self.seen = 0
        self.is_closed = False
        Stuck.made.append(self)

    def encode(self, shown: Any, wants_key: bool) -> Coded:
        assert Stuck.go_on.wait(PATIENCE_S)
        self.seen += 1
        return Coded([b"x"], True, 1, "")

    def close(self) -> None:
        self.is_closed = True


def test_an_encoder_without_time_loses_pictures_and_says_so(monkeypatch):
    monkeypatch.setattr(stream_module, "JpegEncoder", Stuck)
    Stuck.go_on.clear()
    Stuck.made.clear()

    async def whole() -> None:
        async with serving(streams={"front": FRONT}) as fake, AsyncExitStack() as stack:
            player = await Player.connect(fake, stack)
            await player.play()
            for number in range(10):
                fake.put([sample(number)])
            dropped = fake.stats.dropped
            Stuck.go_on.set()
            assert dropped == 10 - stream_module.WAITING
            assert fake.stats.details["refused"] == {"slow encoder": 10 - stream_module.WAITING}
            for _ in range(stream_module.WAITING):
                await player.picture()
            fake.put([sample(11)])
            await player.picture()
        (encoder,) = Stuck.made
        assert (encoder.seen, encoder.is_closed) == (stream_module.WAITING + 1, True)

    bounded(whole())


def test_a_picture_that_cannot_be_encoded_is_told_and_the_next_one_comes(monkeypatch):
    async def whole() -> None:
        wide = np.zeros((16, 2048, 3), np.uint8)
        async with serving(streams={"front": FRONT}) as fake, AsyncExitStack() as stack:
            player = await Player.connect(fake, stack)
            await player.play()
            fake.put([sample(0, shown=wide), replace(sample(1), valid=False, value=(None, None))])
            await until(lambda: fake.stats.errors)
            assert "2040 pixels a side" in fake.stats.last_error
            fake.put([sample(2)])
            await player.picture()
            assert fake.stats.encoded == 1

    bounded(whole())


@pytest.mark.parametrize("codec", ["jpeg", "h264"])
def test_sizes_may_change_and_be_odd(codec):
    if codec == "h264":
        pytest.importorskip("av", reason="PyAV is not installed")

    async def whole() -> None:
        table = StreamTable(port="rov/camera", codec=codec)
        async with serving(streams={"front": table}) as fake, AsyncExitStack() as stack:
            player = await Player.connect(fake, stack)
            await player.play()
            for number, (height, width) in enumerate([(120, 160), (61, 99), (1, 1), (2, 300)]):
                fake.put([sample(number, shown=np.full((height, width, 3), 80, np.uint8))])
                packets = await player.picture()
                if codec == "h264":
                    assert {5, 7, 8} <= kinds(packets)
            assert fake.stats.errors == 0

    bounded(whole())


def test_a_client_that_does_not_read_gets_no_more_and_others_do():
    async def whole() -> None:
        noise = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)  # 300 kB each
        async with serving(streams={"front": FRONT}, queue_bytes=1 << 19) as fake, AsyncExitStack() as stack:
            slow, quick = [await Player.connect(fake, stack, limit=4096) for _ in range(2)]
            for player in (slow, quick):
                await player.play()
            number = 0
            while not fake.stats.dropped:
                fake.put([sample(number, shown=noise)])
                await quick.picture()
                number += 1
                assert number < 300
            for later in range(number, number + 3):
                fake.put([sample(later, shown=noise)])
                await quick.picture()
            # Who reads again hears whole pictures.
            before = fake.stats.dropped
            found = await slow.picture()
            assert struct.unpack_from(">I", found[0], 12)[0] == 0  # an offset in the picture: it begins with its begin
            assert before >= 1

    bounded(whole())


def test_too_many_clients_are_told_and_those_who_have_a_place_keep_it():
    async def whole() -> None:
        async with serving(streams={"front": FRONT}, max_clients=2) as fake, AsyncExitStack() as stack:
            players = [await Player.connect(fake, stack) for _ in range(3)]
            for player in players[:2]:
                await player.play()
            status, head = await players[2].ask("OPTIONS")
            assert (status, "\r\nCSeq: 1\r\n" in head) == (453, True)
            assert (await players[2].reader.read()).startswith(b"2 clients are connected")
            fake.put([sample(0)])
            for player in players[:2]:
                assert await player.picture()

    bounded(whole())


def test_a_channel_without_a_next_one_is_not_taken_and_others_get_each_picture():
    async def whole() -> None:
        failures: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, told: failures.append(told))
        async with serving(streams={"front": FRONT}) as fake, AsyncExitStack() as stack:
            odd, other = [await Player.connect(fake, stack) for _ in range(2)]
            _, told = await odd.ask("SETUP", Transport="RTP/AVP/TCP;interleaved=255-0")
            assert "interleaved=0-1" in told
            assert (await odd.ask("PLAY"))[0] == 200
            await other.play()
            fake.put([sample(0)])  # with a report, on the second channel
            assert await odd.picture() == await other.picture()
        assert failures == []

    bounded(whole())


def test_one_who_fails_does_not_take_pictures_from_others(monkeypatch):
    async def whole() -> None:
        async with serving(streams={"front": FRONT}) as fake, AsyncExitStack() as stack:
            players = [await Player.connect(fake, stack) for _ in range(2)]
            for player in players:
                await player.play()
            sent = connection_module.RtspConnection._sent
            failing: list[object] = []

            def fails_for_the_first(self: Any, picture: Any) -> bool:
                if not failing:
                    failing.append(self)
                    raise struct.error("no byte")
                return sent(self, picture)

            monkeypatch.setattr(connection_module.RtspConnection, "_sent", fails_for_the_first)
            fake.put([sample(0)])
            assert await players[1].picture()
            assert (fake.stats.errors, "no byte" in fake.stats.last_error) == (1, True)

    bounded(whole())


@pytest.mark.parametrize("reads", [True, False], ids=["reads", "reads nothing"])
def test_a_paused_world_ends_no_player_that_reads(reads):
    """By TCP players say nothing while no packet comes."""

    async def whole() -> None:
        noise = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)
        config = {"keep_alive_s": 1.0, "queue_bytes": 1 << 20}
        async with serving(streams={"front": FRONT}, **config) as fake, AsyncExitStack() as stack:
            player = await Player.connect(fake, stack, limit=4096)
            await player.play()
            number = 0
            while not number or not (reads or fake.stats.dropped):
                fake.put([sample(number, shown=noise)])
                await until(lambda: fake.stats.samples_sent + fake.stats.dropped > number)  # noqa: B023
                if reads:
                    await player.picture()
                number += 1
            if reads:
                await asyncio.sleep(2.5)  # the world is paused
                assert fake.subscriptions
                fake.put([sample(number)])
                assert await player.picture()
            else:
                await until(lambda: not fake.subscriptions)
                assert fake.stats.details["refused"]["silent"] == 1

    bounded(whole())


@pytest.mark.parametrize("speaks", [False, True], ids=["silent", "reports"])
def test_datagrams_end_when_their_client_falls_silent(speaks):
    async def whole() -> None:
        loop = asyncio.get_running_loop()
        came: list[bytes] = []

        class Receiver(asyncio.DatagramProtocol):
            def datagram_received(self, data: bytes, addr: object) -> None:
                came.append(data)

        media, _ = await loop.create_datagram_endpoint(Receiver, local_addr=("127.0.0.1", 0))
        reports, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=("127.0.0.1", 0))
        try:
            async with serving(streams={"front": FRONT}, keep_alive_s=1.0) as fake, AsyncExitStack() as stack:
                player = await Player.connect(fake, stack)
                pair = [end.get_extra_info("sockname")[1] for end in (media, reports)]
                status, head = await player.ask("SETUP", Transport=f"RTP/AVP;unicast;client_port={pair[0]}-{pair[1]}")
                assert (status, "timeout=1" in head) == (200, True)
                ours = [int(port) for port in head.split("server_port=")[1].split()[0].split("-")]
                assert ours[0] % 2 == 0
                assert ours[1] == ours[0] + 1
                assert (await player.ask("PLAY"))[0] == 200
                fake.put([sample(0)])
                await until(lambda: came)
                began = loop.time()
                while fake.subscriptions and (loop.time() - began < 3.0 or not speaks):
                    if speaks:
                        reports.sendto(b"\x80\xc9\x00\x01abcd", ("127.0.0.1", ours[1]))
                    await asyncio.sleep(0.1)
                assert bool(fake.subscriptions) is speaks
                if not speaks:
                    assert await player.reader.read() == b""
                    assert fake.stats.details["refused"] == {"silent": 1}
        finally:
            media.abort()
            reports.abort()

    bounded(whole())


def test_datagrams_cost_the_loop_nothing(monkeypatch):
    """A large picture is hundreds of packets for each who takes it."""
    threads: set[str] = set()
    send = socket.socket.sendto

    def recorded(self: socket.socket, *given: Any) -> int:
        threads.add(threading.current_thread().name)
        return send(self, *given)

    monkeypatch.setattr(socket.socket, "sendto", recorded, raising=False)

    async def whole() -> None:
        with socket.socket(type=socket.SOCK_DGRAM) as client, socket.socket(type=socket.SOCK_DGRAM) as target:
            for end in (client, target):
                end.bind(("127.0.0.1", 0))
                end.setblocking(False)
            table = StreamTable(port="rov/camera", codec="jpeg", rtp=f"127.0.0.1:{target.getsockname()[1]}")
            async with serving(streams={"front": table}) as fake, AsyncExitStack() as stack:
                player = await Player.connect(fake, stack)
                at = client.getsockname()[1]
                await player.play(transport=f"RTP/AVP;unicast;client_port={at}-{at + 1}")
                fake.put([sample(0)])
                loop = asyncio.get_running_loop()
                assert await loop.sock_recv(client, 2000) == await loop.sock_recv(target, 2000)
                assert fake.stats.samples_sent == 2

    bounded(whole())
    assert {name.rpartition("_")[0] for name in threads} == {"video datagrams"}


def test_no_request_costs_more_than_its_answer():
    async def whole() -> None:
        async with serving(streams={"front": FRONT}) as fake, AsyncExitStack() as stack:
            for data in (
                b"\x00" * 9000,
                b"OPTIONS * RTSP/1.0\r\nbad\r\n\r\n",
                b"GET / RTSP/1.0\r\n\r\n" * 50,
                b"$\x00\xff\xff",
            ):
                player = await Player.connect(fake, stack)
                player.writer.write(data)
                if not data.startswith(b"$"):
                    assert (await player.answer())[0] in (400, 413)
            player = await Player.connect(fake, stack)
            assert (await player.ask("DESCRIBE"))[0] == 200

    bounded(whole())


def test_ports_that_come_and_go_have_streams_where_no_table_names_them():
    async def whole() -> None:
        async with serving(context(DEPTH), codec="jpeg") as fake, AsyncExitStack() as stack:
            player = await Player.connect(fake, stack)
            assert (await player.ask("SETUP", "rov/camera", Transport="RTP/AVP/TCP"))[0] == 404
            await player.reader.readuntil(b"pictures\r\n")
            fake.set_ports([DEPTH, CAMERA, camera("rov/ids", "uint16", (-1, -1))])
            for name, number in (("rov/camera", 0), ("rov/ids", 1)):
                other = await Player.connect(fake, stack)
                await other.play(name)
                shown = picture(number) if number == 0 else np.ones((8, 8), np.uint16)
                fake.put([sample(number, name, shown)])
                assert await other.picture()
            fake.set_ports([DEPTH])
            await until(lambda: fake.subscriptions == frozenset())
            fake.say(Event("reset", 0, 0, "again"))

    bounded(whole())


@pytest.mark.parametrize("codec", ["jpeg", "h264"])
def test_encoders_are_there_before_the_first_camera_is(monkeypatch, codec):
    """Not while the world runs: the import takes as long as hundreds of ticks, and what fails is told before."""
    loaded: list[str] = []
    monkeypatch.setattr(adapter_module, "SHOW_S", 0.05)
    monkeypatch.setattr(adapter_module, "can_encode_jpeg", lambda: loaded.append("jpeg") or True)
    monkeypatch.setattr(adapter_module.importlib, "import_module", loaded.append)

    async def whole() -> None:
        async with serving(context(DEPTH), codec=codec) as fake:
            assert loaded == ["av" if codec == "h264" else "jpeg"]
            fake.set_ports([DEPTH, CAMERA])
            assert len(loaded) == 1
            assert list(fake.stats.details["streams"]) == []
            await until(lambda: fake.stats.details["streams"])

    bounded(whole())


def test_without_a_library_for_jpeg_it_does_not_begin(monkeypatch):
    async def whole() -> None:
        async with serving(context(DEPTH), codec="jpeg"):
            pass

    monkeypatch.setattr(adapter_module, "can_encode_jpeg", lambda: False)
    with pytest.raises(CannotServe, match=re.escape(install_command("uwserver[pictures]"))):
        bounded(whole())
    monkeypatch.setattr(config_module, "can_encode_jpeg", lambda: False)
    assert VideoConfig(codec="jpeg").needs() == {"simplejpeg": "uwserver[pictures]"}
    assert VideoConfig(streams={"a": H264}, codec="jpeg").needs() == {"av": "uwserver[video]"}


@pytest.mark.parametrize(
    ("port", "text"),
    [
        ("rov/camra", r'streams\.front\.port: no port "rov/camra" \(did you mean "rov/camera"\?\); ports with pictures: rov/camera'),
        ("rov/depth", r'"rov/depth" has no pictures; ports with pictures: rov/camera'),
    ],
)  # fmt: skip
def test_a_table_that_names_no_camera(port, text):
    async def whole() -> None:
        async with serving(streams={"front": StreamTable(port=port, codec="jpeg")}):
            pass

    with pytest.raises(CannotServe, match=text):
        bounded(whole())


def test_a_check_tells_the_same():
    streams = {name: StreamTable(port=port) for name, port in (("a", "rov/camera"), ("b", "rov/depth"), ("c", "rov/x"))}
    found = dict(VideoConfig(streams=streams).faults(context().ports, {}))
    assert list(found) == [("streams", "b", "port"), ("streams", "c", "port")]
    assert found["streams", "b", "port"] == '"rov/depth" has no pictures; ports with pictures: rov/camera'
    assert found["streams", "c", "port"].startswith('no port "rov/x"')
    assert list(VideoConfig().faults({}, {})) == []


@pytest.mark.parametrize(
    "given",
    [
        {"mavlink": ("127.0.0.1",)},
        {"rtsp": False},
        {"rtsp": False, "streams": {"front": FRONT}},
    ],
)
def test_tables_that_serve_nobody_or_name_no_address(given):
    with pytest.raises(ValueError, match=r"host:port|nothing would be served"):
        VideoConfig(**given)
    for address in ("5600", "host", "127.0.0.1:0", "127.0.0.1:70000", ":5600", "h:\u0661"):
        with pytest.raises(ValueError, match="host:port"):
            StreamTable(port="rov/camera", rtp=address)


def test_what_it_needs():
    assert VideoConfig().needs() == {"av": "uwserver[video]"}
    assert VideoConfig(codec="jpeg").needs() == {}
    assert VideoConfig(codec="jpeg", streams={"a": H264}).needs() == {"av": "uwserver[video]"}
    assert VideoConfig(streams={"a": FRONT}, mavlink=("h:1",)).needs() == {"pymavlink.dialects.v20.common": "uwserver"}
