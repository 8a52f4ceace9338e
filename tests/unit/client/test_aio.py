"""The asyncio client against the fake server."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from uwclient import AsyncClient, CallRefused, ConnectionLost, ProtocolError, Timeout
from uwclient_fake_server import FakeServer

U = [0.1] * 8


def run(server: FakeServer, scenario: Callable[[AsyncClient], Awaitable[None]], **options: object) -> None:
    """Run a scenario with a connected client; nothing may be left running after it."""

    async def whole() -> None:
        before = asyncio.all_tasks()
        async with await AsyncClient.connect(port=server.port, timeout=60.0, **options) as client:
            await scenario(client)
        assert asyncio.all_tasks() == before

    asyncio.run(asyncio.wait_for(whole(), 120))


async def until(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0.005)


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("piece", [0, 1])
def test_drive_and_read(server: FakeServer, encoding: str, piece: int) -> None:
    server.piece = piece

    async def scenario(client: AsyncClient) -> None:
        assert "rov/imu" in client.ports
        assert (await client.subscribe("rov/*", rate_hz=10)).ports == ("rov/imu", "rov/depth")
        assert (await client.read()).port == "rov/imu"
        assert [(await client.read("rov/depth")).seq for _ in range(5)] == [0, 1, 2, 4, 5]
        ack = await client.send("rov/thrusters", u=U)
        assert ack.tick == 100
        assert await client.unsubscribe("rov/*") == 1

    run(server, scenario, encoding=encoding)


def test_iteration_ends_with_close(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        seen = []

        async def collect() -> None:
            async for sample in client:
                seen.append(sample.seq)

        await client.subscribe("rov/imu")
        task = asyncio.ensure_future(collect())
        await until(lambda: len(seen) == 5)
        assert client.latest("rov/imu").seq == 5
        await client.close()
        await asyncio.wait_for(task, 60)
        assert seen == [0, 1, 2, 4, 5]

    run(server, scenario)


def test_many_requests_at_once(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        values = await asyncio.gather(*(client.call("echo", x=number) for number in range(50)))
        assert values == [{"x": number} for number in range(50)]

    run(server, scenario)


def test_replies_out_of_order(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        slow = asyncio.ensure_future(client.call("rov/goto"))
        await until(lambda: server.told("call"))
        assert await client.call("echo", x=1) == {"x": 1}
        assert not slow.done()
        goto = next(request for request in server.requests if request.get("params", {}).get("service") == "rov/goto")
        assert await client.cancel(goto["id"]) is True
        with pytest.raises(CallRefused) as caught:
            await slow
        assert caught.value.code == "preempted"

    run(server, scenario)


def test_progress_and_cancelled_task(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        seen = []
        task = asyncio.ensure_future(client.call("rov/goto", on_progress=lambda p: seen.append(p.fraction)))
        await until(lambda: len(seen) == 2)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await until(lambda: server.told("cancel"))
        with pytest.raises(Timeout, match="rov/goto"):
            await client.call("rov/goto", timeout=0.1)
        await client.status()
        assert len(server.told("cancel")) == 2
        assert not server.peers[0].unfinished

    run(server, scenario)


def test_refusals(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        with pytest.raises(CallRefused, match="out_of_range: u"):
            await client.send("rov/thrusters", u=[2.0] * 8)
        with pytest.raises(CallRefused, match="a list of 8 float"):
            await client.send("rov/thrusters", u=[0.0])
        with pytest.raises(CallRefused, match="nothing is subscribed"):
            await client.read()
        await client.send_nowait("rov/thrusters", u=[2.0] * 8)
        await client.status()
        assert client.refusals.popleft().code == "out_of_range"

    run(server, scenario)


def test_world_verbs(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        await client.pause()
        assert (await client.step(10)).tick == 110
        assert await client.wait_until(1.0, timeout=60) == pytest.approx(1.0)
        await client.resume()
        await client.reset()
        assert await client.wait_until(1.5, timeout=60) >= 1.5
        with pytest.raises(Timeout):
            await client.wait_until(1e6, timeout=0.05)
        assert (await client.describe("rov/depth")).ports.keys() == {"rov/depth"}

    run(server, scenario)


def test_reconnects_and_subscribes_again(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        await client.subscribe("rov/imu", rate_hz=5)
        for _ in range(5):
            await client.read()
        reading = asyncio.ensure_future(client.read(timeout=60))
        await asyncio.sleep(0)
        server.drop()
        assert (await reading).seq == 0
        assert client.reconnects == 1
        assert server.told("subscribe") == [{"pattern": "rov/imu", "rate_hz": 5}] * 2
        server.drop()
        await until(lambda: client._link is None)
        acks = await asyncio.gather(*(client.send("rov/thrusters", u=U) for _ in range(5)))
        assert len(acks) == 5
        assert client.reconnects == 2

    run(server, scenario)


def test_requests_in_flight_at_the_loss(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        server.silent.update({"command", "describe"})
        tasks = [asyncio.ensure_future(client.send("rov/thrusters", u=U)), asyncio.ensure_future(client.describe())]
        await until(lambda: len(server.requests) == 4)
        server.silent.clear()
        server.drop()
        command, describe = await asyncio.gather(*tasks, return_exceptions=True)
        assert isinstance(command, ConnectionLost)
        assert "may or may not have been applied" in str(command)
        assert isinstance(describe, ConnectionLost)
        assert "changes nothing" in str(describe)

    run(server, scenario)


def test_a_subscription_lost_by_a_reconnection_is_told_once(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        await client.subscribe("rov/imu")
        server.refuse_patterns.add("rov/imu")
        server.drop()
        await until(lambda: client._link is None)
        with pytest.raises(CallRefused, match="after the reconnection"):
            await client.status()
        assert (await client.status())["paused"] is False

    run(server, scenario)


def test_without_reconnect_and_after_close(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        server.drop()
        await until(lambda: client._link is None)
        with pytest.raises(ConnectionLost, match="reconnect is off"):
            await client.status()
        await client.close()
        with pytest.raises(ConnectionLost, match="the client is closed"):
            await client.status()

    run(server, scenario, reconnect=False)


def test_garbage_from_the_server(server: FakeServer) -> None:
    async def scenario(client: AsyncClient) -> None:
        server.silent.add("step")
        stepping = asyncio.ensure_future(client.step())
        await until(lambda: server.told("step"))
        server.peers[0].write_raw(b"%%%\n")
        with pytest.raises(ProtocolError, match="%%%"):
            await stepping
        assert (await client.status())["paused"] is False
        assert client.reconnects == 1

    run(server, scenario)


def test_no_server_says_what_to_do(unused_port: int) -> None:
    with pytest.raises(ConnectionLost, match="`uwserver run`") as caught:
        asyncio.run(AsyncClient.connect(port=unused_port, timeout=0.25))
    assert caught.value.code == "unreachable"


def test_server_that_appears_late(unused_port: int) -> None:
    async def scenario() -> None:
        connecting = asyncio.ensure_future(AsyncClient.connect(port=unused_port, timeout=60.0))
        await asyncio.sleep(0.15)
        assert not connecting.done()
        with FakeServer(unused_port):
            client = await connecting
            assert "rov/imu" in client.ports
            await client.close()

    asyncio.run(scenario())


def test_a_server_that_never_answers_is_left_in_time(server: FakeServer) -> None:
    server.silent.add("hello")
    with pytest.raises(ConnectionLost, match="hello"):
        asyncio.run(AsyncClient.connect(port=server.port, timeout=1.0))


def test_token_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario(client: AsyncClient) -> None:
        assert await client.call("echo") == {}

    with FakeServer(token="secret") as server:
        with pytest.raises(CallRefused, match="denied"):
            run(server, scenario)
        monkeypatch.setenv("UWSERVER_TOKEN", "secret")
        run(server, scenario)
