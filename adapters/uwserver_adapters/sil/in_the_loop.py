"""What adapters for autopilots in the loop share: the tables of their readings and outputs, and how they step the world in lockstep or stand by."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any

from msgspec import Meta, field

from uwserver.adapter import (
    AdapterContext,
    AdapterTable,
    CannotServe,
    Driver,
    Reading,
    Readings,
    address_text,
    field_of,
    port_of,
    serving,
    vehicle_of,
)
from uwserver.frames import Quat, Vec3, conjugate, rotate
from uwserver.ports import Event, Field, Port, Progress, Refused, Reply, Sample
from uwserver.table import Name, Table
from uwserver_adapters.sil.codec import radians

Channel = Annotated[int, Meta(ge=1, le=32)]
GRAVITY_MPS2 = 9.80665


class Scale(dict[int, float]):
    """Limited deflection (-1 to 1) of each pulse width (us), computed once for each width; 0 for an output that is not driven (0 us).

    Args:
        low, neutral, high: pulse widths of full deflection and neutral, us.

    Attributes:
        outside: pulse widths that were limited.

    Raises:
        CannotServe: the pulse widths are not in this order.
    """

    def __init__(self, low: int = 1100, neutral: int = 1500, high: int = 1900) -> None:
        super().__init__({0: 0.0})
        if not low < neutral < high:
            raise CannotServe("the pulse widths must be low_us < neutral_us < high_us")
        self._low, self._neutral, self._high = low, neutral, high
        self.outside: set[int] = set()

    def __missing__(self, pwm: int) -> float:
        above = pwm - self._neutral
        level = above / (self._high - self._neutral if above > 0 else self._neutral - self._low)
        if abs(level) > 1.0:
            self.outside.add(pwm)
        self[pwm] = limited = min(max(level, -1.0), 1.0)
        return limited


class OutputTable(Table, kw_only=True, frozen=True):
    """Servo channels that move one field of an actuator.

    Attributes:
        port: actuator below the vehicle (`thrusters`), or its whole path.
        field: the actuator's field.
        channels: one channel for each component, counted from 1; default: the first ones.
        full: value at a channel's full deflection, for all components or each; a negative value reverses the channel.
        full_deg: the same in degrees, for fields in radians.
    """

    port: Name = "thrusters"
    field: Name = "u"
    channels: tuple[Channel, ...] = ()
    full: float | tuple[float, ...] | None = None
    full_deg: float | tuple[float, ...] | None = None


class SilTable(AdapterTable, kw_only=True, frozen=True):
    """The keys that all of these adapters have.

    Attributes:
        bind: address to listen at; whoever can reach it moves the vehicle.
        client: name in the scenario's `lockstep_clients`; default: the adapter's name.
        vehicle: vehicle with the sensors and actuators; default: the only one there is.
        imu: port with `f_S` and `w_S`, mounted along the vehicle's axes.
        pose: port with `p_NB` and `q_NB`.
        velocity: port with `v_NB_B` and `w_NB_B`.
        outputs: what the autopilot's outputs move; default: the vehicle's `thrusters`, by outputs 1 to n.
    """

    bind: Name = "127.0.0.1"
    client: Name | None = None
    vehicle: Name | None = None
    imu: Name = "imu"
    pose: Name = "truth/pose"
    velocity: Name = "truth/velocity"
    outputs: dict[Name, OutputTable] = field(default_factory=dict)


def named_readings(
    table: SilTable, ports: Mapping[str, Port]
) -> tuple[str, Readings, tuple[Reading, Reading, Reading]]:
    """Return the vehicle of a table, all readings of its adapter, and among them those of pose, velocity and IMU.

    Raises:
        CannotServe: the table does not serve the truth, or a vehicle or port does not exist.
    """
    if not table.truth:
        raise CannotServe("position, velocity and attitude in this protocol are ground truth: set truth = true")
    vehicle = vehicle_of(table.vehicle, ports)
    readings = Readings(ports, vehicle)
    pose = readings.subscribe("pose", table.pose, [("p_NB", "q_NB")])
    velocity = readings.subscribe("velocity", table.velocity, [("v_NB_B", "w_NB_B")])
    return vehicle, readings, (pose, velocity, readings.subscribe("imu", table.imu, [("w_S", "f_S")]))


class Output:
    """One field of an actuator that exists in the world.

    Attributes:
        path, field: the actuator's path, and the name of the field.
        channels: one channel for each component, from 0.

    Raises:
        CannotServe: the actuator or field does not exist, or the numbers of the table do not fit it.
    """

    def __init__(self, name: str, table: OutputTable, ports: Mapping[str, Port], vehicle: str) -> None:
        where = f"outputs.{name}"
        port = port_of(where, table.port, ports, vehicle, "actuator")
        field = field_of(where, port, table.field)
        self.path = port.path
        self.field = field.name
        self._is_scalar = not field.shape
        channels = table.channels or tuple(range(1, field.size + 1))
        full = _full(where, table, field)
        for what, count in (("channels", len(channels)), ("full", len(full))):
            if count != field.size:
                raise CannotServe(f'{where}: {what} has {count} numbers, "{field.name}" has {field.size} components')
        self.channels = tuple(channel - 1 for channel in channels)
        self._parts = list(zip(self.channels, full, strict=True))

    def value(self, levels: Sequence[float]) -> float | list[float]:
        """Return the field's value for deflections (-1 to 1) by channel. A channel that is not among them is neutral."""
        n = len(levels)
        value = [levels[channel] * full if channel < n else 0.0 for channel, full in self._parts]
        return value[0] if self._is_scalar else value


def _full(where: str, table: OutputTable, field: Field) -> tuple[float, ...]:
    if table.full_deg is None:
        full = 1.0 if table.full is None else table.full
        return (full,) * field.size if isinstance(full, int | float) else full
    if table.full is not None or field.unit != "rad":
        raise CannotServe(
            f'{where}: "{field.name}" is in {field.unit}: full_deg is for radians, and not together with full'
        )
    degrees = table.full_deg
    return (radians(degrees),) * field.size if isinstance(degrees, int | float) else tuple(map(radians, degrees))


class Outputs:
    """All actuators that an autopilot moves. Without tables these are the vehicle's `thrusters`, by the first channels.

    Raises:
        CannotServe: see `Output`.
    """

    def __init__(self, tables: Mapping[str, OutputTable], ports: Mapping[str, Port], vehicle: str) -> None:
        chosen = tables or {"thrusters": OutputTable()}
        self._fields: dict[str, list[Output]] = {}
        for name, table in chosen.items():
            output = Output(name, table, ports, vehicle)
            self._fields.setdefault(output.path, []).append(output)

    def channels(self, n: int) -> list[int]:
        """Return which of the first n channels move something, from 0."""
        return sorted({c for outputs in self._fields.values() for output in outputs for c in output.channels if c < n})

    def commands(self, levels: Sequence[float]) -> list[tuple[str, dict[str, object]]]:
        """Return the commands for deflections (-1 to 1) by channel."""
        return [
            (path, {output.field: output.value(levels) for output in outputs}) for path, outputs in self._fields.items()
        ]


log = logging.getLogger(__name__)


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
