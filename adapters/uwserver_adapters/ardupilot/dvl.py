"""The DVL for ArduPilot, sent over MAVLink as a companion computer would, because the simulator interface has no field for it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Annotated, Any, cast

from msgspec import Meta

from uwserver.adapter import CannotServe, Reading, install_command
from uwserver.frames import Vec3
from uwserver.table import Name, Positive, Table
from uwserver_adapters.sil.codec import nanoseconds, seconds

log = logging.getLogger(__name__)

RETRY_S = 0.5
"""Wall time between two attempts to connect."""
WAITING = 1 << 16
"""Bytes that may be buffered for an autopilot that does not read. Above, messages are dropped."""
LONGEST_S = 1.0
"""Longest simulation time between two measurements from which a movement is computed."""
MICROSECOND_NS = 1000


class DvlTable(Table, kw_only=True, frozen=True):
    """A DVL, sent as VISION_POSITION_DELTA.

    Attributes:
        port: port with `v_S` and `figure_of_merit`, mounted along the vehicle's axes.
        address: MAVLink port of the autopilot: "tcp:<host>:<port>" or "udp:<host>:<port>".
        worst_mps: figure of merit at which the confidence is zero; at a figure of 0 it is 100 %.
        system, component: sender of the messages.
    """

    port: Name = "dvl"
    address: Annotated[str, Meta(pattern=r"^(tcp|udp):[^:]+:\d+$")] = "tcp:127.0.0.1:5762"
    worst_mps: Positive = 0.4
    system: Annotated[int, Meta(ge=1, le=255)] = 1
    component: Annotated[int, Meta(ge=1, le=255)] = 197


class Movement:
    """Turns measurements into messages: rotation and displacement between two measurements of the DVL. Runs on the simulation thread.

    Args:
        table: the settings.
        dvl: v_S and figure_of_merit.
        imu: w_S and f_S of every tick.
        send: takes the messages; must not block.

    Raises:
        CannotServe: pymavlink is not installed.
    """

    def __init__(self, table: DvlTable, dvl: Reading, imu: Reading, send: Callable[[bytes], None]) -> None:
        try:
            from pymavlink.dialects.v20 import ardupilotmega
        except ImportError as error:
            raise CannotServe(f"dvl needs pymavlink: {install_command('uwserver')} ({error})") from error
        self._mav = ardupilotmega.MAVLink(None, table.system, table.component)
        self._worst = table.worst_mps
        self._dvl = dvl
        self._imu = imu
        self._send = send
        self._seen = 0
        self._last_ns: int | None = None
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self._angle = [0.0, 0.0, 0.0]
        self._tick_ns = 0

    def see(self, t_ns: int) -> None:
        """Take the readings at the end of a tick."""
        imu: Any = self._imu.values
        step = t_ns - self._tick_ns
        self._tick_ns = t_ns
        if step < 0:  # the world was reset to an earlier time
            self._last_ns = None
        elif imu is not None:
            dt = seconds(step)
            self._angle = [angle + rate * dt for angle, rate in zip(self._angle, imu[0], strict=True)]
        if self._dvl.count != self._seen:
            self._seen = self._dvl.count
            self._measured()

    def _measured(self) -> None:
        velocity, merit = cast("tuple[Vec3, float]", self._dvl.values)
        now, last = self._dvl.t_ns, self._last_ns
        if last is not None and 0 < now - last <= nanoseconds(LONGEST_S):
            half = seconds(now - last) / 2.0
            shift = [(a + b) * half for a, b in zip(self._velocity, velocity, strict=True)]
            confidence = 100.0 * max(0.0, 1.0 - merit / self._worst)
            message = self._mav.vision_position_delta_encode(
                now // MICROSECOND_NS, (now - last) // MICROSECOND_NS, self._angle, shift, confidence
            )
            self._send(bytes(message.pack(self._mav)))
            self._mav.seq = (self._mav.seq + 1) % 256
        self._last_ns, self._velocity, self._angle = now, velocity, [0.0, 0.0, 0.0]


class MavlinkOut(asyncio.Protocol, asyncio.DatagramProtocol):
    """Connects to an autopilot again and again, and only sends. Runs on the loop thread."""

    def __init__(self, address: str) -> None:
        kind, host, port = address.split(":")
        self._kind, self._host, self._port = kind, host, int(port)
        self._transport: Any = None
        self._gone = asyncio.Event()
        self.dropped = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport."""
        self._transport = transport

    def connection_lost(self, error: Exception | None) -> None:
        """Note that the connection has ended."""
        self._transport = None
        self._gone.set()

    def error_received(self, error: Exception) -> None:
        """Ignore that nobody listens at the port. The next message may be received."""

    def send(self, data: bytes) -> None:
        """Send a message, or drop it without a connection or when the peer does not read."""
        if self._transport is None or self._transport.get_write_buffer_size() > WAITING:
            self.dropped += 1
        elif self._kind == "udp":
            self._transport.sendto(data)
        else:
            self._transport.write(data)

    async def run(self) -> None:
        """Connect, and connect again after each end, until cancelled."""
        loop = asyncio.get_running_loop()
        try:
            while True:
                self._gone.clear()
                with contextlib.suppress(OSError):
                    if self._kind == "udp":
                        await loop.create_datagram_endpoint(lambda: self, remote_addr=(self._host, self._port))
                    else:
                        await loop.create_connection(lambda: self, self._host, self._port)
                    log.info("the DVL is connected to %s:%d", self._host, self._port)
                    await self._gone.wait()
                await asyncio.sleep(RETRY_S)
        finally:
            if self._transport is not None:
                self._transport.abort()
                await asyncio.sleep(0)  # asyncio closes the socket in the next turn of the loop
