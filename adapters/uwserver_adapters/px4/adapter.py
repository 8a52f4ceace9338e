"""The `px4_hil` adapter: the simulator's side of PX4's MAVLink simulator interface."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING

from msgspec import field

from uwserver.adapter import AdapterBase, CannotServe, bound_socket, install_command
from uwserver.table import Name, NonNegative, PortNumber, Positive, Table
from uwserver_adapters.px4.sensor_messages import Roles, SensorMessages
from uwserver_adapters.sil.in_the_loop import Outputs, SilTable, drive, named_readings, stand_by

if TYPE_CHECKING:
    from uwserver_adapters.px4.driver import Px4Driver

_GPS = (
    "latitude", "longitude", "height", "v_NS", "horizontal_accuracy", "vertical_accuracy", "satellites", "fix",
)  # fmt: skip


class DistanceTable(Table, kw_only=True, frozen=True):
    """A sensor that looks down, sent as DISTANCE_SENSOR.

    Attributes:
        port: port with `range` or `altitude`.
        min_m, max_m: its limits, as they are told to the autopilot.
    """

    port: Name
    min_m: NonNegative = 0.3
    max_m: Positive = 100.0


class Px4Config(SilTable, tag="px4_hil", kw_only=True, frozen=True):
    """Attributes:
    port: TCP port; 0 takes a free one. Instance n of an autopilot connects to 4560 + n.
    imu: port with `f_S` and `w_S`, mounted along the vehicle's axes; its rate is the rate of the lock-step, for PX4 250 Hz.
    pose: port with `p_NB` and `q_NB`, for ground truth and odometry.
    velocity: port with `v_NB_B` and `w_NB_B`, for ground truth and odometry.
    magnetometer: port with `field_S`, mounted along the vehicle's axes.
    depth: port with `depth`, sent as the air pressure at that depth below sea level, because PX4 knows no water.
    gps: port of kind gps.
    distances: sensors that look down.
    odometry_hz: rate at which the pose is sent as ODOMETRY; 0 for never.
    odometry_sigma: standard deviations of ODOMETRY, as they are told to the autopilot: position (m), attitude (rad), velocity (m/s).
    origin_deg: latitude and longitude of N's origin, for the ground truth in the autopilot's log.
    """

    port: PortNumber = 4560
    magnetometer: Name | None = None
    depth: Name | None = None
    gps: Name | None = None
    distances: dict[Name, DistanceTable] = field(default_factory=dict)
    odometry_hz: NonNegative = 30.0
    odometry_sigma: tuple[Positive, Positive, Positive] = (0.05, 0.02, 0.05)
    origin_deg: tuple[float, float] = (47.397742, 8.545594)

    def needs(self) -> Mapping[str, str]:
        """Return the module that is needed: the dialect."""
        return {"pymavlink.dialects.v20.common": "uwserver"}


class Px4Adapter(AdapterBase[Px4Config]):
    """Waits for an autopilot, and steps the world together with it (docs/how-to/px4.md)."""

    Config = Px4Config

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled. Autopilots may come and go.

        Raises:
            CannotServe: the table does not fit the world, the port cannot be bound, or pymavlink is not installed.
            RuntimeError: the driver failed.
        """
        config, context = self.config, self.context
        await stand_by(context, ready)
        with bound_socket(config.bind, config.port, "tcp") as listener:
            driver = self._driver(listener)
            try:
                await drive(context, config.client, driver, listener, ready)
            finally:
                driver.close()

    def _driver(self, listener: socket.socket) -> Px4Driver:
        try:
            from uwserver_adapters.px4 import driver  # needs pymavlink, an extra
        except ImportError as error:
            raise CannotServe(f"px4_hil needs pymavlink: {install_command('uwserver')} ({error})") from error
        config, context = self.config, self.context
        ports = context.ports
        vehicle, readings, (pose, velocity, imu) = named_readings(config, ports)
        roles = Roles(
            imu,
            pose,
            velocity,
            readings.subscribe("magnetometer", config.magnetometer, [("field_S",)]) if config.magnetometer else None,
            readings.subscribe("depth", config.depth, [("depth", "temperature")]) if config.depth else None,
            readings.subscribe("gps", config.gps, [_GPS], keeps=False) if config.gps else None,
            tuple(
                (readings.subscribe(f"distances.{name}", table.port, [("range",), ("altitude",)], keeps=False), (table.min_m, table.max_m))
                for name, table in config.distances.items()
            ),
        )  # fmt: skip
        ticks = round(context.world.rate_hz / imu.rate_hz)
        context.stats.details.update(dict.fromkeys(driver.COUNTS, 0))
        context.stats.details["is_locked"] = False
        odometry_s = 1.0 / config.odometry_hz if config.odometry_hz else 0.0
        sensors = SensorMessages(readings, roles, config.origin_deg, odometry_s, config.odometry_sigma)
        outputs = Outputs(config.outputs, ports, vehicle)
        steady = asyncio.get_running_loop().time
        return driver.Px4Driver(
            listener, outputs, sensors, ticks, 1.0 / imu.rate_hz, steady, context.stats, context.tell_conflict
        )
