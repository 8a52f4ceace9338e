"""What the adapters of autopilots do where they cannot serve."""

from __future__ import annotations

import asyncio
import contextlib

import pytest
from msgspec.structs import replace
from uwserver_adapters.ardupilot import ArduPilotAdapter
from uwserver_adapters.px4 import Px4Adapter

from uwserver.adapter import CannotServe
from uwserver.ports import Field, Port
from uwserver.testing import FakeContext
from uwserver.testing.fake_context import PORTS


async def started(adapter_class, context: FakeContext, **table) -> None:
    async with running(adapter_class, context, **table):
        pass


@contextlib.asynccontextmanager
async def running(adapter_class, context: FakeContext, **table):
    ready = asyncio.Event()
    task = asyncio.ensure_future(adapter_class(adapter_class.Config(**table), context).run(ready))
    waiting = asyncio.ensure_future(ready.wait())
    try:
        await asyncio.wait([task, waiting], timeout=60, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        assert ready.is_set()
        yield
    finally:
        for each in (task, waiting):
            each.cancel()
        await asyncio.gather(task, waiting, return_exceptions=True)


@pytest.mark.parametrize("adapter_class", [ArduPilotAdapter, Px4Adapter])
def test_a_world_that_is_not_in_lockstep_is_left_alone(adapter_class) -> None:
    context = FakeContext()
    context.world = replace(context.world, mode="freerun")
    asyncio.run(started(adapter_class, context))
    assert 'mode = "lockstep"' in context.stats.last_error
    assert not context.drivers


@pytest.mark.parametrize("adapter_class", [ArduPilotAdapter, Px4Adapter])
def test_the_world_is_told_what_the_autopilot_reads(adapter_class) -> None:
    """By the driver; what stands on the loop reads nothing."""
    vector = {"frame": "B", "shape": (3,)}
    pose = (Field("p_NB", "m", "x", **vector), Field("q_NB", "1", "x", shape=(4,)))
    velocity = (Field("v_NB_B", "m/s", "x", **vector), Field("w_NB_B", "rad/s", "x", **vector))
    truth = [
        Port(f"rov/truth/{name}", "sensor", "truth", fields, "x", 250.0)
        for name, fields in (("pose", pose), ("velocity", velocity))
    ]
    context = FakeContext(ports={port.path: port for port in (*PORTS, *truth)})

    async def refresh_matching() -> None:
        async with running(adapter_class, context, port=0, truth=True):
            assert context.subscriptions == {"rov/imu", "rov/truth/pose", "rov/truth/velocity"}
            assert [list(subscriber.subscriptions) for subscriber in context.subscribers] == [[]]

    asyncio.run(refresh_matching())
    assert context.subscriptions == frozenset()


@pytest.mark.parametrize("adapter_class", [ArduPilotAdapter, Px4Adapter])
@pytest.mark.parametrize(
    ("table", "phrase"),
    [
        ({"truth": False}, "set truth = true"),
        ({"truth": True}, 'pose: no sensor "rov/truth/pose"'),
        ({"truth": True, "imu": "gyro"}, 'imu: no sensor "rov/gyro"; there are: rov/depth, rov/imu|pose: no sensor'),
        ({"truth": True, "vehicle": "auv"}, 'no vehicle "auv"; there are: rov'),
        ({"truth": True, "bind": "192.0.2.1"}, "no such address"),
    ],
)
def test_what_does_not_fit_is_told(adapter_class, table, phrase: str) -> None:
    context = FakeContext()
    with pytest.raises(CannotServe, match=phrase):
        asyncio.run(started(adapter_class, context, port=0, **table))
    assert not context.drivers
    assert not context.subscribers
