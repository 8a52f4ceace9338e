"""Water Linked A50: lines of JSON on TCP port 16171, by its TCP JSON API 3.3 (docs.waterlinked.com, DVL A50/A125)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any, cast

import msgspec
from msgspec import Meta, Struct

from uwserver.adapter import AdapterContext, Undecodable, decode
from uwserver.frames import Quat, Vec3, rotate, rpy_from_quat
from uwserver.ports import Sample
from uwserver.table import Name, PortNumber, Positive
from uwserver_adapters.devices.codec import FULL_TURN_DEG, NANOSECONDS, deg, rad
from uwserver_adapters.devices.device import DeviceInput, DeviceTable, LineReader, Reply, set_at_sensor

REMEMBERED = 256
"""Attitudes that are kept: the velocity of a ping arrives later than the attitude of the same time."""
GAP_S = 1.0
"""Simulation time for which a velocity holds. After that the position stands still until the next one."""
PORT = 16171
FORMAT = "json_v3.3"
LINE_LIMIT = 4096
"""Longest command, bytes. The longest documented one has some 200."""
POSITION_NS = NANOSECONDS // 5
"""Simulation time between two reports of the position: 5 Hz."""
TRIGGERS = 15
"""Most pings that clients may have requested and not received yet."""
NO_LOCK = -1.0
"""Altitude and distance where no echo came."""
MICROSECOND = 1000
"""A microsecond, ns."""
FIELDS = ("v_S", "altitude", "figure_of_merit", "covariance_S", "beam_velocities", "beam_ranges", "beam_locks")
_COMMANDS = ("get_config", "set_config", "reset_dead_reckoning", "calibrate_gyro", "trigger_ping", "get_version_info")
_MODES = {"auto": -1, **{f"={number}": number for number in range(5)}}
"""Range modes that can be simulated, and the numbers that the sensor has for them."""


class DeadReckoning:
    """Integrates velocities. The origin of the frame is the position at the start, z is down, and x is the horizontal direction in which x of the
    device pointed at the start.

    Attributes:
        variance: variance of each axis of the position, m^2. The errors of pings are taken as independent.
    """

    def __init__(self) -> None:
        self._attitudes: deque[tuple[int, Quat]] = deque(maxlen=REMEMBERED)
        self.reset()

    def reset(self) -> None:
        """Set position and heading to zero."""
        newest = self._attitudes[-1][1] if self._attitudes else None
        self._yaw0: float | None = None if newest is None else rpy_from_quat(newest)[2]
        self._p: Vec3 = (0.0, 0.0, 0.0)
        self._v: Vec3 = (0.0, 0.0, 0.0)
        self._v_ns = -1
        self.variance = 0.0

    def forget(self) -> None:
        """Start again at another time."""
        self._attitudes.clear()
        self.reset()

    @property
    def t_ns(self) -> int:
        """Simulation time of the newest attitude; -1 before the first."""
        return self._attitudes[-1][0] if self._attitudes else -1

    def see_attitude(self, t_ns: int, q: Quat) -> None:
        """Take the device's attitude in N, w x y z."""
        self._attitudes.append((t_ns, q))
        if self._yaw0 is None:
            self._yaw0 = rpy_from_quat(q)[2]

    def see_velocity(self, t_ns: int, v: Vec3, sigma: float) -> None:
        """Take the device's velocity over ground along its own axes, m/s, and its standard deviation."""
        if not self._attitudes:
            return
        _, q = min(self._attitudes, key=lambda entry: abs(entry[0] - t_ns))
        before, self._v = self._v, rotate(q, v)
        dt = (t_ns - self._v_ns) / NANOSECONDS
        if self._v_ns >= 0 and 0.0 < dt <= GAP_S:
            # The trapezoidal rule: the mean of the velocities at both ends.
            x, y, z = (p + 0.5 * (a + b) * dt for p, a, b in zip(self._p, before, self._v, strict=True))
            self._p = (x, y, z)
            self.variance += (sigma * dt) ** 2
        self._v_ns = t_ns

    @property
    def is_tracking(self) -> bool:
        """Whether the last velocity still holds."""
        return self._v_ns >= 0 and abs(self.t_ns - self._v_ns) <= GAP_S * NANOSECONDS

    def position(self) -> Vec3:
        """Return the position at the time of the newest attitude, m."""
        x, y, z = self._p
        if self.is_tracking:
            ahead = (self.t_ns - self._v_ns) / NANOSECONDS
            x, y, z = x + self._v[0] * ahead, y + self._v[1] * ahead, z + self._v[2] * ahead
        c, s = math.cos(self._yaw0 or 0.0), math.sin(self._yaw0 or 0.0)
        return c * x + s * y, c * y - s * x, z

    def attitude(self) -> Vec3:
        """Return roll, pitch and yaw, rad; yaw is relative to the start, within half a turn."""
        roll, pitch, yaw = rpy_from_quat(self._attitudes[-1][1])
        return roll, pitch, math.remainder(yaw - (self._yaw0 or 0.0), 2.0 * math.pi)


class WaterLinkedA50Table(DeviceTable, tag="water_linked_a50", kw_only=True, frozen=True):
    """Attributes:
    sensor: the DVL (``rov/dvl``).
    attitude: attitude sensor (`q_NS`), mounted as the DVL; with it the device reckons its position, and reports it 5 times a second.
    speed_of_sound_mps: speed that `get_config` tells until a client sets another; give the sensor's `assumed_sound_speed_mps`.
    """

    sensor: Name
    tcp_port: PortNumber | None = PORT
    attitude: Name | None = None
    speed_of_sound_mps: Positive = 1500.0

    def build(self, context: AdapterContext) -> WaterLinkedA50:
        """Return the device."""
        return WaterLinkedA50(self, context)


class Configuration(Struct, frozen=True, forbid_unknown_fields=True):
    """The configuration that `get_config` tells, with the units and limits of the device's documentation."""

    speed_of_sound: Annotated[float, Meta(ge=1000, le=2000)] = 1500.0
    acoustic_enabled: bool = True
    dark_mode_enabled: bool = False
    mounting_rotation_offset: Annotated[float, Meta(ge=0, le=FULL_TURN_DEG)] = 0.0
    range_mode: str = "auto"
    periodic_cycling_enabled: bool = True


class WaterLinkedA50:
    """The device.

    Attributes:
        subscriptions: its ports.
        configuration: the present configuration.
        reckoning: reckons its position.
    """

    def __init__(self, table: WaterLinkedA50Table, context: AdapterContext) -> None:
        self._context = context
        self._source = DeviceInput("sensor", table.sensor, context.ports, FIELDS)
        self._attitude = table.attitude and DeviceInput("attitude", table.attitude, context.ports, ("q_NS",))
        self.subscriptions: Collection[str] = {source.path for source in (self._source, self._attitude) if source}
        self.configuration = Configuration(speed_of_sound=table.speed_of_sound_mps)
        self.reckoning = DeadReckoning()
        self._reported_ns = -1
        self._position_ns = -POSITION_NS
        self._triggers = 0
        self._commands: dict[str, Callable[[], object]] = {
            "get_config": lambda: msgspec.to_builtins(self.configuration),
            "reset_dead_reckoning": self.reckoning.reset,
            "calibrate_gyro": lambda: None,
            "trigger_ping": self._trigger_ping,
            "get_version_info": self._version_info,
        }

    def reader(self) -> LineReader[bytes]:
        """Return a reader of lines."""
        return LineReader(LINE_LIMIT, bytes)

    def reset(self) -> None:
        """Start again at another time; the configuration stays, as in a real device."""
        self.reckoning.forget()
        self._reported_ns, self._position_ns = -1, -POSITION_NS

    # -- commands -------------------------------------------------------------------------------------------------------------------

    def take(self, message: bytes, reply: Reply) -> str:
        """Carry out a command. Every line that comes gets an answer."""
        try:
            said = decode(message, "json")
        except Undecodable as error:
            reply(response("", f"this is no JSON: {error}"))
            return f"a line is no JSON: {error}"
        name = said.get("command") if isinstance(said, dict) else None
        if not isinstance(said, dict) or not isinstance(name, str):
            reply(response("", 'a command has the form {"command": "get_config"}'))
            return "a line holds no command"
        if name == "set_config":
            self._set_config(said.get("parameters"), reply)
            return ""
        if name not in self._commands:
            text = f"this simulated device does not know the command, it knows: {', '.join(_COMMANDS)}"
            reply(response(name[:100], text))
            return "a command is not known"
        try:
            reply(response(name, result=self._commands[name]()))
        except ValueError as error:
            reply(response(name, str(error)))
        return ""

    def _trigger_ping(self) -> None:
        if self._triggers >= TRIGGERS:
            raise ValueError(f"{TRIGGERS} pings are asked for already: wait for their reports")
        self._triggers += 0 if self.configuration.acoustic_enabled else 1

    def _version_info(self) -> Mapping[str, object]:
        return {
            "chipid": "0x0", "hardware_revision": 4, "product_id": 21035, "product_name": "DVL A50", "variant": "standard",
            "version_short": "2.7.2", "version": f"2.7.2 (simulated by {self._context.world.server})", "is_ready": True,
        }  # fmt: skip

    def _set_config(self, parameters: object, reply: Reply) -> None:
        """Change the configuration, as a whole or not at all."""

        def refuse(text: str) -> None:
            reply(response("set_config", text))

        if not isinstance(parameters, dict) or not parameters:
            refuse('give what is to be set: {"command":"set_config","parameters":{"speed_of_sound":1480}}')
            return
        changes = cast(dict[str, Any], parameters)
        try:
            wanted = self._changed(changes)
        except msgspec.ValidationError as error:
            refuse(str(error))
            return
        if wanted.range_mode not in _MODES:
            refuse(f"range_mode {wanted.range_mode[:20]} is not simulated: use {', '.join(_MODES)}")
            return
        settings: dict[str, object] = {}
        if "speed_of_sound" in changes:
            settings["sound_speed"] = wanted.speed_of_sound
        if "range_mode" in changes:
            settings["range_mode"] = _MODES[wanted.range_mode]

        def done(fault: str) -> None:
            if fault:
                refuse(fault)
                return
            # Another command may have changed other settings meanwhile, so only these are changed.
            self.configuration = self._changed(changes)
            self._triggers = 0 if self.configuration.acoustic_enabled else self._triggers
            reply(response("set_config"))

        if settings:
            set_at_sensor(self._context, self._source, settings, done)
        else:
            done("")

    def _changed(self, changes: Mapping[str, Any]) -> Configuration:
        # msgspec checks each value, and refuses None, which `replace` would keep.
        return msgspec.convert({**msgspec.to_builtins(self.configuration), **changes}, Configuration)

    # -- reports --------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """Take a ping or an attitude. Returns the report of the velocity or of the position."""
        if self._attitude and sample.port == self._attitude.path:
            return self._see_attitude(self._attitude, sample)
        said = self._source.values(sample)
        if self._is_silent:
            return []
        v = (0.0, 0.0, 0.0)
        if sample.valid:
            v_S = cast(Vec3, said["v_S"])
            v = self._turned(v_S)
            self.reckoning.see_velocity(sample.t_ns, v_S, cast(float, said["figure_of_merit"]))
        self._triggers = max(0, self._triggers - 1)
        return [line(self._velocity(sample, said, v))]

    @property
    def _is_silent(self) -> bool:
        """Whether the device does not ping. The sensor does, but nothing is reported."""
        return not self.configuration.acoustic_enabled and self._triggers == 0

    def _turned(self, v: Vec3) -> Vec3:
        """Turn a vector to the axes of the vehicle; the device is mounted clockwise from these by the mounting offset."""
        angle = rad(self.configuration.mounting_rotation_offset)
        c, s = math.cos(angle), math.sin(angle)
        return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]

    def _covariance(self, flat: tuple[float, ...]) -> list[list[float]]:
        columns = [self._turned((flat[i], flat[3 + i], flat[6 + i])) for i in range(3)]
        rows = [self._turned((columns[0][i], columns[1][i], columns[2][i])) for i in range(3)]
        return [list(row) for row in rows]

    def _velocity(self, sample: Sample, said: Mapping[str, Any], v: Vec3) -> dict[str, object]:
        before, self._reported_ns = self._reported_ns, sample.t_ns
        beams = zip(said["beam_locks"], said["beam_velocities"], said["beam_ranges"], strict=True)
        epoch = self._context.world.epoch_ns
        return {
            "time": (sample.t_ns - before) / 1e6 if 0 <= before <= sample.t_ns else 0.0,
            "vx": v[0], "vy": v[1], "vz": v[2],
            "fom": said["figure_of_merit"] if sample.valid else 0.0,
            "covariance": self._covariance(said["covariance_S"]) if sample.valid else [[0.0] * 3] * 3,
            "altitude": said["altitude"] if sample.valid else NO_LOCK,
            "transducers": [
                {
                    "id": number, "velocity": speed if lock and speed is not None else 0.0,
                    "distance": reach if lock and reach is not None else NO_LOCK, "rssi": 0.0, "nsd": 0.0, "beam_valid": bool(lock),
                }
                for number, (lock, speed, reach) in enumerate(beams)
            ],
            "velocity_valid": sample.valid, "status": 0, "tracking_mode": "bottom", "format": FORMAT, "type": "velocity",
            "time_of_validity": (epoch + sample.t_ns) // MICROSECOND, "time_of_transmission": (epoch + sample.t_sent_ns) // MICROSECOND,
        }  # fmt: skip

    def _see_attitude(self, source: DeviceInput, sample: Sample) -> list[bytes]:
        if not sample.valid:
            return []
        self.reckoning.see_attitude(sample.t_ns, cast(Quat, source.values(sample)["q_NS"]))
        if sample.t_ns - self._position_ns < POSITION_NS:
            return []
        # Reports stay on a grid of 5 Hz whatever the rate of the attitude.
        late = (sample.t_ns - self._position_ns) % POSITION_NS
        self._position_ns = sample.t_ns - (late if self._position_ns >= 0 else 0)
        # Where a mounting offset is set, the frame of the position is that of the vehicle at the start.
        position, (roll, pitch, yaw) = self._turned(self.reckoning.position()), self.reckoning.attitude()
        report = {
            "ts": (self._context.world.epoch_ns + sample.t_ns) / NANOSECONDS,
            "x": position[0], "y": position[1], "z": position[2], "std": math.sqrt(self.reckoning.variance),
            "roll": deg(roll), "pitch": deg(pitch), "yaw": deg(yaw),
            "type": "position_local", "status": 0 if self.reckoning.is_tracking else 1, "format": FORMAT,
        }  # fmt: skip
        return [line(report)]


def line(value: object) -> bytes:
    """Return a value as a line of the device."""
    return msgspec.json.encode(value) + b"\r\n"


def response(command: str, error: str = "", result: object = None) -> bytes:
    """Return the answer to a command; `error` is "" where it succeeded."""
    return line(
        {
            "response_to": command, "success": not error, "error_message": error, "result": result,
            "format": FORMAT, "type": "response",
        }
    )  # fmt: skip
