"""Links: pymavlink as a client over UDP, TCP and a pseudo-terminal; peers that come, go, flood or do not read."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import pty
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from uwserver_adapters.mavlink.adapter import MavlinkAdapter
from uwserver_adapters.mavlink.links import zenoh as zenoh_link
from uwserver_adapters.mavlink.links.endpoint import BadLink
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig

from uwserver.adapter import STRANGERS, CannotListen, CannotServe, connection

pymavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
mavutil = pytest.importorskip("pymavlink.mavutil")


def adapter(rov: Any, *links: str, **table: Any) -> MavlinkAdapter:
    return MavlinkAdapter(MavlinkConfig(links=links, **table), rov)


def port_of(context: Any, which: int = 0) -> int:
    return int(context.stats.address.split(", ")[which].rpartition(":")[2])


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def until(condition: Callable[[], Any], what: str) -> None:
    end = asyncio.get_running_loop().time() + 60.0
    while not condition():
        assert asyncio.get_running_loop().time() < end, what
        await asyncio.sleep(0.01)


@contextlib.contextmanager
def client(url: str, system: int = 255) -> Any:
    link = mavutil.mavlink_connection(url, dialect="ardupilotmega", source_system=system, source_component=190)
    try:
        yield link
    finally:
        link.close()


async def hear(link: Any, name: str) -> Any:
    """The next message of a kind."""
    for _ in range(6000):
        message = link.recv_match(type=name, blocking=False)
        if message is not None:
            return message
        await asyncio.sleep(0.01)
    raise AssertionError(f"no {name}")


async def download(link: Any) -> int:
    link.mav.param_request_list_send(1, 1)
    first = await hear(link, "PARAM_VALUE")
    seen = {first.param_index}
    while len(seen) < first.param_count:
        seen.add((await hear(link, "PARAM_VALUE")).param_index)
    return len(seen)


@pytest.mark.parametrize("kind", ["udpout", "udpin", "tcpin"])
async def test_pymavlink_is_a_client(serve, make_rov, kind):
    port = free_port()
    text = f"{kind}:127.0.0.1:{port if kind == 'udpout' else 0}"
    async with serve(adapter(make_rov(), text)) as context:
        there = port if kind == "udpout" else port_of(context)
        with client({"udpout": "udpin", "udpin": "udpout", "tcpin": "tcp"}[kind] + f":127.0.0.1:{there}") as link:
            link.mav.heartbeat_send(6, 8, 0, 0, 4)
            heartbeat = await hear(link, "HEARTBEAT")
            assert (heartbeat.type, heartbeat.autopilot, heartbeat.get_srcComponent()) == (12, 3, 1)
            assert await download(link) > 300
            link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
            assert (await hear(link, "COMMAND_ACK")).result == 0
            await until(lambda: context.stats.peers == 1, "one peer")
            for _ in range(20):
                context.emit("rov/imu")
            assert await hear(link, "ATTITUDE")
            assert link.mav.total_receive_errors == 0


async def test_several_stations_and_links_at_once(serve, make_rov):
    async with serve(adapter(make_rov(), "udpin:127.0.0.1:0", "tcpin:127.0.0.1:0")) as context:
        urls = [f"udpout:127.0.0.1:{port_of(context)}"] * 2 + [f"tcp:127.0.0.1:{port_of(context, 1)}"] * 2
        with contextlib.ExitStack() as stack:
            links = [stack.enter_context(client(url, 255 - k)) for k, url in enumerate(urls)]
            for link in links:
                link.mav.heartbeat_send(6, 8, 0, 0, 4)
            for link in links:
                link.mav.command_long_send(1, 1, 520, 0, 1, 0, 0, 0, 0, 0, 0)
            for link in links:
                assert (await hear(link, "COMMAND_ACK")).target_system == link.mav.srcSystem
            assert context.stats.peers == 4
            # Each hears the others' heartbeats, through us.
            links[0].mav.heartbeat_send(6, 8, 0, 0, 4)
            for link in links[1:]:
                while (await hear(link, "HEARTBEAT")).get_srcSystem() != 255:
                    pass


async def test_a_client_that_connects_later_and_again(serve, make_rov):
    """tcpout: the peer may start after us, and be started again."""
    port = free_port(socket.SOCK_STREAM)
    async with serve(adapter(make_rov(), f"tcpout:127.0.0.1:{port}")) as context:
        await until(lambda: "tried again" in context.stats.last_error, "told")
        for _ in range(2):
            got: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
            server = await asyncio.start_server(lambda r, w, got=got: got.set_result((r, w)), "127.0.0.1", port)
            try:
                reader, writer = await asyncio.wait_for(got, 60.0)
                assert (await asyncio.wait_for(reader.readexactly(10), 60.0))[0] == 0xFD
                writer.transport.abort()
            finally:
                server.close()
                await server.wait_closed()
            await until(lambda: context.stats.peers == 0, "gone")


async def test_a_serial_line(serve, make_rov):
    ours, theirs = pty.openpty()
    os.set_blocking(ours, False)
    mav = pymavlink.MAVLink(None, srcSystem=255)
    mav.robust_parsing = True
    heard: list[str] = []

    def read() -> bool:
        with contextlib.suppress(BlockingIOError):
            heard.extend(m.get_type() for m in mav.parse_buffer(os.read(ours, 4096)) or [])
        return "COMMAND_ACK" in heard and "HEARTBEAT" in heard

    try:
        async with serve(adapter(make_rov(), f"serial:{os.ttyname(theirs)}")) as context:
            os.write(ours, pymavlink.MAVLink_command_long_message(1, 1, 520, 0, *(0.0,) * 7).pack(mav))
            await until(read, "an answer")
            assert context.stats.peers == 1
    finally:
        os.close(ours)
        os.close(theirs)


async def test_a_serial_line_that_is_not_there_is_told(serve, make_rov):
    async with serve(adapter(make_rov(), "serial:/dev/nothing")) as context:
        await until(lambda: "/dev/nothing" in context.stats.last_error, "told")


async def test_what_speaks_no_mavlink_hears_nothing(serve, make_rov):
    async with serve(adapter(make_rov(), "udpin:127.0.0.1:0")) as context:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.setblocking(False)
            stranger.sendto(b"hello", ("127.0.0.1", port_of(context)))
            await asyncio.sleep(1.2)
            with pytest.raises(BlockingIOError):
                stranger.recv(1000)
        assert context.stats.peers == 0


async def test_of_a_flood_by_udp_no_more_is_looked_at_than_a_peer_may_send(serve, make_rov, monkeypatch):
    monkeypatch.setattr(connection, "TURN_S", 1e-9)
    monkeypatch.setattr(connection, "REST_S", 0.01)
    seen = []
    work = Router.work
    monkeypatch.setattr(Router, "work", lambda self, channel: (seen.append(channel.number), work(self, channel))[1])
    time = asyncio.get_running_loop().time
    async with serve(adapter(make_rov(), "udpin:127.0.0.1:0", frames_per_s=20)) as context:
        began = time()
        with (
            client(f"udpout:127.0.0.1:{port_of(context)}") as flood,
            client(f"udpout:127.0.0.1:{port_of(context)}", 254) as calm,
        ):
            for _ in range(2000):
                flood.mav.heartbeat_send(6, 8, 0, 0, 4)

            def is_calm_heard() -> bool:
                calm.mav.heartbeat_send(6, 8, 0, 0, 4)  # again: the flood may have filled the socket's buffer
                return len(set(seen)) == 2

            await until(is_calm_heard, "the other is heard")
            assert context.stats.peers == 2
            await until(lambda: context.stats.details.get("counters", {}).get("flood", 0) > 50, "counted")
            assert len(seen) <= 2 * 20 * (time() - began + 1.0)


async def test_too_many_peers_are_refused_and_told(serve, make_rov, monkeypatch):
    monkeypatch.setattr("uwserver_adapters.mavlink.links.udp.PEERS", 2)
    async with serve(adapter(make_rov(), "udpin:127.0.0.1:0")) as context:
        with contextlib.ExitStack() as stack:
            for k in range(3):
                link = stack.enter_context(client(f"udpout:127.0.0.1:{port_of(context)}", 255 - k))
                link.mav.heartbeat_send(6, 8, 0, 0, 4)
            await until(lambda: context.stats.dropped, "refused")
            assert context.stats.peers == 2
            assert "more than 2 peers" in context.stats.last_error


async def test_who_only_listens_by_tcp_makes_way_for_who_speaks(serve, make_rov, monkeypatch):
    monkeypatch.setattr("uwserver_adapters.mavlink.links.stream.PEERS", 1)
    async with serve(adapter(make_rov(), "tcpin:127.0.0.1:0")) as context:
        with contextlib.ExitStack() as stack:
            for _ in range(STRANGERS + 20):
                stack.enter_context(socket.create_connection(("127.0.0.1", port_of(context))))
            link = stack.enter_context(client(f"tcp:127.0.0.1:{port_of(context)}"))
            link.mav.heartbeat_send(6, 8, 0, 0, 4)
            await until(lambda: 0 < context.stats.peers <= STRANGERS, "the oldest are gone")
            second = stack.enter_context(client(f"tcp:127.0.0.1:{port_of(context)}", 254))
            second.mav.heartbeat_send(6, 8, 0, 0, 4)
            await until(lambda: "max_clients" in context.stats.details.get("refused", {}), "refused")


async def test_a_silent_peer_is_forgotten(serve, make_rov, monkeypatch):
    monkeypatch.setattr("uwserver_adapters.mavlink.links.udp.SILENT_S", 0.3)
    monkeypatch.setattr("uwserver_adapters.mavlink.adapter.RETRY_S", 0.1)
    async with serve(adapter(make_rov(), "udpin:127.0.0.1:0")) as context:
        with client(f"udpout:127.0.0.1:{port_of(context)}") as link:
            link.mav.heartbeat_send(6, 8, 0, 0, 4)
            await until(lambda: context.stats.peers == 1, "there")
            await until(lambda: context.stats.peers == 0, "forgotten")


@pytest.mark.parametrize(
    ("table", "error", "match"),
    [
        ({"links": ("udp:127.0.0.1:14550",)}, BadLink, "write udpout:host:port"),
        ({"links": ("udpout:14550",)}, BadLink, "write udpout:host:port"),
        ({"links": ("tcpin:127.0.0.1:99999",)}, BadLink, "write udpout:host:port"),
        ({"links": ("tcpin:203.0.113.7:0",)}, CannotListen, "no such address"),
        ({"vehicle": "auv"}, CannotServe, 'no vehicle "auv"; there are: rov'),
        ({"parameters": {"NO_SUCH": 1.0}}, CannotServe, "NO_SUCH"),
        ({"origin_deg": (95.0, 0.0)}, CannotServe, "origin_deg"),
    ],
)
async def test_a_table_that_cannot_be(make_rov, table, error, match):
    with pytest.raises(error, match=match):
        await MavlinkAdapter(MavlinkConfig(**table), make_rov()).run(asyncio.Event())


async def test_a_port_in_use_is_told(serve, make_rov):
    async with serve(adapter(make_rov(), "tcpin:127.0.0.1:0")) as context:
        with pytest.raises(CannotListen, match=r"in use, perhaps by a ground station.*\(its port in links = 0"):
            await adapter(make_rov(), f"tcpin:127.0.0.1:{port_of(context)}").run(asyncio.Event())


async def test_raw_frames_over_zenoh(serve, make_rov):
    """As BlueOS has them: we speak on `mavlink_raw/out`, and hear `mavlink_raw/in`."""
    zenoh = pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
    text = '{{listen: {{endpoints: ["tcp/127.0.0.1:{0}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
    port = free_port(socket.SOCK_STREAM)
    session = await asyncio.get_running_loop().run_in_executor(
        None, zenoh.open, zenoh.Config.from_json5(text.format(port))
    )
    mav = pymavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    heard: list[bytes] = []
    try:
        session.declare_subscriber("mavlink_raw/out", lambda sample: heard.append(sample.payload.to_bytes()))
        async with serve(adapter(make_rov(), f"zenoh:tcp/127.0.0.1:{port}")):
            await until(lambda: heard, "a heartbeat")
            session.put("mavlink_raw/in", pymavlink.MAVLink_command_long_message(1, 1, 520, 0, *(0.0,) * 7).pack(mav))
            parsed: list[str] = []
            reader = pymavlink.MAVLink(None)

            def answered() -> bool:
                while heard:
                    parsed.extend(m.get_type() for m in reader.parse_buffer(heard.pop(0)) or [])
                return "COMMAND_ACK" in parsed

            await until(answered, "an answer")
            assert "HEARTBEAT" in parsed
    finally:
        session.close()


async def test_json_over_zenoh(serve, make_rov, monkeypatch):
    """The keys of mavlink-server: nothing is encoded before somebody listens, bad text is counted and refused."""
    zenoh = pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
    text = '{{listen: {{endpoints: ["tcp/127.0.0.1:{0}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
    port = free_port(socket.SOCK_STREAM)
    session = await asyncio.get_running_loop().run_in_executor(
        None, zenoh.open, zenoh.Config.from_json5(text.format(port))
    )
    heard: list[Any] = []
    encoded: list[str] = []

    def counted(step: str, real: Callable[..., Any], *args: Any) -> Any:
        encoded.append(step)
        return real(*args)

    for step in ("fields_of", "text_of"):
        monkeypatch.setattr(zenoh_link, step, partial(counted, step, getattr(zenoh_link, step)))

    def has(key: str) -> list[Any]:
        return [json.loads(s.payload.to_bytes()) for s in list(heard) if str(s.key_expr) == key]

    def put(name: str, **fields: Any) -> None:
        header = {"system_id": 255, "component_id": 190, "sequence": 3}
        session.put("mavlink/in", json.dumps({"header": header, "message": {"type": name, **fields}}))

    try:
        async with serve(adapter(make_rov(), f"zenoh:tcp/127.0.0.1:{port}")) as context:
            raw = session.declare_subscriber("mavlink_raw/out", heard.append)
            await until(lambda: heard, "a raw heartbeat")
            raw.undeclare()
            assert not encoded, "nobody listens"
            fields = session.declare_subscriber("mavlink/1/1/HEARTBEAT/*", heard.append)
            await until(lambda: has("mavlink/1/1/HEARTBEAT/mavlink_version"), "fields")
            assert has("mavlink/1/1/HEARTBEAT/mavtype")[0] == {"type": "MAV_TYPE_SUBMARINE"}
            assert set(encoded) == {"fields_of"}, "nobody listens to whole messages"
            fields.undeclare()
            session.declare_subscriber("mavlink/out", heard.append)
            session.declare_subscriber("mavlink/1/1/*", heard.append)
            await until(lambda: has("mavlink/out") and has("mavlink/1/1/HEARTBEAT"), "whole messages")
            sample = next(s for s in heard if str(s.key_expr) == "mavlink/out")
            assert sample.encoding == zenoh.Encoding.APPLICATION_JSON.with_schema("mavlink")
            assert sample.priority == zenoh.Priority.REAL_TIME
            assert sample.congestion_control == zenoh.CongestionControl.BLOCK
            for bad in (
                b"",
                b"{",
                b"\xff\xfe",
                b'{"header":{"system_id":300,"component_id":1},"message":{}}',
                b"[" * 9000,
            ):
                session.put("mavlink/in", bad)
            await until(lambda: context.stats.details["counters"].get("json") == 5, "five refused")
            assert context.stats.last_error.startswith("mavlink/in: ")
            command = {"type": "MAV_CMD_COMPONENT_ARM_DISARM"}
            put("COMMAND_LONG", target_system=1, target_component=1, command=command, param1=1.0)
            await until(lambda: has("mavlink/1/1/COMMAND_ACK"), "an answer")
            ack = has("mavlink/1/1/COMMAND_ACK")[0]
            assert ack["header"]["system_id"] == 1
            assert ack["message"] | {"target_component": 190} == ack["message"]
            assert (ack["message"]["command"], ack["message"]["result"]) == (command, {"type": "MAV_RESULT_ACCEPTED"})
    finally:
        session.close()


async def test_the_log_is_read_by_pymavlink(serve, make_rov, tmp_path: Path):
    path = tmp_path / "dive.tlog"
    async with serve(adapter(make_rov(), "tcpin:127.0.0.1:0", tlog=str(path))) as context:
        with client(f"tcp:127.0.0.1:{port_of(context)}") as link:
            link.mav.command_long_send(1, 1, 520, 0, 1, 0, 0, 0, 0, 0, 0)
            await hear(link, "COMMAND_ACK")
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    try:
        names = []
        while (message := log.recv_match(blocking=False)) is not None:
            names.append(message.get_type())
            assert message._timestamp > 1_700_000_000
    finally:
        log.close()
    assert names.index("COMMAND_LONG") < names.index("COMMAND_ACK") < names.index("AUTOPILOT_VERSION")
