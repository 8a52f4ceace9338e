"""What the adapters for autopilots ask of the server, and what they do not."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Sequence
from typing import Any

from uwserver.adapter import AdapterContext, CannotServe
from uwserver.frames import Quat, Vec3, conjugate, rotate
from uwserver.ports import Event, OnReply, Progress, Reply, Sample

_log = logging.getLogger(__name__)

GRAVITY_MPS2 = 9.80665


class Deaf:
    """A `Subscriber` of an adapter whose driver sees the samples in their tick: the loop has nothing to do with them."""

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Nothing."""

    def put_event(self, event: Event) -> None:
        """Nothing."""


def physics_hz(context: AdapterContext) -> float:
    """Ticks a second."""
    world: Any = context.describe("world/none")["world"]
    return float(world["rate_hz"])


async def stand_by(context: AdapterContext, ready: asyncio.Event) -> None:
    """Where the world is not in lockstep: say so and serve nobody, until cancelled. Else return at once."""
    found: list[Any] = []
    context.call("world/status", {}, context.name, lambda outcome: found.append(getattr(outcome, "result", None)))
    mode = found[0].get("mode") if found and isinstance(found[0], dict) else None
    if mode in (None, "lockstep"):
        return
    stats = context.stats
    stats.last_error = f'the world runs in mode {mode}: an autopilot in the loop needs [world.clock] mode = "lockstep"'
    _log.warning("%s: %s; nothing is served", context.name, stats.last_error)
    stats.state = "running"
    ready.set()
    await asyncio.get_running_loop().create_future()


def bound(kind: socket.SocketKind, bind: str, port: int) -> socket.socket:
    """A non-blocking socket at an address, for datagrams or to accept connections.

    Raises:
        CannotServe: there is no such address, or it is taken.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(bind, port, type=kind)[0]
        endpoint = socket.socket(family, kind)
        try:
            endpoint.setblocking(False)
            if kind == socket.SOCK_STREAM:
                endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            endpoint.bind(address)
            if kind == socket.SOCK_STREAM:
                endpoint.listen(8)
        except OSError:
            endpoint.close()
            raise
    except OSError as error:
        protocol = "tcp" if kind == socket.SOCK_STREAM else "udp"
        text = f"{protocol} {bind}:{port} cannot be bound: {error.strerror or error}"
        raise CannotServe(f"{text}; is another server running? Choose another port of the adapter") from error
    return endpoint


def failure() -> tuple[asyncio.Future[None], OnReply]:
    """A future that fails with the driver, and what to give to `AdapterContext.drive` for it."""
    failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def on_reply(outcome: Reply | Progress) -> None:
        if isinstance(outcome, Reply) and outcome.fault is not None and not failed.done():
            failed.set_exception(RuntimeError(outcome.fault.text))

    return failed, on_reply


def inertial(imu: Any, q_NB: Quat, w_NB_B: Vec3) -> tuple[Vec3, Vec3]:
    """Angular rate and specific force of an IMU's reading (w_S, f_S); before the first, what a vehicle feels that does not accelerate."""
    if imu is None:
        return w_NB_B, rotate(conjugate(q_NB), (0.0, 0.0, -GRAVITY_MPS2))
    return imu[0], imu[1]
