"""The `ardupilot_json` adapter: the simulator's side of `ardusub --model JSON`."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated

from msgspec import Meta

from uwserver.adapter import AdapterBase, CannotServe, bound_socket
from uwserver.ports import Sample
from uwserver.table import Name, PortNumber, Positive
from uwserver_adapters.ardupilot import wire
from uwserver_adapters.ardupilot.driver import COUNTS, ArduPilotDriver, State
from uwserver_adapters.ardupilot.dvl import DvlTable, MavlinkOut, Movement
from uwserver_adapters.sil.in_the_loop import Outputs, Scale, SilTable, drive, named_readings, stand_by

log = logging.getLogger(__name__)

LOOP_HZ = 400
"""Control rate of ArduSub. With slower physics the loop would run at the rate of the physics."""

PulseWidth = Annotated[int, Meta(ge=1, le=65535)]


class ArduPilotConfig(SilTable, tag="ardupilot_json", kw_only=True, frozen=True):
    """Attributes:
    port: UDP port; 0 takes a free one. Instance n of an autopilot sends to 9002 + 10 n.
    rangefinders: up to six ports with `range` or `altitude`, sent as rng_1 to rng_6.
    battery: port with `voltage` and `current`.
    low_us, neutral_us, high_us: pulse widths of full deflection and neutral.
    no_time_sync: tell the autopilot not to hold real time itself; then only `[world.clock] max_speed` limits the speed.
    silence_s: wall time after which a silent autopilot counts as gone.
    dvl: send a DVL as MAVLink messages; default: none is sent.
    """

    port: PortNumber = 9002
    rangefinders: Annotated[tuple[Name, ...], Meta(max_length=wire.RANGEFINDERS)] = ()
    battery: Name | None = None
    low_us: PulseWidth = 1100
    neutral_us: PulseWidth = 1500
    high_us: PulseWidth = 1900
    no_time_sync: bool = False
    silence_s: Positive = 3.0
    dvl: DvlTable | None = None

    def needs(self) -> Mapping[str, str]:
        """Return the module that a DVL needs: the dialect."""
        return {} if self.dvl is None else {"pymavlink.dialects.v20.ardupilotmega": "uwserver"}


class ArduPilotAdapter(AdapterBase[ArduPilotConfig]):
    """Waits for an autopilot, and steps the world together with it (docs/how-to/ardusub.md)."""

    Config = ArduPilotConfig

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled. Autopilots may come and go.

        Raises:
            CannotServe: the table does not fit the world, or the port cannot be bound.
            RuntimeError: the driver failed.
        """
        config, context = self.config, self.context
        await stand_by(context, ready)
        stats = context.stats
        stats.details.update(dict.fromkeys(COUNTS, 0))
        stats.details["frame_rate_hz"] = 0
        with bound_socket(config.bind, config.port, "udp") as endpoint:
            link = None if config.dvl is None else MavlinkOut(config.dvl.address)
            driver = self._driver(endpoint, link)
            sending = asyncio.ensure_future(link.run()) if link is not None else None
            try:
                await drive(context, config.client, driver, endpoint, ready)
            finally:
                if sending is not None:
                    sending.cancel()
                    await asyncio.gather(sending, return_exceptions=True)
                stats.peers = 0

    def _driver(self, endpoint: socket.socket, link: MavlinkOut | None) -> ArduPilotDriver:
        config, context = self.config, self.context
        ports = context.ports
        vehicle, readings, (pose, velocity, imu) = named_readings(config, ports)
        distances = [
            readings.subscribe("rangefinders", name, [("range",), ("altitude",)], keeps=False)
            for name in config.rangefinders
        ]
        battery = readings.subscribe("battery", config.battery, [("voltage", "current")]) if config.battery else None
        rate_hz = context.world.rate_hz
        for reading in (pose, velocity):
            if reading.rate_hz != rate_hz:
                text = f"{reading.path} must give a sample at every tick: set rate_hz = {rate_hz:g}"
                raise CannotServe(f"{text} in [vehicles.{vehicle}.truth]")
        if imu.rate_hz != rate_hz:
            log.warning(
                "%s has %g Hz, but the autopilot reads it at %g Hz, so it gets each sample several times", imu.path, imu.rate_hz, rate_hz
            )  # fmt: skip
        if rate_hz < LOOP_HZ:
            log.warning("the physics rate, %g Hz, is below the autopilot's loop rate of %d Hz", rate_hz, LOOP_HZ)
        movement = None
        if config.dvl is not None and link is not None:
            loop, send = asyncio.get_running_loop(), link.send
            dvl = readings.subscribe("dvl", config.dvl.port, [("v_S", "figure_of_merit")], keeps=False)
            movement = Movement(config.dvl, dvl, imu, lambda data: _soon(loop, send, data))

        def see(t_ns: int, samples: Sequence[Sample]) -> None:
            readings.see(samples)
            if movement is not None:
                movement.see(t_ns)

        driver = ArduPilotDriver(
            endpoint,
            Outputs(config.outputs, ports, vehicle),
            Scale(config.low_us, config.neutral_us, config.high_us),
            State(pose, velocity, imu, distances, battery, config.no_time_sync),
            see,
            rate_hz,
            config.silence_s,
            asyncio.get_running_loop().time,
            context.stats,
            context.tell_conflict,
        )
        driver.subscriptions = readings.subscriptions
        return driver


def _soon(loop: asyncio.AbstractEventLoop, send: Callable[[bytes], None], data: bytes) -> None:
    with contextlib.suppress(RuntimeError):  # the loop is closed, because the server has ended
        loop.call_soon_threadsafe(send, data)
