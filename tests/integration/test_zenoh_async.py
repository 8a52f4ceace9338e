"""`AsyncClient` over zenoh: the verbs it has over TCP, its ends, and that nothing of it stays behind."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
import uwclient
from uwclient import AsyncClient
from zenoh_network import BUS, LISTEN, PATIENCE_S, ROV, TCP, Server, free_endpoint, serving

Scenario = Callable[[AsyncClient], Awaitable[None]]


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("tank"), ROV + TCP + BUS + LISTEN) as server:
        yield server
        server.end()


def run(server: Server, scenario: Scenario, **options: Any) -> None:
    """Run a scenario with a connected client; no task and no thread may be left after it."""

    async def whole() -> None:
        before = asyncio.all_tasks()
        client = await uwclient.connect_zenoh_async("uwserver", [server.endpoint], timeout=PATIENCE_S, **options)
        async with client:
            await scenario(client)
        assert asyncio.all_tasks() == before

    bounded(whole())


def bounded(work: Awaitable[None]) -> None:
    async def within() -> None:
        await asyncio.wait_for(work, 2 * PATIENCE_S)

    asyncio.run(within())
    left = [thread for thread in threading.enumerate() if thread.name.startswith("uwclient")]
    for thread in left:
        thread.join(PATIENCE_S)
    assert not any(thread.is_alive() for thread in left)


async def until(condition: Callable[[], object], what: str) -> None:
    async def wait() -> None:
        while not condition():
            await asyncio.sleep(0.02)

    try:
        await asyncio.wait_for(wait(), PATIENCE_S)
    except TimeoutError:
        raise AssertionError(f"in vain: {what}") from None


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_it_has_the_same_verbs(tank, encoding):
    seen: list[float] = []

    async def scenario(client: AsyncClient) -> None:
        assert "rov/imu" in client.ports
        await client.subscribe("rov/imu", fields=["w_S"])
        await client.subscribe("**", rate_hz=5)
        assert {(await client.read()).port for _ in range(100)} >= {"rov/imu", "rov/depth"}
        assert (await client.send("rov/thrusters", u=[0.1] * 8)).tick > 0
        with pytest.raises(uwclient.CallRefused, match="at most 1"):
            await client.send("rov/thrusters", u=[2.0] * 8)
        await client.send_nowait("rov/thrusters", u=[2.0] * 8)
        await until(lambda: client.latest("rov/imu") and client.refusals, "the refusal of send_nowait")
        await client.pause()
        t_ns = (await client.status())["t_ns"]
        assert (await client.step(3)).t_ns > t_ns
        t_s = (await client.status())["t_ns"] / 1e9 + 0.5
        await client.call("world/run_until", t_s=t_s, on_progress=lambda progress: seen.append(progress.fraction))
        with pytest.raises(uwclient.Timeout):
            await client.call("world/run_until", t_s=1e6, timeout=0.3)
        await client.resume()
        assert await client.wait_until((await client.status())["t_ns"] / 1e9 + 0.1) > 0
        assert any(event.event == "paused" for event in client.events)
        for pattern in ("rov/nothing", "rov/thrusters", "rov/i*"):
            with pytest.raises(uwclient.CallRefused):
                await client.subscribe(pattern)
        with pytest.raises(uwclient.CallRefused, match="dropped"):
            await client.subscribe("rov/depth", delivery="reliable")
        assert await client.unsubscribe("**") == 1

    run(tank, scenario, encoding=encoding, name="pilot")
    assert seen == sorted(seen)


def test_it_tells_what_the_blocking_client_tells(tank):
    async def scenario(client: AsyncClient) -> None:
        with tank.client() as blocking:
            assert client.ports == blocking.ports
            assert client.services == blocking.services
            await client.subscribe("rov/**")
            blocking.subscribe("rov/**")
            of_both = {(s.port, s.seq): s for s in [blocking.read() for _ in range(200)]}
            matched = 0
            async for sample in client:
                other = of_both.get((sample.port, sample.seq))
                if other is not None:
                    assert sample == other
                    matched += 1
                if matched == 50:
                    return

    run(tank, scenario)


def test_many_tasks_share_it(tank):
    async def scenario(client: AsyncClient) -> None:
        await client.subscribe("rov/imu")
        results = await asyncio.gather(
            *(client.send("rov/thrusters", u=[0.01 * k] * 8) for k in range(20)),
            *(client.status() for _ in range(20)),
            client.read("rov/imu"),
        )
        assert len(results) == 41

    run(tank, scenario)


def test_cancelling_the_task_ends_the_call_on_the_server(tank):
    async def scenario(client: AsyncClient) -> None:
        await client.pause()
        task = asyncio.ensure_future(client.call("world/run_until", t_s=1e6))
        await moving(client, True)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await moving(client, False)
        await client.resume()

    run(tank, scenario)


async def moving(client: AsyncClient, moves: bool) -> None:
    async def wait() -> None:
        while True:
            before = (await client.status())["t_ns"]
            await asyncio.sleep(0.1)
            if ((await client.status())["t_ns"] != before) == moves:
                return

    await asyncio.wait_for(wait(), PATIENCE_S)


def test_nobody_there_and_a_cancelled_attempt_leave_nothing():
    nobody = free_endpoint()

    async def in_vain() -> None:
        with pytest.raises(uwclient.ConnectionLost, match="no uwserver answers at zenoh uw/uwserver"):
            await uwclient.connect_zenoh_async("uwserver", [nobody], timeout=0.5)
        with pytest.raises(uwclient.UwError, match='refuses the setting "no/such"'):
            await uwclient.connect_zenoh_async("uwserver", [nobody], config={"no/such": 1})
        connecting = asyncio.ensure_future(uwclient.connect_zenoh_async("uwserver", [nobody], timeout=2.0))
        await asyncio.sleep(0.1)
        connecting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await connecting

    bounded(in_vain())


def test_it_survives_a_server_restart(tmp_path):
    endpoint = free_endpoint()
    text = ROV + BUS + f"listen = {json.dumps([endpoint])}\n"

    async def whole() -> None:
        async with contextlib.AsyncExitStack() as stack:
            with serving(tmp_path, text):
                connecting = uwclient.connect_zenoh_async("uwserver", [endpoint], timeout=PATIENCE_S)
                client = await stack.enter_async_context(await connecting)
                await client.subscribe("rov/imu")
                await client.read("rov/imu")
            await until(lambda: client._link is None, "the loss is seen")
            with serving(tmp_path, text) as second:
                assert (await client.read("rov/imu")).valid
                while client.reconnects != 1:
                    await client.read("rov/imu")
                second.end()

    bounded(whole())
