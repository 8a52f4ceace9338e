"""ArduPilot's MORSE backend (`SIM_Morse`): it connects to two TCP ports, reads sensors as lines on one, and writes servo channels to the other.

It is not in lockstep: it goes on by itself between two lines. The adapter `ardupilot_json` is the better way; this one is for set-ups that exist.
Its reader does not parse JSON but looks for texts: ``timestamp`` must come first, one blank must follow each colon and comma, and a section must
have all keys.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from typing import Any

from uwserver.adapter import (
    AdapterContext,
    CannotServe,
    Connection,
    Conversation,
    Lines,
    Peers,
    Readings,
    Refusals,
    Undecodable,
    decode,
    serve_tcp,
    vehicle_of,
)
from uwserver.frames import frd_from_flu, rotate, rpy_from_quat
from uwserver.ports import Refused, Sample
from uwserver_adapters.morse import codec
from uwserver_adapters.morse.config import AutopilotTable, MorseConfig
from uwserver_adapters.sil.in_the_loop import Outputs, Scale

LINE_LIMIT = 4096
"""Longest line of the autopilot, bytes. It writes some 150."""
CHANNELS = 16
"""Most servo channels in a line."""
_STRAY = re.compile(rb"(\d)f")
"""ArduPilot writes 1500f for every fourth channel from the second on, by a typing error in its format text."""


def sensors(
    vehicle: str, t_s: float, imu: Sequence[Any], p_NB: Sequence[float], q_NB: Sequence[float], v_NB_B: Sequence[float]
) -> bytes:
    """Return a line of sensors. The world is north, west, up, and the body forward, left, up, as ArduPilot's source turns them back.

    Args:
        vehicle: name of the vehicle, which begins each section.
        t_s: simulation time, s.
        imu: w_S (rad/s) and f_S (m/s^2), along the axes of B.
        p_NB: position, m.
        q_NB: attitude.
        v_NB_B: velocity, m/s.
    """
    roll, pitch, yaw = rpy_from_quat(q_NB)
    x, y, z = frd_from_flu(p_NB)  # from north, east, down to north, west, up: the same two signs
    said = {
        "timestamp": t_s,
        f"{vehicle}.imu": {
            "angular_velocity": list(frd_from_flu(imu[0])),
            "linear_acceleration": list(frd_from_flu(imu[1])),
            "magnetic_field": [0.0, 0.0, 0.0],  # ArduPilot wants this key, and does not use it
        },
        f"{vehicle}.gps": {"x": x, "y": y, "z": z},
        f"{vehicle}.pose": {"roll": roll, "pitch": -pitch, "yaw": -yaw},
        f"{vehicle}.velocity": {"world_linear_velocity": list(frd_from_flu(rotate(q_NB, v_NB_B)))},
    }
    return json.dumps(said).encode() + b"\n"


def pulses(line: bytes) -> list[int]:
    """Return the pulse widths (us) of the servo channels in a line of the autopilot; 0 is no output.

    Raises:
        Refused: it is no such line.
    """
    try:
        said = decode(_STRAY.sub(rb"\1", line), "json")
    except Undecodable as error:
        raise Refused("parse_error", f"a line of the autopilot is no JSON: {error}") from None
    widths = said.get("pwm") if isinstance(said, dict) else None
    if not isinstance(widths, list) or not 0 < len(widths) <= CHANNELS:
        raise Refused(
            "bad_argument", "the autopilot writes no pulse widths: start it with --model morse-pwm:HOST:SENSORS:CONTROL"
        )
    if not all(isinstance(width, int) and not isinstance(width, bool) and 0 <= width <= 65535 for width in widths):
        raise Refused("out_of_range", "pulse widths are whole numbers from 0 to 65535 us")
    return widths


class Autopilot:
    """The two ports for the autopilot.

    Args:
        table: table of the autopilot.
        config: config of the adapter.
        context: the world.

    Attributes:
        subscriptions: paths of the ports that a line of sensors needs.

    Raises:
        CannotServe: the table and the world do not fit.
    """

    def __init__(self, table: AutopilotTable, config: MorseConfig, context: AdapterContext) -> None:
        if not config.truth:
            raise CannotServe(
                "position, velocity and attitude of this protocol are ground truth, by its nature: say truth = true"
            )
        self._table, self._config, self._context = table, config, context
        ports = context.ports
        self._vehicle = vehicle_of(table.vehicle, ports)
        readings = Readings(ports, self._vehicle)
        self._pose = readings.subscribe("ardupilot.pose", table.pose, [("p_NB", "q_NB")])
        self._velocity = readings.subscribe("ardupilot.velocity", table.velocity, [("v_NB_B",)])
        self._imu = readings.subscribe("ardupilot.imu", table.imu, [("w_S", "f_S")])
        self._readings = readings
        self.subscriptions: Collection[str] = readings.subscriptions
        self._outputs = Outputs(table.outputs, ports, self._vehicle)
        self._scale = Scale(table.low_us, table.neutral_us, table.high_us)
        self._listeners: set[_Sensors] = set()

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[None]:
        """Keep both ports open while the context is."""
        table, config, context = self._table, self._config, self._context
        refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        sensing: Peers[_Sensors] = Peers(4, refusals)
        controlling: Peers[_Control] = Peers(1, refusals)
        sensors_server = serve_tcp(
            lambda: _Sensors(sensing, self._listeners), sensing, config.bind, table.sensors_port, key="ardupilot.sensors_port"
        )  # fmt: skip
        control_server = serve_tcp(
            lambda: _Control(controlling, self._control, context), controlling, config.bind, table.control_port,
            key="ardupilot.control_port",
        )  # fmt: skip
        async with sensors_server as a, control_server as b:
            context.stats.details["ardupilot"] = f"--model morse-pwm:{config.bind}:{a.port}:{b.port}"
            yield

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send a line in each tick in which the pose comes."""
        self._readings.see(samples)
        pose, velocity, imu = self._pose, self._velocity, self._imu
        if not self._listeners or pose.values is None or velocity.values is None or imu.values is None:
            return
        if not any(sample.port == pose.path for sample in samples):
            return
        line = sensors(self._vehicle, codec.seconds(pose.t_ns), imu.values, *pose.values, *velocity.values)  # type: ignore[arg-type]  # vectors
        for listener in list(self._listeners):
            if listener.waiting <= self._config.queue_bytes:
                listener.write(line)

    def _control(self, peer: Conversation, line: bytes) -> None:
        """Carry out a line of the autopilot. Raises Refused."""
        levels = [self._scale[width] for width in pulses(line)]
        for path, value in self._outputs.commands(levels):
            peer.command(path, value)


class _Sensors(Connection):
    """The connection by which the autopilot reads sensors."""

    def __init__(self, peers: Peers[Any], listeners: set[_Sensors]) -> None:
        super().__init__(peers)
        self._listeners = listeners

    def opened(self) -> None:
        self._listeners.add(self)

    def closed(self) -> None:
        self._listeners.discard(self)

    def receive(self, data: bytes) -> None:
        """Ignore what comes: the autopilot writes nothing here."""

    def step(self) -> bool:
        return False


class _Control(Connection):
    """The connection by which the autopilot writes servo channels."""

    def __init__(
        self, peers: Peers[Any], control: Callable[[Conversation, bytes], None], context: AdapterContext
    ) -> None:
        super().__init__(peers, stats=context.stats)
        self._control = control
        self._lines = Lines(LINE_LIMIT)
        self._conversation = Conversation(context, "ardupilot")

    def closed(self) -> None:
        self._conversation.close()

    def receive(self, data: bytes) -> None:
        self._lines.receive(data)

    def step(self) -> bool:
        try:
            line = self._lines.next_line()
            if line is None:
                return False
            self._control(self._conversation, line)
        except Refused as refused:  # only counted: the autopilot reads no answers
            self._stats.count_error(refused.fault.text)
        return True
