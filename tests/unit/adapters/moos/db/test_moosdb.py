"""Our MOOSDB on a socket: greeting, names, timing, synchronous clients, slow and silent ones, and the world as a client of it."""

from __future__ import annotations

import asyncio
import json
import struct
from pathlib import Path

import msgspec
import pytest
from uwserver_adapters.moos import MoosDbAdapter, wire
from uwserver_adapters.moos.bridge.bridge import CALLS_PER_S, STATES_PER_S, Bridge
from uwserver_adapters.moos.bridge.quota import FAULTS_PER_S
from uwserver_adapters.moos.config import BridgeTable, MoosDbConfig, NavTable, Target
from uwserver_adapters.moos.db import guests, local
from uwserver_adapters.moos.db.database import Database
from uwserver_adapters.moos.db.variable import Letter
from uwserver_adapters.moos.wire import MoosMessage

from uwserver.adapter import CannotListen, CannotServe, log_file
from uwserver.ports import Sample

POSE = Sample("auv/truth/pose", 0, 0, 0, True, ((10.0, 20.0, 5.0), (1.0, 0.0, 0.0, 0.0)))


@pytest.fixture
def tank(make_auv, serve):
    def make(**config):
        bridge = config.pop("bridge", BridgeTable())
        config = MoosDbConfig(**{"port": 0, "community": "tank", "bridge": bridge, **config})
        return serve(MoosDbAdapter(config, make_auv()))

    return make


async def test_greeting_tells_community_and_skew(tank, connect):
    async with tank() as context:
        client = await connect(context.stats.address)
        (welcome,) = client.others
        assert (welcome.type, welcome.text, welcome.community) == ("W", "asynchronous", "tank")
        assert welcome.src_aux.startswith("hostname=")
        assert welcome.number == pytest.approx(welcome.time - 1.0)  # the client's greeting says that its time is 1
        assert context.stats.peers == 1
        await client.close()


async def test_two_clients_talk(tank, connect):
    async with tank() as context:
        a, b = await connect(context.stats.address, "a"), await connect(context.stats.address, "b")
        b.register("X", "TEXT", "BLOB")
        a.notify(X=1.5, TEXT="ä", BLOB=b"\x00\xff")
        assert [(await b.hear(key)).value for key in ("X", "TEXT", "BLOB")] == [1.5, "ä", b"\x00\xff"]
        a.notify(X=2.5)
        message = await b.hear("X")
        assert (message.value, message.src, message.community) == (2.5, "a", "tank")
        await a.close()
        await b.close()


async def test_what_came_in_one_packet_leaves_in_one(tank, connect):
    async with tank() as context:
        a, b = await connect(context.stats.address, "a"), await connect(context.stats.address, "b")
        b.wildcard("V*")
        a.register("DB_CLIENTS")
        await a.hear("DB_CLIENTS")
        a.notify(V1=1.0, V2=2.0, V3=3.0)
        await b.read()
        assert [m.key for m in b.mail] == ["V1", "V2", "V3"]
        await a.close()
        await b.close()


async def test_much_mail_leaves_in_packets_that_clients_can_hold(tank, connect, monkeypatch):
    """C++ clients throw away what is more than 2048 unread messages."""
    monkeypatch.setattr(guests, "TOGETHER", 2)
    monkeypatch.setattr("uwserver_adapters.moos.db.local.TELL_S", 60.0)
    sizes = []
    pack = wire.packet
    monkeypatch.setattr(wire, "packet", lambda messages: sizes.append(len(messages)) or pack(messages))
    async with tank() as context:
        a, b = await connect(context.stats.address, "a"), await connect(context.stats.address, "b")
        b.wildcard("V*")
        a.register("DB_CLIENTS")
        await a.hear("DB_CLIENTS")
        before, sizes[:] = context.stats.samples_sent, []
        a.notify(V1=1.0, V2=2.0, V3=3.0, V4=4.0, V5=5.0)
        await b.until(lambda c: len(c.mail) == 5)
        assert sizes[0] == 5, "of the client"
        assert (max(sizes[1:]), sum(sizes[1:])) == (2, 5)
        assert context.stats.samples_sent - before == 5
        await a.close()
        await b.close()


async def test_the_heartbeat_is_echoed_with_the_databases_time(tank, connect):
    async with tank(warp=10.0) as context:
        client = await connect(context.stats.address)
        client.others.clear()
        client.send(MoosMessage(wire.TIMING, wire.TIMING_KEY, 0.0, time=5.0))
        await client.until(lambda c: c.others)
        (echo,) = client.others
        assert (echo.type, echo.key, echo.time, echo.number2) == ("T", "_async_timing", 5.0, 0.0)
        assert echo.number > 10 * 1.7e9  # warped
        await client.close()


async def test_a_second_client_of_a_name_is_poisoned(tank, connect):
    async with tank() as context:
        first = await connect(context.stats.address, "x")
        for name in ("x", "uwserver", "MOOSDB_tank"):
            second = await connect(context.stats.address, name)
            (poison,) = second.others
            assert (poison.type, poison.text) == ("K", f'A client of this name ("{name}") already exists')
            with pytest.raises(ConnectionError):
                await second.read()
            await second.close()
        first.notify(X=1.0)
        first.register("X")
        assert (await first.hear("X")).value == 1.0
        await first.close()


async def test_a_name_is_free_again(tank, connect, until):
    async with tank() as context:
        first = await connect(context.stats.address, "x")
        await first.close()
        await until(lambda: context.stats.peers == 0, "it went")
        second = await connect(context.stats.address, "x")
        assert second.others[0].type == "W"
        await second.close()


@pytest.mark.parametrize("name", ["", "x" * 129])
async def test_a_name_that_is_none_is_poisoned(tank, connect, name):
    async with tank() as context:
        client = await connect(context.stats.address, name)
        assert client.others[0].type == "K"
        await client.close()


async def test_too_many_clients(tank, connect):
    async with tank(max_clients=1) as context:
        first = await connect(context.stats.address, "a")
        second = await connect(context.stats.address, "b")
        assert second.others[0].type == "K"
        assert "max_clients" in second.others[0].text
        await second.close()
        await first.close()


async def test_a_synchronous_client_gets_one_packet_for_each_of_its_own(tank, connect):
    async with tank() as context:
        sync = await connect(context.stats.address, "old", key="")
        writer = await connect(context.stats.address, "a")
        sync.others.clear()
        sync.register("X")
        await sync.read()
        assert [m.type for m in sync.others] == ["."]
        writer.notify(X=1.0)
        writer.notify(X=2.0)
        writer.register("X")
        await writer.hear("X")
        assert not sync.mail
        sync.send(MoosMessage(wire.NULL, ""))
        await sync.read()
        assert [m.value for m in sync.mail] == [1.0, 2.0]
        assert sync.others[-1].number > 1.7e9
        await sync.close()
        await writer.close()


async def test_a_synchronous_client_that_never_asks_keeps_the_newest_mail(tank, connect, monkeypatch):
    monkeypatch.setattr(guests, "HELD", 3)
    async with tank(queue_bytes=1000) as context:
        sync, writer = await connect(context.stats.address, "old", key=""), await connect(context.stats.address, "a")
        sync.register("X", "BIG")
        await sync.read()
        for k in range(5):
            writer.notify(X=float(k))
        writer.register("X")
        await writer.until(lambda c: c.last("X") == 4.0)
        sync.send(MoosMessage(wire.NULL, ""))
        await sync.read()
        assert [m.value for m in sync.mail] == [2.0, 3.0, 4.0]
        monkeypatch.setattr(guests, "HELD", 100)
        for _ in range(3):
            writer.notify(BIG="x" * 400)
        writer.notify(X=9.0)
        await writer.until(lambda c: c.last("X") == 9.0)
        sync.mail.clear()
        sync.send(MoosMessage(wire.NULL, ""))
        await sync.read()
        assert [m.key for m in sync.mail] == ["BIG", "BIG", "X"]
        assert context.stats.dropped == 3
        await sync.close()
        await writer.close()


async def test_a_synchronous_client_that_asks_and_reads_nothing_is_disconnected(tank, connect, until):
    async with tank(queue_bytes=50_000) as context:
        sync, writer = await connect(context.stats.address, "old", key=""), await connect(context.stats.address, "a")
        writer.notify(BIG="x" * 20_000)
        sync.register("BIG")
        await sync.read()
        sync.writer.transport.pause_reading()
        for _ in range(1000):
            if context.stats.peers == 1:
                break
            writer.notify(BIG="x" * 20_000)
            sync.send(MoosMessage(wire.NULL, ""))
            await asyncio.sleep(0.001)
        await until(lambda: context.stats.peers == 1, "it is still there")
        assert "read faster" in context.stats.last_error
        await sync.close()
        await writer.close()


async def test_costly_requests_let_others_have_their_turn(tank, connect, monkeypatch):
    """A packet full of requests; another client's heartbeat is echoed before all of them are answered."""
    monkeypatch.setattr("uwserver.adapter.connection.TURN_S", 0.0)
    asked = []
    answer = Database.steps

    def steps(self, name, message):
        asked.extend([name] if message.type == wire.SERVER_REQUEST else [])
        yield from answer(self, name, message)

    monkeypatch.setattr(Database, "steps", steps)
    async with tank() as context:
        greedy, other = await connect(context.stats.address, "greedy"), await connect(context.stats.address, "other")
        greedy.send(*[MoosMessage(wire.SERVER_REQUEST, "ALL", id=-2)] * 2000)
        while not asked:
            await asyncio.sleep(0)
        other.others.clear()
        other.send(MoosMessage(wire.TIMING, wire.TIMING_KEY, 0.0, time=5.0))
        await other.until(lambda c: c.others)
        assert len(asked) < 2000
        await greedy.close()
        await other.close()


async def test_notifications_of_a_packet_stay_together_however_long_they_take(tank, connect, monkeypatch):
    monkeypatch.setattr("uwserver.adapter.connection.TURN_S", 0.0)
    bridge = BridgeTable(commands={
        name: (Target(port="thrusters", field="u", full=full),)
        for name, full in (("DESIRED_THRUST_L", (1.0, 0.0)), ("DESIRED_THRUST_R", (0.0, 1.0)))
    })  # fmt: skip
    async with tank(bridge=bridge) as context:
        client = await connect(context.stats.address, "a")
        client.register("DESIRED_THRUST_R")
        client.notify(DESIRED_THRUST_L=50.0, DESIRED_THRUST_R=25.0)
        await client.hear("DESIRED_THRUST_R")
        await asyncio.sleep(0)
        assert [c.value for c in context.commands] == [((0.5, 0.25),)]
        await client.close()


async def test_a_packet_of_many_writes_lets_others_have_their_turn(tank, connect, monkeypatch):
    """2048 writes: another client's heartbeat is echoed before all of them are taken; none is lost, and their order is kept. No step
    takes more than so many of them."""
    monkeypatch.setattr("uwserver.adapter.connection.TURN_S", 0.0)
    taken: list[float] = []
    in_a_step: list[int] = []
    write, step = Database.write, guests.Guest.step

    def measured(self):
        before = len(taken)
        more = step(self)
        in_a_step.append(len(taken) - before)
        return more

    monkeypatch.setattr(guests.Guest, "step", measured)

    def count(self, message):
        if message.key == "FLOOD":
            taken.append(message.number)
        return write(self, message)

    monkeypatch.setattr(Database, "write", count)
    async with tank() as context:
        greedy, other = await connect(context.stats.address, "greedy"), await connect(context.stats.address, "other")
        greedy.send(*(wire.notify("FLOOD", float(k), 2e9, "greedy") for k in range(wire.MESSAGES_LIMIT)))
        await asyncio.sleep(0.01)
        other.others.clear()
        other.send(MoosMessage(wire.TIMING, wire.TIMING_KEY, 0.0, time=5.0))
        await other.until(lambda c: c.others)
        assert len(taken) < wire.MESSAGES_LIMIT
        other.register("FLOOD")
        await other.until(lambda c: c.last("FLOOD") == wire.MESSAGES_LIMIT - 1.0)
        assert taken == list(map(float, range(wire.MESSAGES_LIMIT)))
        assert max(in_a_step) <= guests.AT_ONCE
        await greedy.close()
        await other.close()


async def test_writes_that_many_hear_are_few_in_a_step(tank, connect, monkeypatch):
    """A packet of 256 writes that a hundred clients hear took 8 ms."""
    delivered = []
    step, deliver = guests.Guest.step, guests.Guest.deliver
    in_a_step: list[int] = []

    def measured(self):
        delivered.clear()
        more = step(self)
        in_a_step.append(len(delivered))
        return more

    monkeypatch.setattr(guests.Guest, "step", measured)
    monkeypatch.setattr(guests.Guest, "deliver", lambda self, letter: (delivered.append(1), deliver(self, letter)))
    async with tank() as context:
        clients = [await connect(context.stats.address, f"c{n}") for n in range(20)]
        for client in clients:
            client.others.clear()
            client.register("MANY")
            client.send(MoosMessage(wire.TIMING, wire.TIMING_KEY, 0.0, time=5.0))
            await client.until(lambda c: c.others)
        in_a_step.clear()
        clients[0].send(*(wire.notify("MANY", float(k), 2e9, "c0") for k in range(200)))
        for client in clients:
            await client.until(lambda c: c.last("MANY") == 199.0)
        assert sum(in_a_step) >= 200 * 20
        assert max(in_a_step) <= guests.SPENT // 3 + 20
        for client in clients:
            await client.close()


def test_large_mail_leaves_in_packets_of_bounded_size():
    """A thousand values of 60 kB in one packet were 60 MB to join, while nobody else had the interpreter."""
    letters = [Letter(wire.notify(f"V{n}", "x" * 60_000, 0.0, "a")) for n in range(50)]
    batch = guests.Batch(letters)
    assert sum(messages for _, messages in batch.packets) == 50
    assert max(len(packet) for packet, _ in batch.packets) <= guests.TOGETHER_BYTES + 100
    (alone,) = guests.Batch([Letter(wire.notify("V", "x" * (1 << 19), 0.0, "a"))]).packets
    assert alone[1] == 1


async def test_the_world_takes_a_flood_in_turns_and_loses_nothing(tank, connect, until, monkeypatch):
    monkeypatch.setattr("uwserver.adapter.turns.TURN_S", 0.0)
    bridge = BridgeTable(commands={"DESIRED_THRUST": (Target(port="propeller", field="u", full=1.0),)})
    taken: list[int] = []
    async with tank(bridge=bridge) as context:
        take = Bridge.take
        monkeypatch.setattr(
            Bridge, "take", lambda self, mail, *rest: (taken.append(len(mail)), take(self, mail, *rest))[1]
        )
        client = await connect(context.stats.address, "a")
        client.send(*(wire.notify("DESIRED_THRUST", k / 1000.0, 2e9, "a") for k in range(2000)))
        await until(lambda: sum(taken) == 2000, "all are taken")
        assert max(taken) <= local.AT_ONCE
        assert context.commands[-1].value == ((pytest.approx(0.01999),),)
        await client.close()


async def test_a_flood_of_resets_and_calls_is_bounded_and_other_clients_hear_little_of_it(tank, connect):
    """Of 2000 of each within a second few are carried out, and few refusals are mailed to those who listen."""
    async with tank() as context:
        flood, helm = await connect(context.stats.address, "flood"), await connect(context.stats.address, "helm")
        helm.register("UWSERVER_ERROR", "UWSERVER_REPLY", "DONE")
        for start in range(0, 2000, 100):
            writes = range(start, start + 100)
            flood.send(
                *(wire.notify("USM_RESET", f"x={k}", 2e9, "flood") for k in writes),
                *(wire.notify("UWSERVER_CALL", f"{k} world/echo", 2e9, "flood") for k in writes),
            )
        flood.notify(DONE=1.0)
        await helm.hear("DONE")
        helm.notify(UWSERVER_CALL="mine world/echo")
        await helm.until(lambda c: any(m.key == "UWSERVER_REPLY" and '"mine"' in m.text for m in c.mail))
        seconds = 2  # the flood may fall into two windows
        assert len(context.commands) <= STATES_PER_S * seconds
        mailed = [m.key for m in helm.mail]
        assert mailed.count("UWSERVER_ERROR") <= 2 * seconds
        assert mailed.count("UWSERVER_REPLY") <= (CALLS_PER_S + 1) * seconds + 1
        await flood.close()
        await helm.close()


async def test_a_flood_of_writes_that_are_refused_is_told_sparingly(tank, connect):
    async with tank() as context:
        flood, helm = await connect(context.stats.address, "flood"), await connect(context.stats.address, "helm")
        helm.register("DB_REFUSED", "DONE")
        flood.notify(X=1.0)
        flood.send(*(wire.notify("X", "text", 2e9, "flood") for _ in range(1000)))
        flood.notify(DONE=1.0)
        await helm.hear("DONE")
        assert 1 <= [m.key for m in helm.mail].count("DB_REFUSED") <= 2 * FAULTS_PER_S
        await flood.close()
        await helm.close()


async def test_bytes_that_are_no_text_are_told_and_harm_nobody(tank, connect):
    """Names and values that are no UTF-8 go through to other clients as they are; what the world says of them is JSON."""
    bridge = BridgeTable(commands={"DESIRED_THRUST": (Target(port="propeller", field="u", full=1.0),)})
    async with tank(bridge=bridge) as context:
        odd, good = await connect(context.stats.address, "a"), await connect(context.stats.address, "good")
        good.register("DESIRED_THRUST", "UWSERVER_ERROR", "UWSERVER_REPLY")
        odd.send(MoosMessage(wire.NOTIFY, "DESIRED_THRUST", data=b"\xff", kind=wire.STRING, src="\udcfe", time=2e9))
        assert (await good.hear("DESIRED_THRUST")).data == b"\xff"
        error = json.loads((await good.hear("UWSERVER_ERROR")).text)
        assert (error["value"], error["src"], error["code"]) == ("\ufffd", "\ufffd", "bad_argument")
        odd.send(MoosMessage(wire.NOTIFY, "UWSERVER_CALL", data=b"\xff\xfe world/echo", kind=wire.STRING, time=2e9))
        assert json.loads((await good.hear("UWSERVER_REPLY")).text)["id"] == "\ufffd\ufffd"
        await odd.close()
        await good.close()


async def test_a_client_whose_name_is_no_utf_8_is_named_readably(tank, connect, until):
    async with tank() as context:
        client = await connect(context.stats.address, "x")
        reader, writer = await asyncio.open_connection(*context.stats.address.split(":"))
        hello = MoosMessage(wire.DATA, wire.ASYNCHRONOUS, data=b"n\xff", kind=wire.STRING, time=1.0)
        writer.write(wire.HELLO + wire.packet([wire.encode(hello)]) + struct.pack("<iiB", 4, 1, 0))
        await asyncio.wait_for(reader.read(), 60.0)
        await until(lambda: context.stats.errors, "told")
        assert msgspec.json.encode(context.stats.last_error).startswith('"n\ufffd: a packet of 4 bytes'.encode())
        writer.close()
        await client.close()


async def test_a_silent_client_is_disconnected(tank, connect, monkeypatch):
    monkeypatch.setattr("uwserver_adapters.moos.db.local.TELL_S", 0.05)
    async with tank(client_timeout_s=1.5) as context:
        silent, lively = await connect(context.stats.address, "silent"), await connect(context.stats.address, "lively")
        while context.stats.peers == 2:
            lively.send(MoosMessage(wire.TIMING, wire.TIMING_KEY, 0.0, time=5.0))
            await asyncio.sleep(0.05)
        with pytest.raises(ConnectionError):
            await silent.read()
        assert context.stats.peers == 1
        assert "silent" in context.stats.last_error
        await silent.close()
        await lively.close()


async def test_who_says_no_name_is_disconnected(tank, monkeypatch):
    monkeypatch.setattr("uwserver_adapters.moos.db.local.TELL_S", 0.02)
    monkeypatch.setattr(guests, "NAME_S", 0.1)
    async with tank() as context:
        host, port = context.stats.address.split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(wire.HELLO)
        assert b"nothing valid came within 0.1 s" in await asyncio.wait_for(reader.read(), 60.0)
        writer.close()
        assert context.stats.details["refused"] == {"timeout": 1}


@pytest.mark.parametrize(
    "bad",
    [
        wire.HELLO + struct.pack("<iiB", 2**31 - 1, 1, 0),
        wire.HELLO + struct.pack("<iiB", 4, 1, 0),
        wire.HELLO + struct.pack("<iiB", 9, 1, 0),
        wire.HELLO + struct.pack("<iiB", 60, 1, 0) + b"\xff" * 51,
        wire.HELLO + struct.pack("<iiB", 9, 0, 1),
    ],
)
async def test_what_is_no_moos_ends_that_connection_alone(tank, connect, bad):
    async with tank() as context:
        good = await connect(context.stats.address, "good")
        host, port = context.stats.address.split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(bad)
        assert await asyncio.wait_for(reader.read(), 60.0) == b""
        writer.close()
        good.notify(X=1.0)
        good.register("X")
        assert (await good.hear("X")).value == 1.0
        assert context.stats.errors == 1
        await good.close()


async def test_who_reads_nothing_is_disconnected_and_nobody_waits(tank, connect, until):
    async with tank(queue_bytes=100_000) as context:
        sleeper, writer = (
            await connect(context.stats.address, "sleeper"),
            await connect(context.stats.address, "writer"),
        )
        sleeper.wildcard("BIG")
        sleeper.writer.transport.pause_reading()
        writer.register("PONG")
        for k in range(400):
            if context.stats.peers == 1:
                break
            writer.notify(BIG="x" * 50_000, PONG=float(k))
            assert (await writer.hear("PONG")).value == float(k)
        await until(lambda: context.stats.peers == 1, "the sleeper is still there")
        assert "read faster" in context.stats.last_error
        await sleeper.close()
        await writer.close()


async def test_the_world_is_a_client(tank, connect):
    bridge = BridgeTable(nav=NavTable(), commands={"DESIRED_THRUST": (Target(port="propeller", field="u", full=1.0),)})
    async with tank(bridge=bridge) as context:
        client = await connect(context.stats.address, "pHelmIvP")
        client.wildcard("NAV_*")
        client.register("SIMULATION_MODE", "DB_CLIENTS", "UWSERVER_REPLY")
        assert (await client.hear("SIMULATION_MODE")).value == "TRUE"
        context.put([POSE])
        assert (await client.hear("NAV_X")).value == 20.0
        client.notify(DESIRED_THRUST=50.0)
        client.notify(UWSERVER_CALL="1 world/echo")
        assert json.loads((await client.hear("UWSERVER_REPLY")).text)["id"] == "1"
        assert [(c.port, c.value) for c in context.commands] == [("auv/propeller", ((0.5,),))]
        await client.until(
            lambda c: "pHelmIvP" in str(c.last("DB_CLIENTS")) and "uwserver" in str(c.last("DB_CLIENTS"))
        )
        await client.close()


async def test_a_vehicle_that_comes_later_is_obeyed(tank, connect, until):
    async with tank() as context:
        client = await connect(context.stats.address, "a")
        port = msgspec.structs.replace(context.ports["auv/propeller"], path="rov/propeller")
        context.set_ports([*context.ports.values(), port])
        client.notify(ROV_PROPELLER_U=0.5)
        await until(lambda: context.commands, "a command")
        assert [(c.port, c.value) for c in context.commands] == [("rov/propeller", ((0.5,),))]
        await client.close()


async def test_a_type_clash_is_told(tank, connect):
    async with tank() as context:
        client = await connect(context.stats.address, "a")
        client.register("DB_REFUSED")
        client.notify(X=1.0)
        client.notify(X="text")
        assert (
            await client.hear("DB_REFUSED")
        ).text == "client=a,variable=X,reason=a write as string, its type is double"
        await client.close()


async def test_the_log_has_all_that_went_through(tank, connect, tmp_path: Path):
    path = tmp_path / "tank.alog"
    async with tank(bridge=BridgeTable(alog=str(path), nav=NavTable())) as context:
        client = await connect(context.stats.address, "a")
        client.notify(X=1.5, TEXT="two\nlines", BLOB=b"\x00\xff")
        client.register("X")
        await client.hear("X")
        context.put([POSE])
        await client.close()
    lines = path.read_text().splitlines()
    assert lines[0] == "%" * 80
    rows = [line.split(None, 3) for line in lines if not line.startswith("%")]
    found = {name: (source, value.strip()) for _, name, source, value in rows}
    assert found["X"] == ("a", "1.5")
    assert found["TEXT"] == ("a", "two lines")
    assert found["BLOB"] == ("a", "<binary> 2 bytes")
    assert found["NAV_X"] == ("uwserver", "20")


async def test_the_log_is_on_disk_before_the_end(tank, connect, until, tmp_path: Path, monkeypatch):
    """Who kills the server keeps the log."""
    monkeypatch.setattr(log_file, "FLUSH_S", 0.02)
    path = tmp_path / "tank.alog"
    async with tank(bridge=BridgeTable(alog=str(path))) as context:
        client = await connect(context.stats.address, "a")
        client.notify(X=1.5)
        await until(lambda: " 1.5\n" in path.read_text(), "the line is in the file")
        await client.close()


async def test_an_earlier_log_is_kept(tank, tmp_path: Path):
    path = tmp_path / "tank.alog"
    for text in ("first", "second"):
        path.write_text(text)
        async with tank(bridge=BridgeTable(alog=str(path))):
            pass
    assert path.read_text().startswith("%")
    assert [(tmp_path / f"tank_{k}.alog").read_text() for k in (1, 2)] == ["first", "second"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
async def test_a_full_disk_ends_the_log_alone(tank, connect, until, monkeypatch):
    monkeypatch.setattr(log_file, "FLUSH_S", 0.02)
    async with tank(bridge=BridgeTable(alog="/dev/full")) as context:
        await until(lambda: "the log /dev/full ends" in context.stats.last_error, "told")
        client = await connect(context.stats.address, "a")
        client.notify(X="x" * 100_000)
        client.register("X")
        assert len((await client.hear("X")).data) == 100_000
        await client.close()


async def test_a_table_that_does_not_fit_makes_no_log(make_auv, tmp_path: Path):
    """The server tries it again and again."""
    path = tmp_path / "x.alog"
    bridge = BridgeTable(alog=str(path), nav=NavTable(position="gps"))
    with pytest.raises(CannotServe):
        await MoosDbAdapter(MoosDbConfig(port=0, bridge=bridge), make_auv()).run(asyncio.Event())
    assert not path.exists()


async def test_a_log_that_cannot_be_opened_is_named(make_auv, tmp_path: Path):
    config = MoosDbConfig(port=0, bridge=BridgeTable(alog=str(tmp_path / "none" / "x.alog")))
    with pytest.raises(OSError, match=r"x\.alog"):
        await MoosDbAdapter(config, make_auv()).run(asyncio.Event())


async def test_an_address_that_is_taken_is_named(tank, make_auv):
    async with tank() as context:
        port = int(context.stats.address.split(":")[1])
        with pytest.raises(CannotListen, match="is in use, perhaps by a MOOSDB"):
            await MoosDbAdapter(MoosDbConfig(port=port), make_auv()).run(asyncio.Event())
