"""The client adapter against a database: joining, leaving, rejoining, clocks."""

from __future__ import annotations

import asyncio
import json
import socket
from datetime import datetime, timezone

import msgspec
import pytest
from msgspec.structs import replace
from uwserver_adapters.moos import MoosAdapter, MoosDbAdapter, wire
from uwserver_adapters.moos.bridge import client
from uwserver_adapters.moos.clock import DatabaseClock, MoosClock
from uwserver_adapters.moos.config import BridgeTable, CommunityTable, MoosConfig, MoosDbConfig, NavTable, Target
from uwserver_adapters.moos.wire import MoosMessage

from uwserver.adapter import CannotServe, InputTurns
from uwserver.ports import Sample

POSE = Sample("auv/truth/pose", 0, 0, 0, True, ((10.0, 20.0, 5.0), (1.0, 0.0, 0.0, 0.0)))
COMMANDS = {"DESIRED_THRUST": (Target(port="propeller", field="u", full=1.0),)}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def database(make_auv, serve):
    """A MOOSDB that knows no world."""
    return lambda port=0, **config: serve(
        MoosDbAdapter(
            MoosDbConfig(port=port, community="tank", bridge=BridgeTable(publish=(), usm=False, services=False), **config),
            make_auv(),
        )
    )  # fmt: skip


@pytest.fixture
def join(make_auv, serve):
    """The adapter as a client called "sim"."""

    def make(port: int, **config):
        table = CommunityTable(port=port, client="sim", nav=NavTable(), commands=COMMANDS)
        return serve(MoosAdapter(MoosConfig(communities={"main": table}, **config), make_auv()))

    return make


def port_of(context) -> int:
    return int(context.stats.address.rpartition(":")[2])


async def test_samples_out_commands_in(database, join, connect, until):
    async with database() as db, join(port_of(db)) as context:
        await until(lambda: context.stats.peers == 1, "joined")
        helm = await connect(db.stats.address, "pHelmIvP")
        helm.wildcard("NAV_*")
        helm.register("SIMULATION_MODE")
        assert (await helm.hear("SIMULATION_MODE")).value == "TRUE"
        context.put([POSE])
        message = await helm.hear("NAV_Y")
        assert (message.value, message.src, message.community) == (10.0, "sim", "tank")
        helm.notify(DESIRED_THRUST=50.0)
        await until(lambda: context.commands, "a command")
        assert [(c.port, c.value) for c in context.commands] == [("auv/propeller", ((0.5,),))]
        await helm.close()


async def test_a_vehicle_that_comes_later_is_obeyed(database, join, connect, until):
    async with database() as db, join(port_of(db)) as context:
        await until(lambda: context.stats.peers == 1, "joined")
        helm = await connect(db.stats.address, "pHelmIvP")
        port = msgspec.structs.replace(context.ports["auv/propeller"], path="rov/propeller")
        context.set_ports([*context.ports.values(), port])
        helm.notify(ROV_PROPELLER_U=0.5)
        await until(lambda: context.commands, "a command")
        assert [(c.port, c.value) for c in context.commands] == [("rov/propeller", ((0.5,),))]
        await helm.close()


async def test_any_start_order(database, join, connect, until):
    port = free_port()
    async with join(port) as context:
        assert context.stats.state == "running"
        await until(lambda: "it is tried again" in context.stats.last_error, "told that nobody is there")
        assert context.subscriptions == frozenset(), "nobody hears it"
        async with database(port):
            await until(lambda: context.stats.peers == 1, "joined")
            assert "auv/truth/pose" in context.subscriptions
        await until(lambda: context.stats.peers == 0, "noticed")
        assert context.subscriptions == frozenset()


async def test_after_a_restart_of_the_database_all_is_as_before(database, join, connect, until):
    port = free_port()
    async with join(port) as context:
        for _ in range(2):
            async with database(port) as db:
                await until(lambda: context.stats.peers == 1, "joined")
                helm = await connect(db.stats.address, "pHelmIvP")
                helm.register("NAV_X")
                context.put([POSE])
                assert (await helm.hear("NAV_X")).value == 20.0
                context.commands.clear()
                helm.notify(DESIRED_THRUST=25.0)
                await until(lambda: context.commands, "registered again")
                await helm.close()
            await until(lambda: context.stats.peers == 0, "noticed")


async def test_old_commands_that_the_database_kept_are_not_obeyed(database, join, connect, until):
    async with database() as db:
        helm = await connect(db.stats.address, "pHelmIvP")
        helm.notify(time=1e9, DESIRED_THRUST=50.0, DRIFT_X=0.5)
        helm.register("DESIRED_THRUST")
        await helm.hear("DESIRED_THRUST")
        async with join(port_of(db)) as context:
            await until(lambda: any(c.service == "world/set_current" for c in context.calls), "the current")
            assert not context.commands
            helm.notify(DESIRED_THRUST=60.0)
            await until(lambda: context.commands, "a new command")
            assert context.commands[0].value == ((0.6,),)
        await helm.close()


async def test_the_heart_beats_without_samples(database, join, until, monkeypatch):
    monkeypatch.setattr("uwserver_adapters.moos.db.local.TELL_S", 0.05)
    monkeypatch.setattr(client, "BEAT_S", 0.1)
    async with database(client_timeout_s=1.5) as db, join(port_of(db)) as context:
        await until(lambda: context.stats.peers == 1, "joined")
        await asyncio.sleep(2.0)
        assert db.stats.errors == 0
        assert context.stats.peers == 1


class Peer:
    """A listener that does as it is told."""

    def __init__(self, *answers: bytes) -> None:
        self.answers = list(answers)
        self.connections = 0
        self.heard = b""

    async def __aenter__(self) -> Peer:
        self.server = await asyncio.start_server(self._greet, "127.0.0.1", 0)
        self.port = self.server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self.server.close()

    async def _greet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self.heard += await reader.read(1000)
        if self.answers:
            writer.write(self.answers.pop(0))
        while await reader.read(1000):
            pass
        writer.close()


def packet(*messages: MoosMessage) -> bytes:
    return wire.packet([wire.encode(message) for message in messages])


WELCOME = packet(MoosMessage(wire.WELCOME, "", 0.0, b"asynchronous", community="tank"))


async def test_it_greets_as_a_client_does(join, until):
    async with Peer(WELCOME) as peer, join(peer.port) as context:
        await until(lambda: context.stats.peers == 1, "joined")
    assert peer.heard.startswith(wire.HELLO)
    decoder = wire.Decoder()
    decoder.receive(peer.heard[32:])
    event = decoder.next_event()
    assert isinstance(event, wire.Packet)
    (name,) = event.messages
    assert (name.type, name.key, name.text, name.kind) == ("i", "asynchronous", "sim", "S")


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (
            packet(MoosMessage(wire.POISON, "", data=b"A client of this name", kind="S")),
            "refuses us: A client of this name",
        ),
        (packet(MoosMessage(wire.NULL, "")), "does not welcome us"),
        (packet(), "does not welcome us"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "the peer is no MOOSDB"),
        (WELCOME + b"\xff" * 20, "the peer is no MOOSDB"),
        (b"", "no answer"),
    ],
)
async def test_a_peer_that_is_no_database_is_named_and_tried_again(join, until, monkeypatch, answer, text):
    monkeypatch.setattr(client, "CONNECT_S", 0.1)
    monkeypatch.setattr(client, "RETRY_S", 0.01)
    async with Peer(answer, answer) as peer, join(peer.port) as context:
        await until(lambda: text in context.stats.last_error and peer.connections > 1, text)
        await until(lambda: context.stats.peers == 0, "it is left, and no longer counts")


async def test_a_database_that_falls_silent_is_left(join, until, monkeypatch):
    monkeypatch.setattr(client, "BEAT_S", 0.05)
    async with Peer(WELCOME, WELCOME) as peer, join(peer.port, timeout_s=0.2) as context:
        await until(lambda: "said nothing for 0.2 s" in context.stats.last_error, "the database is left")
        await until(lambda: peer.connections > 1, "it connects again")
        await until(lambda: not context.stats.last_error, "what was wrong is over")


async def test_a_database_that_reads_nothing_costs_samples_not_memory(join, until, monkeypatch):
    monkeypatch.setattr(client, "WAITING", 100_000)

    async def deaf(reader, writer):
        await reader.read(1000)
        writer.write(WELCOME)
        writer.transport.pause_reading()
        try:
            await asyncio.sleep(3600)
        finally:
            writer.transport.abort()

    server = await asyncio.start_server(deaf, "127.0.0.1", 0)
    async with join(server.sockets[0].getsockname()[1]) as context:
        await until(lambda: context.stats.peers == 1, "joined")
        for _ in range(100_000):
            context.put([POSE])
            if context.stats.dropped:
                break
            await asyncio.sleep(0)
        assert context.stats.dropped
    server.close()


async def test_two_communities(database, make_auv, serve, connect, until):
    async with database() as one, database() as two:
        tables = {
            name: CommunityTable(port=port_of(db), client="sim", nav=NavTable(prefix=name))
            for name, db in (("A", one), ("B", two))
        }
        async with serve(MoosAdapter(MoosConfig(communities=tables), make_auv())) as context:
            await until(lambda: context.stats.peers == 2, "both joined")
            for name, db in (("A", one), ("B", two)):
                helm = await connect(db.stats.address)
                helm.register(f"{name}_X")
                context.put([POSE])
                assert (await helm.hear(f"{name}_X")).value == 20.0
                await helm.close()


async def test_what_is_not_there_is_told_at_the_start(make_auv):
    table = CommunityTable(nav=NavTable(position="gps"))
    with pytest.raises(CannotServe, match="auv/gps"):
        await MoosAdapter(MoosConfig(communities={"main": table}), make_auv()).run(asyncio.Event())


async def test_the_warp_is_the_servers_speed(database, make_auv, serve, connect, until, caplog):
    context = make_auv()
    context.world = replace(context.world, speed=5.0)
    async with serve(MoosAdapter(MoosConfig(), context)):
        assert context.stats.details["warp"] == 5.0
    async with serve(MoosAdapter(MoosConfig(warp=4.0), context)):
        assert context.stats.details["warp"] == 4.0
    assert "runs at speed 5" in caplog.text


async def test_another_warp_is_noticed(database, join, until):
    async with database(warp=10.0) as db, join(port_of(db), warp=1.0) as context:
        await until(lambda: "MOOSTimeWarp" in context.stats.last_error, "told")


async def test_a_variable_that_is_there_with_another_type_is_told_once(database, join, connect, until):
    """A MOOSDB does not tell the writer."""
    async with database() as db:
        other = await connect(db.stats.address, "other")
        other.notify(NAV_X="east", NAV_Y=1.0, MINE=b"1")
        other.register("NAV_X", "UNWRITTEN")
        await other.hear("NAV_X")
        async with join(port_of(db)) as context:
            await until(lambda: context.stats.peers == 1, "joined")

            def told() -> bool:
                context.put([POSE])
                return "has NAV_X with another type" in context.stats.last_error

            await until(told, "told")
            context.put([POSE])
            assert context.stats.errors == 1
            assert not context.commands
        await other.close()


async def test_calls_over_the_wire(database, join, connect, until):
    async with database() as db, join(port_of(db)) as context:
        await until(lambda: context.stats.peers == 1, "joined")
        client = await connect(db.stats.address, "uPokeDB")
        client.register("UWSERVER_REPLY", "UWSERVER_ERROR")
        client.notify(UWSERVER_CALL='9 world/echo {"value": [1, 2]}')
        assert json.loads((await client.hear("UWSERVER_REPLY")).text)["value"] == [1, 2]
        client.notify(AUV_PROPELLER_U=5.0)
        error = json.loads((await client.hear("UWSERVER_ERROR")).text)
        assert (error["variable"], error["code"]) == ("AUV_PROPELLER_U", "out_of_range")
        await client.close()


# -- clocks -----------------------------------------------------------------------------------------------------------------------------


class Steady:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_moos_time_is_warped():
    steady = Steady()
    clock = MoosClock(20.0, steady, unix=1000.0)
    assert clock.now() == 20_000.0
    steady.now = 0.5
    assert clock.now() == 20_010.0


def test_the_databases_clock_is_the_machines_steps_of_it_included():
    """A laptop that slept, or a date that was put right: clients on the same machine follow it at once, and throw other mail away."""
    machine = Steady()
    clock = DatabaseClock(20.0, machine)
    times = []
    for machine.now in (1000.0, 1001.0, 4601.0, 401.0):
        times.append(clock.now())
    assert times == [20_000.0, 20_020.0, 92_020.0, 8_020.0]


async def test_after_a_step_back_of_the_databases_clock_commands_are_still_obeyed(join, until):
    """What is written an hour "before" we joined is no history then."""
    step = -3600.0
    loop_time = asyncio.get_running_loop().time
    unix = datetime.now(timezone.utc).timestamp() - loop_time()

    async def database(reader, writer):
        decoder = wire.Decoder(expects_hello=True)
        while data := await reader.read(1 << 16):
            decoder.receive(data)
            while (event := decoder.next_event()) is not None:
                for said in event.messages if isinstance(event, wire.Packet) else ():
                    if said.type == wire.DATA:
                        writer.write(WELCOME)
                    if said.type == wire.TIMING:
                        now = unix + loop_time() + step
                        writer.write(packet(MoosMessage(wire.TIMING, said.key, now, time=said.time)))
                        writer.write(packet(wire.notify("DESIRED_THRUST", 60.0, now + 0.01, "helm")))
        writer.close()

    server = await asyncio.start_server(database, "127.0.0.1", 0)
    try:
        async with join(server.sockets[0].getsockname()[1]) as context:
            await until(lambda: context.commands, "the command is obeyed")
            assert context.commands[0].value == ((0.6,),)
    finally:
        server.close()


async def test_a_packet_that_is_too_long_is_passed_over(join, until, caplog):
    """Another client's picture in the database ends no connection; it is told once."""
    long = packet(wire.notify("PICTURE", "x" * wire.PACKET_LIMIT, 2e9, "camera"))
    command = packet(wire.notify("DESIRED_THRUST", 60.0, 4e9, "helm"))
    async with Peer(WELCOME + long + long + command) as peer, join(peer.port) as context:
        await until(lambda: context.commands, "what came behind it")
        assert peer.connections == 1
        assert len([r for r in caplog.records if "passes over" in r.getMessage()]) == 1


async def test_what_a_database_floods_us_with_is_taken_in_turns(join, until, monkeypatch):
    """With no time in a turn each read has its own; all is taken, in its order."""
    monkeypatch.setattr("uwserver.adapter.turns.TURN_S", 0.0)
    monkeypatch.setattr("uwserver.adapter.turns.REST_S", 0.0)
    many = packet(*(wire.notify("DESIRED_THRUST", float(k % 100), 4e9, "helm") for k in range(3000)))
    turns = []
    work = InputTurns._work
    monkeypatch.setattr(InputTurns, "_work", lambda self: (turns.append(1), work(self))[1])
    async with (
        Peer(WELCOME + many + packet(wire.notify("AUV_RUDDER_ANGLE_RAD", 0.1, 4e9, "helm"))) as peer,
        join(peer.port) as context,
    ):
        await until(lambda: any(c.port == "auv/rudder" for c in context.commands), "the last")
        assert [c.value for c in context.commands if c.port == "auv/propeller"] == [((0.99,),)]
        assert len(turns) > 3000 // wire.AT_ONCE


def test_equal_clocks_are_left_alone():
    clock = MoosClock(1.0, Steady(), unix=1000.0)
    clock.observe(1000.0, 1000.3, 1000.5)
    assert clock.skew == 0.0


def test_another_clock_is_followed():
    clock = MoosClock(1.0, Steady(), unix=1000.0)
    clock.observe(1000.0, 1050.0, 1000.0)
    assert clock.now() == 1050.0
    now = clock.now()
    for _ in range(100):
        now = clock.now()
        clock.observe(now, 1050.5, now)
    assert clock.now() == pytest.approx(1050.5, abs=1e-3)
    assert clock.is_credible


def test_a_small_difference_moves_the_clock_smoothly():
    clock = MoosClock(1.0, Steady(), unix=1000.0)
    clock.observe(1000.0, 1000.2, 1000.0)
    assert 0.0 < clock.skew < 0.05


def test_another_warp_is_not_credible():
    clock = MoosClock(1.0, Steady(), unix=1.7e9)
    clock.observe(1.7e9, 1.7e10, 1.7e9)
    assert not clock.is_credible
