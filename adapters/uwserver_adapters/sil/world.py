"""What the adapters for autopilots ask of the server, and what they do not."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Collection, Sequence
from typing import Any

from uwserver.adapter import AdapterContext, CannotServe, Driver, address_text, serving
from uwserver.frames import Quat, Vec3, conjugate, rotate
from uwserver.ports import Event, Progress, Refused, Reply, Sample

log = logging.getLogger(__name__)

GRAVITY_MPS2 = 9.80665


class Deaf:
    """A `Subscriber` of an adapter whose driver sees the samples in their tick: the loop has nothing to do with them."""

    wanted: Collection[str] = ()

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Nothing."""

    def put_event(self, event: Event) -> None:
        """Nothing."""


async def stand_by(context: AdapterContext, ready: asyncio.Event) -> None:
    """Where the world is not in lockstep: say so and serve nobody, until cancelled. Else return at once."""
    mode = context.world.mode
    if mode == "lockstep":
        return
    stats = context.stats
    stats.last_error = f'the world runs in mode {mode}: an autopilot in the loop needs [world.clock] mode = "lockstep"'
    log.warning("%s: %s; nothing is served", context.name, stats.last_error)
    stats.state = "running"
    ready.set()
    await asyncio.get_running_loop().create_future()


async def drive(
    context: AdapterContext, client: str | None, driver: Driver, endpoint: socket.socket, ready: asyncio.Event
) -> None:
    """Let a driver set the pace of the world, until cancelled. When this returns, the driver is not called any more.

    Args:
        context: of the adapter.
        client: name in the scenario's `lockstep_clients`; default: the adapter's name.
        driver: that is asked.
        endpoint: where its peer finds it.
        ready: as `Adapter.run` got it.

    Raises:
        CannotServe: the world does not take the driver.
        RuntimeError: the driver failed.
    """
    failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def on_reply(outcome: Reply | Progress) -> None:
        if isinstance(outcome, Reply) and outcome.fault is not None and not failed.done():
            failed.set_exception(RuntimeError(outcome.fault.text))

    try:
        end = context.drive(client or context.name, driver, on_reply)
    except Refused as refused:
        raise CannotServe(refused.fault.text) from None
    try:
        with serving(context, Deaf(), address_text(*endpoint.getsockname()[:2]), ready):
            await failed
    finally:
        end()


def inertial(imu: Any, q_NB: Quat, w_NB_B: Vec3) -> tuple[Vec3, Vec3]:
    """Angular rate and specific force of an IMU's reading (w_S, f_S); before the first, what a vehicle feels that does not accelerate."""
    if imu is None:
        return w_NB_B, rotate(conjugate(q_NB), (0.0, 0.0, -GRAVITY_MPS2))
    return imu[0], imu[1]
