"""How adapters for autopilots in the loop use the server: they step the world in lockstep, or stand by."""

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


class NoSamples:
    """A `Subscriber` that takes nothing, for an adapter whose driver sees the samples on the simulation thread."""

    subscriptions: Collection[str] = ()

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Ignore the samples."""

    def put_event(self, event: Event) -> None:
        """Ignore the event."""


async def stand_by(context: AdapterContext, ready: asyncio.Event) -> None:
    """Return at once if the world is in lockstep. Otherwise report that nothing is served, and wait until cancelled."""
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
    """Let a driver step the world until cancelled. After this returns, the driver is no longer called.

    Args:
        context: the adapter's context.
        client: name in the scenario's `lockstep_clients`; default: the adapter's name.
        driver: the driver.
        endpoint: socket at which its peer finds it.
        ready: the event that `Adapter.run` got.

    Raises:
        CannotServe: the world does not accept the driver.
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
        with serving(context, NoSamples(), address_text(*endpoint.getsockname()[:2]), ready):
            await failed
    finally:
        end()


def inertial(imu: Any, q_NB: Quat, w_NB_B: Vec3) -> tuple[Vec3, Vec3]:
    """Return angular rate and specific force of an IMU's reading (w_S, f_S). Before the first, return those of a vehicle without acceleration."""
    if imu is None:
        return w_NB_B, rotate(conjugate(q_NB), (0.0, 0.0, -GRAVITY_MPS2))
    return imu[0], imu[1]
