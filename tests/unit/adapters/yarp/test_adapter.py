"""The adapter on real sockets, over a fake server, with a name server and readers of the test's own that know YARP by its bytes alone."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
from msgspec import structs
from uwserver_adapters.yarp import adapter as module
from uwserver_adapters.yarp import links
from uwserver_adapters.yarp.adapter import YarpAdapter
from uwserver_adapters.yarp.bottle import to_binary
from uwserver_adapters.yarp.config import YarpConfig
from uwserver_adapters.yarp.links import server_of, target_of
from video_rig import CAMERA
from video_rig import sample as filmed

from uwserver.adapter import CannotListen, CannotServe, may_connect
from uwserver.ports import Buffer, Port, Refused, Reply
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import DEPTH, IMU, PORTS, THRUSTERS

READY = b"YA\xe4\x1e\0\0RP\3\0\0\0/r\0"
FAST = b"YA\x64\x1e\0\0RP\3\0\0\0/r\0"


@dataclass
class NameServer:
    """Speaks the text protocol; `names` is what it knows."""

    names: dict[str, tuple[str, int]] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    server: asyncio.Server | None = None
    port: int = 0

    async def open(self, port: int = 0) -> NameServer:
        self.server = await asyncio.start_server(self._serve, "127.0.0.1", port)
        self.port = self.server.sockets[0].getsockname()[1]
        return self

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        who = (await reader.readline()).removeprefix(b"CONNECT ")
        writer.write(b"Welcome " + who)
        while (await reader.readline()).strip() == b"d":
            words = (await reader.readline()).decode().split()
            self.asked.append(" ".join(words))
            if words[0] == "register":
                self.names[words[1]] = (words[3], int(words[4]))
            found = self.names.get(words[1])
            if words[0] == "unregister":
                self.names.pop(words[1], None)
            if found:
                writer.write(f"registration name {words[1]} ip {found[0]} port {found[1]} type tcp\r\n".encode())
            writer.write(b"*** end of message\r\n")
        writer.close()

    async def close(self) -> None:
        assert self.server is not None
        self.server.close()
        await self.server.wait_closed()


@asynccontextmanager
async def a_name_server() -> AsyncIterator[NameServer]:
    server = await NameServer().open()
    try:
        yield server
    finally:
        await server.close()


@asynccontextmanager
async def serving(config: YarpConfig, context: FakeContext) -> AsyncIterator[Callable[[str], int]]:
    """Gives a function from a port's name to its TCP port."""
    ready = asyncio.Event()
    task = asyncio.ensure_future(YarpAdapter(config, context).run(ready))
    waiting = asyncio.ensure_future(ready.wait())
    try:
        await asyncio.wait([task, waiting], timeout=60, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if task.done():
            task.result()
        yield lambda name: context.stats.details["ports"][f"/uwserver/{name}"]  # type: ignore[index, call-overload, return-value]
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def run(story: Callable[[FakeContext, NameServer], Awaitable[None]]) -> None:
    async def bounded() -> None:
        async with a_name_server() as server:
            await story(FakeContext(), server)

    asyncio.run(asyncio.wait_for(bounded(), 120))


async def until(true: Callable[[], object]) -> None:
    while not true():
        await asyncio.sleep(0.01)


def table(server: NameServer, **more: object) -> YarpConfig:
    return YarpConfig(name_server=f"127.0.0.1:{server.port}", **more)  # type: ignore[arg-type]


class Client:
    """A connection to a port."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def text(cls, port: int, hello: bytes = b"CONNACK /me\r\n") -> Client:
        client = cls(*await asyncio.open_connection("127.0.0.1", port))
        client.writer.write(hello)
        assert await client.reader.readline() == b"Welcome /me\r\n"
        return client

    @classmethod
    async def binary(cls, port: int, hello: bytes) -> Client:
        client = cls(*await asyncio.open_connection("127.0.0.1", port))
        client.writer.write(hello)
        assert await client.reader.readexactly(8) == b"YA" + struct.pack("<i", port) + b"RP"
        return client

    async def ask(self, command: str, *bottle: str) -> str:
        self.writer.write("".join(f"{line}\r\n" for line in (command, *bottle)).encode())
        answer = (await self.reader.readline()).decode().strip()
        assert await self.reader.readline() == b"<ACK>\r\n"
        return answer

    async def message(self) -> tuple[bytes, bytes]:
        """Command and bottle of the next binary message."""
        assert await self.reader.readexactly(8) == b"YA\x0a\0\0\0RP"
        index = await self.reader.readexactly(10)
        assert index[1:] == b"\1" + b"\xff" * 8
        sizes = struct.unpack(f"<{index[0] + 1}i", await self.reader.readexactly(4 * index[0] + 4))
        assert sizes[-1] == 0
        blocks = [await self.reader.readexactly(size) for size in sizes[:-1]]
        return b"".join(blocks[:-1]), blocks[-1]

    def close(self) -> None:
        self.writer.transport.abort()


def test_all_ports_are_registered_and_unregistered() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            await until(lambda: context.stats.details.get("registered") == 5)
            names = {
                f"/uwserver/{name}" for name in ("clock", "rov/imu:o", "rov/depth:o", "rov/thrusters:i", "world/rpc:i")
            }
            assert server.names.keys() == names
            assert server.names["/uwserver/rov/imu:o"] == ("127.0.0.1", port("rov/imu:o"))
        assert not server.names

    run(story)


def test_a_name_server_that_comes_late_dies_and_forgets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHECK_S", 0.02)

    async def story(context: FakeContext, server: NameServer) -> None:
        await server.close()
        async with serving(table(server), context):
            await until(lambda: "no YARP name server" in context.stats.last_error)
            again = await NameServer().open(server.port)
            await until(lambda: len(again.names) == 5)
            again.names.clear()
            await until(lambda: len(again.names) == 5)
            await again.close()
            await until(lambda: context.stats.details["registered"] == 0)
            server.server = (await NameServer(again.names).open(server.port)).server

    run(story)


def test_a_prefix_that_another_server_has_taken_is_told_and_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHECK_S", 0.02)

    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context):
            await until(lambda: context.stats.details.get("registered") == 5)
            server.names["/uwserver/clock"] = ("127.0.0.1", 9)
            await until(lambda: context.stats.details.get("refused") is not None)
            assert "prefix" in context.stats.details["refused"]  # type: ignore[operator]
            assert server.names["/uwserver/clock"] == ("127.0.0.1", 9)

    run(story)


def test_ports_come_and_go_with_the_world() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            await until(lambda: context.stats.details.get("registered") == 5)
            reader = await Client.binary(port("rov/imu:o"), FAST)
            other = Port("auv/depth", "sensor", "pressure", DEPTH.fields, "x", rate_hz=25.0)
            context.set_ports((DEPTH, THRUSTERS, other))
            assert await reader.reader.read(100) == b""  # its port is gone
            await until(lambda: "/uwserver/auv/depth:o" in server.names and "/uwserver/rov/imu:o" not in server.names)
            context.set_ports(PORTS)
            await until(lambda: "/uwserver/rov/imu:o" in server.names)
            client = await Client.text(port("rov/imu:o"))
            assert await client.ask("a", "[ver]") == "[ver] 1 2 3"
            client.close()
            reader.close()

    run(story)


READERS = {"fast_tcp": FAST, "tcp": READY}


@pytest.mark.parametrize("carrier", READERS)
def test_who_dials_in_and_reverses_reads_samples_with_their_time(carrier: str) -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            client = await Client.binary(port("rov/depth:o"), READERS[carrier])
            assert context.subscriptions == frozenset()
            client.writer.write(
                bytes.fromhex("59410a0000005250 0101ffffffffffffffff 08000000 00000000 000000007e720001")
            )
            if carrier == "tcp":
                assert await client.reader.readexactly(8) == b"YA\0\0\0\0RP"
            await until(lambda: context.subscriptions == {DEPTH.path})
            context.emit()
            context.emit()
            command, bottle = await client.message()
            assert command == b"\x0a\0\0\0~\0\0\1D 0 0.004\0"
            depth, valid = struct.pack("<d", 0.0), struct.pack("<i", 1)
            pair = b"\0\1\0\0\2\0\0\0\4\0\0\0"
            assert bottle == (
                b"\0\1\0\0\2\0\0\0"
                + pair
                + b"\5\0\0\0depth\x14\0\0\0"
                + depth
                + pair
                + b"\5\0\0\0valid\1\0\0\0"
                + valid
            )
            assert (await client.message())[0].endswith(b"D 1 0.008\0")
            client.close()
            await until(lambda: context.subscriptions == frozenset())

    run(story)


def test_vectors_are_for_readers_of_yarp_sig() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server, vectors=("*/imu",)), context) as port:
            client = await Client.binary(port("rov/imu:o"), FAST)
            client.writer.write(
                bytes.fromhex("59410a0000005250 0101ffffffffffffffff 08000000 00000000 000000007e720001")
            )
            await until(lambda: context.subscriptions)
            context.emit()
            _, bottle = await client.message()
            assert struct.unpack("<ii7d", bottle) == (276, 7, 0.0, 1.0, 2.0, 100.0, 101.0, 102.0, 200.0)
            client.close()

    run(story)


def test_a_camera_has_a_port_of_pictures() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        context.set_ports((*PORTS, CAMERA))
        async with serving(table(server), context) as port:
            lines = await Client.text(port("rov/camera/image:o"))
            lines.writer.write(b"r\r\n")
            client = await Client.binary(port("rov/camera/image:o"), FAST)
            whole = await Client.binary(port("rov/camera:o"), FAST)
            for reader in (client, whole):
                reader.writer.write(
                    bytes.fromhex("59410a0000005250 0101ffffffffffffffff 08000000 00000000 000000007e720001")
                )
            sample = filmed(5)
            there: Any = context.subscribers[0]
            heard = [there.ports[f"/uwserver/rov/{name}:o"].readers for name in ("camera/image", "camera")]
            await until(lambda: [len(readers) for readers in heard] == [2, 1])
            context.put([sample])
            command, body = await client.message()
            picture = sample.value[-1]
            assert isinstance(picture, Buffer)
            assert b"D 5 " in command
            rows, columns, _ = picture.shape
            assert struct.unpack("<4i", body[44:60]) == (columns, rows, 12, len(picture.data))
            assert body[60:] == picture.data
            _, bottle = await whole.message()
            assert b"exposure" in bottle
            for each in (client, whole, lines):
                each.close()

    run(story)


def test_text_and_binary_are_encoded_once_each() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            clients = [await Client.text(port("rov/depth:o")) for _ in range(3)]
            for client in clients:
                client.writer.write(b"r\r\n")
                assert await client.reader.readline() == b"<ACK>\r\n"
            context.emit()
            for client in clients:
                assert await client.reader.readline() == b"D 0 0.004\r\n"
                assert await client.reader.readline() == b"(depth 0.0) (valid 1)\r\n"
                client.close()
            assert context.stats.encoded == 1
            assert context.stats.samples_sent == 3

    run(story)


def test_the_clock_tells_the_time_of_the_simulation() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server, clock_hz=125.0), context) as port:
            client = await Client.text(port("clock"))
            client.writer.write(b"r\r\n")
            await client.reader.readline()
            await until(lambda: context.subscriptions == {IMU.path})  # the quickest
            for _ in range(4):
                context.emit()
            said = [await client.reader.readline() for _ in range(4)]
            assert said == [b"D\r\n", b"0 4000000\r\n", b"D\r\n", b"0 12000000\r\n"]
            client.close()

    run(story)


def test_commands_are_answered_to_who_waits() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            client = await Client.text(port("rov/thrusters:i"))
            assert await client.ask("d", "(u (0.5 0.5 0.5 0.5 0.5 0.5 0.5 0.5))") == "[ok]"
            assert "must be a list of 8" in await client.ask("d", "1 2")
            assert "[fail]" in await client.ask("d", "((")
            client.writer.write(b"D\r\n0 0 0 0 0 0 0 0.25\r\nD\r\n1\r\n")
            assert [await client.reader.readline() for _ in range(2)] == [b"<ACK>\r\n"] * 2
            assert [command.value for command in context.commands] == [((0.5,) * 8,), ((0.0,) * 7 + (0.25,),)]
            assert "/uwserver/rov/thrusters:i from /me" in context.stats.last_error
            client.close()

    run(story)


def test_a_binary_writer_commands() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            client = await Client.binary(port("rov/thrusters:i"), READY)
            bottle = struct.pack("<ii8d", 276, 8, *[0.125] * 8)
            index = b"YA\x0a\0\0\0RP\2\1" + b"\xff" * 8 + struct.pack("<iii", 8, len(bottle), 0)
            client.writer.write(index + b"\0\0\0\0~D\0\1" + bottle + index + b"\0\0\0\0~d\0\1" + bottle)
            acknowledgement = await client.reader.readexactly(8)
            answer = await client.reader.readexactly(16)
            assert acknowledgement == await client.reader.readexactly(8) == b"YA\0\0\0\0RP"
            assert answer == struct.pack("<iii4s", 256, 1, 9, b"ok")
            assert [command.value for command in context.commands] == [((0.125,) * 8,)] * 2
            client.close()

    run(story)


def test_a_sensor_takes_nothing() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            client = await Client.text(port("rov/imu:o"))
            assert "takes nothing" in await client.ask("d", "1")
            client.close()

    run(story)


def test_services_are_called_in_order_and_told_with_what_they_take() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            client = await Client.text(port("world/rpc:i"))
            context.held.add("world/run_until")
            client.writer.write(b"d\r\nrun_until (t_s 9)\r\nd\r\necho 7\r\n")
            await until(lambda: context.calls)
            await asyncio.sleep(0.05)
            assert [call.service for call in context.calls] == ["world/run_until"]
            context.calls[0].finish(Reply(0, 0, {"tick": 3}))
            answers = [await client.reader.readline() for _ in range(4)]
            assert answers == [b"[ok] (tick 3)\r\n", b"<ACK>\r\n", b"[ok] 7\r\n", b"<ACK>\r\n"]
            assert "run_until (t_s float)" in await client.ask("d", "help")
            assert 'did you mean \\"pause\\"' in await client.ask("d", "pausse")
            client.close()

    run(story)


def test_administration() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            admin = await Client.text(port("rov/imu:o"))
            assert await admin.ask("a", "[list] [in]") == '"/me"'
            own = await admin.ask("a", "[list] [in] /me")
            assert own == '(from "/me") (to "/uwserver/rov/imu:o") (carrier text_ack)'
            assert await admin.ask("a", "[list] [out]") == ""
            assert (await admin.ask("a", "[help]")).startswith("[many]")
            assert (await admin.ask("a", "[pray]")).startswith("[fail]")
            assert (await admin.ask("a", "[del] /nobody")).startswith("-1")
            assert "/uwserver/rov/imu:o" in await admin.ask("*")
            assert "not understood" in await admin.ask("x")
            admin.close()

    run(story)


class Sink:
    """A port of somebody else, which keeps what comes."""

    def __init__(self, greeting: bytes) -> None:
        self.greeting = greeting
        self.came = b""
        self.ended = False

    async def open(self) -> asyncio.Server:
        return await asyncio.start_server(self._serve, "127.0.0.1", 0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(self.greeting)
        while data := await reader.read(1 << 16):
            self.came += data
        self.ended = True
        writer.close()


@pytest.mark.parametrize(
    ("carrier", "greeting", "first"),
    [
        ("tcp", b"YA\1\2\0\0RP", b"YA\xe4\x1e\0\0RP\x14\0\0\0/uwserver/rov/imu:o\0"),
        ("fast_tcp", b"YA\1\2\0\0RP", b"YA\x64\x1e\0\0RP\x14\0\0\0/uwserver/rov/imu:o\0"),
        ("text_ack", b"Welcome /uwserver/rov/imu:o\r\n", b"CONNACK /uwserver/rov/imu:o\r\n"),
        ("text", b"Welcome /uwserver/rov/imu:o\r\n", b"CONNECT /uwserver/rov/imu:o\r\n"),
    ],
)
def test_yarp_connect_and_disconnect(carrier: str, greeting: bytes, first: bytes) -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        sink = Sink(greeting)
        theirs = await sink.open()
        server.names["/r"] = ("127.0.0.1", theirs.sockets[0].getsockname()[1])
        async with serving(table(server), context) as port:
            admin = await Client.text(port("rov/imu:o"))
            assert (
                await admin.ask("a", f'[add] "{carrier}://r"')
                == f'0 "Added connection from /uwserver/rov/imu:o to {carrier}://r"'
            )
            assert await admin.ask("a", "[list] [out]") == '"/r"'
            assert f"(carrier {carrier})" in await admin.ask("a", "[list] [out] /r")
            assert context.subscriptions == {IMU.path}
            context.emit()
            await until(lambda: b"f_S" in sink.came)
            assert sink.came.startswith(first)
            assert (await admin.ask("a", "[del] /r")).startswith('0 "Removed connection')
            await until(lambda: sink.ended)
            assert await admin.ask("a", "[list] [out]") == ""
            assert context.subscriptions == frozenset()
            admin.close()
        theirs.close()
        await theirs.wait_closed()

    run(story)


def test_addresses_of_others_are_connected_to_within_allowed_hosts_only(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        server.names |= {"/far": ("10.1.2.3", 80), "/closed": ("127.0.0.1", 1), "/named": ("evil.example", 80)}
        dialled = []
        loop = asyncio.get_running_loop()
        create = loop.create_connection

        async def seen(make, host=None, port=None, **more):  # type: ignore[no-untyped-def]
            dialled.append((host, port))
            return await create(make, host, port, **more)

        async with serving(table(server), context) as port:
            admin = await Client.text(port("rov/imu:o"))
            monkeypatch.setattr(loop, "create_connection", seen)
            for name in ("/far", "/named"):
                assert "allowed_hosts" in await admin.ask("a", f"[add] {name}")
            assert "Do not know how to connect" in await admin.ask("a", "[add] /nobody")
            assert "no carrier udp" in await admin.ask("a", "[add] /closed udp")
            assert "no name of a port" in await admin.ask("a", '[add] "/a b"')
            assert {address for address in dialled if address != ("127.0.0.1", server.port)} == set()
            assert "Cannot connect" in await admin.ask("a", "[add] /closed")
            assert ("127.0.0.1", 1) in dialled
            admin.close()
            thrusters = await Client.text(port("rov/thrusters:i"))
            assert "Outputs not allowed" in await thrusters.ask("a", "[add] /closed")
            thrusters.close()

    run(story)


@pytest.mark.parametrize("carrier", ["tcp", "fast_tcp", "text_ack", "text"])
def test_what_listens_there_and_is_no_port_is_told(carrier: str) -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        theirs = await Sink(b"SSH-2.0-x\r\n").open()
        server.names["/r"] = ("127.0.0.1", theirs.sockets[0].getsockname()[1])
        async with serving(table(server), context) as port:
            admin = await Client.text(port("rov/imu:o"))
            assert "no port of YARP" in await admin.ask("a", f"[add] /r {carrier}")
            assert await admin.ask("a", "[list] [out]") == ""
            admin.close()
        theirs.close()
        await theirs.wait_closed()

    run(story)


def test_who_greets_nobody_hears_no_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(links, "ANSWER_S", 0.3)

    async def story(context: FakeContext, server: NameServer) -> None:
        sink = Sink(b"")
        theirs = await sink.open()
        server.names["/r"] = ("127.0.0.1", theirs.sockets[0].getsockname()[1])
        async with serving(table(server), context) as port:
            admin = await Client.text(port("rov/imu:o"))
            assert "did not answer" in await admin.ask("a", "[add] /r text")
            assert context.subscriptions == frozenset()
            await until(lambda: sink.ended)
            assert sink.came == b"CONNECT /uwserver/rov/imu:o\r\n"
            admin.close()
        theirs.close()
        await theirs.wait_closed()

    run(story)


def test_a_json_text_too_deep_is_told_and_the_next_call_answered() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server), context) as port:
            client = await Client.binary(port("world/rpc:i"), READY)
            index = b"YA\x0a\0\0\0RP\2\1" + b"\xff" * 8
            for text, word in (
                ("[" * 100_000, b"texts of a bottle"),
                ("[" * 40_000, b"maps and lists"),
                ("[7]", b"ok"),
            ):
                bottle = to_binary(["echo", text])
                client.writer.write(index + struct.pack("<iii", 8, len(bottle), 0) + b"\0\0\0\0~d\0\1" + bottle)
                assert word in await client.reader.readuntil(b"YA\0\0\0\0RP")
            assert context.stats.errors == 2
            client.close()

    run(story)


def test_who_floods_is_refused_and_read_later() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server, max_requests_per_s=10), context) as port:
            client = await Client.text(port("rov/thrusters:i"))
            client.writer.write(b"D\r\n1 2\r\n" * 50)
            for _ in range(10):
                await client.reader.readline()
            await until(lambda: "more than 10 messages a second" in context.stats.last_error)
            client.close()

    run(story)


def test_who_has_said_nothing_valid_takes_no_place_and_is_ended_in_time() -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        async with serving(table(server, max_clients=1, hello_timeout_s=0.3), context) as port:
            reader, silent = await asyncio.open_connection("127.0.0.1", port("rov/imu:o"))
            client = await Client.text(port("rov/depth:o"))
            late, writer = await asyncio.open_connection("127.0.0.1", port("world/rpc:i"))
            writer.write(b"CONNECT /late\r\nd\r\npause\r\n")
            assert b"1 clients are connected" in await late.read()
            assert b"nothing valid" in await reader.read()
            assert not context.calls
            assert await client.ask("a", "[ver]") == "[ver] 1 2 3"
            for each in (silent, client.writer, writer):
                each.transport.abort()

    run(story)


@pytest.mark.parametrize(
    ("more", "text"), [({"bind": "0.0.0.0"}, "allow_network"), ({"bind": "0.0.0.0", "allow_network": True}, "host =")]
)
def test_networks_are_served_only_when_that_is_said(more: dict[str, object], text: str) -> None:
    async def story(context: FakeContext, server: NameServer) -> None:
        with pytest.raises(CannotListen, match=text):
            async with serving(structs.replace(table(server), **more), context):
                pass

    run(story)


def test_addresses_and_names() -> None:
    assert server_of("10.0.0.1:10000") == ("10.0.0.1", 10000)
    assert server_of("[::1]:10000") == ("::1", 10000)
    for wrong in ("10.0.0.1", "10.0.0.1:x", ":1", "a:0", "a:70000"):
        with pytest.raises(CannotServe):
            server_of(wrong)
    assert target_of("tcp://r") == target_of("tcp:/r") == ("tcp", "/r")
    assert target_of("/a/b:i") == ("", "/a/b:i")
    assert target_of("fast_tcp+send.x://r") == ("fast_tcp", "/r")
    for wrong in ("", "/", "/a b", "/a\nregister /x"):
        with pytest.raises(Refused):
            target_of(wrong)
    assert may_connect("127.0.0.9", ())
    assert may_connect("robot", ("robot",))
    assert not may_connect("10.0.0.1", ("robot",))
