"""Water Linked A50: lines of JSON on TCP 16171, as its TCP JSON API 3.3 documents them (docs.waterlinked.com, DVL A50/A125)."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any, cast

import msgspec
from msgspec import Meta, Struct

from uwserver.adapter import AdapterContext, Undecodable, decode
from uwserver.ports import Json, Progress, Refused, Sample
from uwserver.ports import Reply as Answer
from uwserver.table import Name, Positive
from uwserver_adapters.devices.codec import FULL_TURN_DEG, NANOSECONDS, deg, rad
from uwserver_adapters.devices.dead_reckoning import DeadReckoning
from uwserver_adapters.devices.device import DeviceTable, LineReader, PortNumber, Reply, Source

PORT = 16171
FORMAT = "json_v3.3"
LINE_LIMIT = 4096
"""Longest command, bytes; the longest of the documented ones has some 200."""
POSITION_NS = NANOSECONDS // 5
"""Between two reports of the position: 5 Hz."""
TRIGGERS = 15
"""Pings that may be asked for ahead."""
NO_LOCK = -1.0
"""Altitude and distance where nothing was found."""
MICROSECOND = 1000
FIELDS = ("v_S", "altitude", "figure_of_merit", "covariance_S", "beam_velocities", "beam_ranges", "beam_locks")
_MODES = {"auto": -1, **{f"={number}": number for number in range(5)}}
"""Range modes that can be simulated."""


class WaterLinkedA50Table(DeviceTable, tag="water_linked_a50", kw_only=True, frozen=True):
    """Attributes:
    sensor: the DVL (``rov/dvl``).
    attitude: sensor with the attitude of the DVL (`q_NS`), mounted like it; with it the position is reckoned and reported 5 times a second.
    speed_of_sound_mps: what `get_config` answers before a client has set it: the sensor's `assumed_sound_speed_mps`.
    """

    sensor: Name
    tcp_port: PortNumber | None = PORT
    attitude: Name | None = None
    speed_of_sound_mps: Positive = 1500.0

    def build(self, context: AdapterContext) -> WaterLinkedA50:
        """The device."""
        return WaterLinkedA50(self, context)


class Configuration(Struct, frozen=True, forbid_unknown_fields=True):
    """As `get_config` tells it; units and limits are those of the device's documentation."""

    speed_of_sound: Annotated[float, Meta(ge=1000, le=2000)] = 1500.0
    acoustic_enabled: bool = True
    dark_mode_enabled: bool = False
    mounting_rotation_offset: Annotated[float, Meta(ge=0, le=FULL_TURN_DEG)] = 0.0
    range_mode: str = "auto"
    periodic_cycling_enabled: bool = True


class WaterLinkedA50:
    """The device.

    Attributes:
        wanted: its ports.
        configuration: as it is now.
        reckoning: its position.
    """

    def __init__(self, table: WaterLinkedA50Table, context: AdapterContext) -> None:
        self._context = context
        self._source = Source("sensor", table.sensor, context.ports, FIELDS)
        self._attitude = table.attitude and Source("attitude", table.attitude, context.ports, ("q_NS",))
        self.wanted: Collection[str] = {source.path for source in (self._source, self._attitude) if source}
        self.configuration = Configuration(speed_of_sound=table.speed_of_sound_mps)
        self.reckoning = DeadReckoning()
        self._reported_ns = -1
        self._position_ns = -POSITION_NS
        self._triggers = 0
        self._commands: dict[str, Callable[[Any, Reply], None]] = {
            "get_config": lambda _, reply: reply(
                response("get_config", result=msgspec.to_builtins(self.configuration))
            ),
            "set_config": self._set_config,
            "reset_dead_reckoning": self._reset_dead_reckoning,
            "calibrate_gyro": lambda _, reply: reply(response("calibrate_gyro")),
            "trigger_ping": self._trigger_ping,
            "get_version_info": self._get_version_info,
        }

    def reader(self) -> LineReader:
        """Lines."""
        return LineReader(LINE_LIMIT)

    def reset(self) -> None:
        """The time of the world begins again; the configuration stays, as that of a device does."""
        self.reckoning.forget()
        self._reported_ns, self._position_ns = -1, -POSITION_NS

    # -- commands -------------------------------------------------------------------------------------------------------------------

    def take(self, message: bytes, reply: Reply) -> str:
        """A command; every one is answered that can be read."""
        try:
            said = decode(message, "json")
        except Undecodable as error:
            reply(response("", f"this is no JSON: {error}"))
            return f"a line is no JSON: {error}"
        name = said.get("command") if isinstance(said, dict) else None
        if not isinstance(said, dict) or not isinstance(name, str):
            reply(response("", 'a command has the form {"command": "get_config"}'))
            return "a line holds no command"
        obey = self._commands.get(name)
        if obey is None:
            there = ", ".join(self._commands)
            reply(response(name[:100], f"this simulated device does not know the command, it knows: {there}"))
            return "a command is not known"
        obey(said.get("parameters"), reply)
        return ""

    def _reset_dead_reckoning(self, _: object, reply: Reply) -> None:
        self.reckoning.reset()
        reply(response("reset_dead_reckoning"))

    def _trigger_ping(self, _: object, reply: Reply) -> None:
        if self._triggers >= TRIGGERS:
            reply(response("trigger_ping", f"{TRIGGERS} pings are asked for already: wait for their reports"))
            return
        self._triggers += 0 if self.configuration.acoustic_enabled else 1
        reply(response("trigger_ping"))

    def _get_version_info(self, _: object, reply: Reply) -> None:
        said: dict[str, Json] = {
            "chipid": "0x0", "hardware_revision": 4, "product_id": 21035, "product_name": "DVL A50", "variant": "standard",
            "version_short": "2.7.2", "version": f"2.7.2 (simulated by {self._context.world.server})", "is_ready": True,
        }  # fmt: skip
        reply(response("get_version_info", result=said))

    def _set_config(self, parameters: object, reply: Reply) -> None:
        """All of it, or nothing."""
        if not isinstance(parameters, dict) or not parameters:
            reply(
                response(
                    "set_config",
                    'give what is to be set: {"command":"set_config","parameters":{"speed_of_sound":1480}}',
                )
            )
            return
        changes = cast(dict[str, Any], parameters)
        try:
            # None is no value, and would otherwise be taken for one that was left out.
            wanted = msgspec.convert({**msgspec.to_builtins(self.configuration), **changes}, Configuration)
        except msgspec.ValidationError as error:
            reply(response("set_config", str(error)))
            return
        if wanted.range_mode not in _MODES:
            text = f"range_mode {wanted.range_mode[:20]} is not simulated: use {', '.join(_MODES)}"
            reply(response("set_config", text))
            return
        settings: dict[str, object] = {}
        if "speed_of_sound" in changes:
            settings["sound_speed"] = wanted.speed_of_sound
        if "range_mode" in changes:
            settings["range_mode"] = _MODES[wanted.range_mode]
        self._apply(settings, changes, reply)

    def _apply(self, settings: Mapping[str, object], changes: Mapping[str, Any], reply: Reply) -> None:
        """What concerns the sensor is set there; what is told is kept once that has been done."""

        def done() -> None:
            # Others may have been set meanwhile: only what was asked for is changed.
            told = {**msgspec.to_builtins(self.configuration), **changes}
            self.configuration = msgspec.convert(told, Configuration)
            self._triggers = 0 if self.configuration.acoustic_enabled else self._triggers
            reply(response("set_config"))

        def answered(answer: Answer | Progress) -> None:
            if isinstance(answer, Answer):
                if answer.fault is None:
                    done()
                else:
                    reply(response("set_config", answer.fault.text))

        if not settings:
            done()
            return
        try:
            self._context.call(f"{self._source.path}/set", settings, self._context.name, answered)
        except Refused as refused:
            reply(response("set_config", refused.fault.text))

    # -- reports --------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """A ping, or an attitude."""
        if self._attitude and sample.port == self._attitude.path:
            return self._see_attitude(self._attitude, sample)
        said = self._source.values(sample)
        if sample.valid:
            v = self._turned(cast(tuple[float, float, float], said["v_S"]))
            sigma = cast(float, said["figure_of_merit"])
            if not self._is_silent:
                self.reckoning.see_velocity(sample.t_ns, cast(tuple[float, float, float], said["v_S"]), sigma)
        else:
            v = (0.0, 0.0, 0.0)
        if self._is_silent:
            return []
        self._triggers = max(0, self._triggers - 1)
        return [line(self._velocity(sample, said, v))]

    @property
    def _is_silent(self) -> bool:
        """Whether it does not ping: the sensor does, but nobody hears of it."""
        return not self.configuration.acoustic_enabled and self._triggers == 0

    def _turned(self, v: tuple[float, float, float]) -> tuple[float, float, float]:
        """Along the axes of the vehicle, from which the device is turned clockwise by the mounting offset."""
        angle = rad(self.configuration.mounting_rotation_offset)
        c, s = math.cos(angle), math.sin(angle)
        return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]

    def _covariance(self, flat: tuple[float, ...]) -> list[list[float]]:
        columns = [self._turned((flat[i], flat[3 + i], flat[6 + i])) for i in range(3)]
        rows = [self._turned((columns[0][i], columns[1][i], columns[2][i])) for i in range(3)]
        return [list(row) for row in rows]

    def _velocity(self, sample: Sample, said: Mapping[str, Any], v: tuple[float, float, float]) -> dict[str, object]:
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

    def _see_attitude(self, source: Source, sample: Sample) -> list[bytes]:
        if not sample.valid:
            return []
        self.reckoning.see_attitude(sample.t_ns, cast(tuple[float, float, float, float], source.values(sample)["q_NS"]))
        if sample.t_ns - self._position_ns < POSITION_NS:
            return []
        # Kept to the grid, so that 5 Hz come of an attitude of any rate.
        late = (sample.t_ns - self._position_ns) % POSITION_NS
        self._position_ns = sample.t_ns - (late if self._position_ns >= 0 else 0)
        position, (roll, pitch, yaw) = self._turned_back(self.reckoning.position()), self.reckoning.attitude()
        report = {
            "ts": (self._context.world.epoch_ns + sample.t_ns) / NANOSECONDS,
            "x": position[0], "y": position[1], "z": position[2], "std": math.sqrt(self.reckoning.variance),
            "roll": deg(roll), "pitch": deg(pitch), "yaw": deg(yaw),
            "type": "position_local", "status": 0 if self.reckoning.is_tracking else 1, "format": FORMAT,
        }  # fmt: skip
        return [line(report)]

    def _turned_back(self, p: tuple[float, float, float]) -> tuple[float, float, float]:
        """The frame of the position is that of the vehicle at the start, where a mounting offset is set."""
        return self._turned(p)


def line(value: object) -> bytes:
    """As the device ends its lines."""
    return msgspec.json.encode(value) + b"\r\n"


def response(command: str, error: str = "", result: Json = None) -> bytes:
    """The answer to a command; `error` is empty where it succeeded."""
    return line(
        {
            "response_to": command, "success": not error, "error_message": error, "result": result,
            "format": FORMAT, "type": "response",
        }
    )  # fmt: skip
