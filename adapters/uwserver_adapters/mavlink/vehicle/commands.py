"""COMMAND_LONG and COMMAND_INT. Each is acknowledged as a real ArduSub does it, with UNSUPPORTED for commands that are not listed here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal

from msgspec import Struct, structs

from uwserver_adapters.mavlink.vehicle.bridge import INFO, NOTICE, WARNING, Bridge, Done, Place, place_of_e7
from uwserver_adapters.mavlink.vehicle.missions import Missions
from uwserver_adapters.mavlink.vehicle.modes import BY_ENTRY, GUIDED, POSHOLD, SURFACE, Mode
from uwserver_adapters.mavlink.vehicle.outputs import Outputs, Payload
from uwserver_adapters.mavlink.vehicle.setpoints import GLOBAL_FRAMES, RELATIVE_ALTITUDE, SetPoints
from uwserver_adapters.mavlink.vehicle.telemetry import Telemetry
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.codec import from_degrees, pulse, seconds
from uwserver_adapters.mavlink.wire.dialect import Entry, Fields, MavlinkMessage, addressed_to

Result = Literal["ACCEPTED", "DENIED", "UNSUPPORTED", "FAILED", "IN_PROGRESS"]
"""A MAV_RESULT without its prefix."""
FORCE = 21196
"""Value of parameter 2 of ARM_DISARM that forces it. The dialect has no name for it."""
_WAITING = 32
"""Commands that may wait for an answer of the world."""


class Request(Struct, frozen=True):
    """A command.

    Attributes:
        command: the command.
        p: parameters 1 to 7 at indices 1 to 7. In a COMMAND_INT, 5 and 6 are 1e-7 degrees.
        is_int: it came as COMMAND_INT.
        frame: name of the frame of its place.
        channel: the channel on which it came.
        peer: system and component that sent it.
    """

    command: Entry
    p: tuple[float, ...]
    is_int: bool
    frame: str
    channel: Channel
    peer: tuple[int, int]

    @property
    def place_e7(self) -> tuple[float, float, float]:
        """Latitude and longitude in 1e-7 degrees, and altitude in m."""
        scale = 1.0 if self.is_int else 1e7
        return self.p[5] * scale, self.p[6] * scale, self.p[7]

    def integer(self, k: int) -> int:
        """Return a parameter as an integer, -1 where it is none."""
        value = self.p[k]
        return int(value) if math.isfinite(value) and abs(value) < 1 << 31 else -1


class Commands:
    """Carries out commands.

    Args:
        bridge: the way to ground stations and autopilot.
        arm, disarm: arm, with or without force, and disarm the vehicle.
        telemetry, missions, setpoints, outputs, payload: parts of the vehicle that commands act on.
    """

    def __init__(
        self,
        bridge: Bridge,
        arm: Callable[[bool, Done], None],
        disarm: Callable[[Done], None],
        telemetry: Telemetry,
        missions: Missions,
        setpoints: SetPoints,
        outputs: Outputs,
        payload: Payload,
    ) -> None:
        self._bridge = bridge
        self._arm_vehicle, self._disarm_vehicle = arm, disarm
        self._telemetry = telemetry
        self._missions = missions
        self._setpoints = setpoints
        self._outputs = outputs
        self._payload = payload
        self._numbers = bridge.dialect.numbers
        self._waiting: set[tuple[Entry, tuple[int, int]]] = set()
        self._verbs: Mapping[str, Callable[[Request], Result | None]] = {
            "MAV_CMD_COMPONENT_ARM_DISARM": self._arm,
            "MAV_CMD_DO_SET_MODE": self._set_mode,
            "MAV_CMD_SET_MESSAGE_INTERVAL": self._set_interval,
            "MAV_CMD_GET_MESSAGE_INTERVAL": self._get_interval,
            "MAV_CMD_REQUEST_MESSAGE": self._request_message,
            "MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES": lambda request: self._give("AUTOPILOT_VERSION", request),
            "MAV_CMD_GET_HOME_POSITION": lambda request: self._give("HOME_POSITION", request),
            "MAV_CMD_DO_SET_HOME": self._set_home,
            "MAV_CMD_DO_REPOSITION": self._reposition,
            "MAV_CMD_DO_CHANGE_SPEED": self._change_speed,
            "MAV_CMD_CONDITION_YAW": self._turn,
            "MAV_CMD_DO_MOTOR_TEST": self._motor_test,
            "MAV_CMD_DO_SET_SERVO": self._set_servo,
            "MAV_CMD_NAV_LOITER_UNLIM": lambda request: self._enter(POSHOLD, request),
            "MAV_CMD_NAV_LAND": lambda request: self._enter(SURFACE, request),
            "MAV_CMD_MISSION_START": self._start_mission,
            "MAV_CMD_DO_SET_MISSION_CURRENT": lambda request: (
                "ACCEPTED" if missions.set_current(request.integer(1)) else "FAILED"
            ),
            "MAV_CMD_DO_FLIGHTTERMINATION": self._terminate,
            "MAV_CMD_DO_DIGICAM_CONTROL": lambda _: "ACCEPTED",  # takes a picture, but there is no camera
            "MAV_CMD_DO_MOUNT_CONTROL": self._point_camera,
            "MAV_CMD_PREFLIGHT_CALIBRATION": self._calibrate,
            "MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN": self._reboot,
            "MAV_CMD_DO_SEND_BANNER": self._banner,
        }

    def take(self, message: MavlinkMessage, channel: Channel) -> None:
        """Carry out a COMMAND_LONG or COMMAND_INT. The acknowledgement goes to its sender, now or when the world has answered."""
        is_int = message.name == "COMMAND_INT"
        names = (
            "param1",
            "param2",
            "param3",
            "param4",
            *(("x", "y", "z") if is_int else ("param5", "param6", "param7")),
        )
        request = Request(
            message.entry("command"),
            (math.nan, *(message.number(name) for name in names)),
            is_int,
            message.entry("frame").name if is_int else RELATIVE_ALTITUDE,
            channel,
            message.sender,
        )
        verb = self._verbs.get(request.command.name)
        key = (request.command, request.peer)
        if verb is None:
            result: Result | None = "UNSUPPORTED"
        elif key in self._waiting:
            result = "IN_PROGRESS"  # the command was repeated before the world has answered
        elif len(self._waiting) >= _WAITING:
            result = "FAILED"
        else:
            result = verb(request)
        if result is not None:
            self._acknowledge(request, result)

    def _acknowledge(self, request: Request, result: Result) -> None:
        if result not in ("ACCEPTED", "IN_PROGRESS"):
            self._bridge.counters["refused"] += 1
        fields: Fields = {
            "command": request.command.number, "result": f"MAV_RESULT_{result}", **addressed_to(request.peer)
        }  # fmt: skip
        self._bridge.send("COMMAND_ACK", fields, request.channel)

    def _acknowledge_later(self, request: Request, prefix: str) -> Callable[[str], None]:
        """Return a callback that acknowledges the command when the world has answered."""
        key = (request.command, request.peer)
        self._waiting.add(key)

        def done(reason: str) -> None:
            self._waiting.discard(key)
            if reason:
                self._bridge.tell(WARNING, f"{prefix}: {reason}")
            self._acknowledge(request, "FAILED" if reason else "ACCEPTED")

        return done

    def _fail(self, text: str) -> Result:
        """Tell ground stations why a command fails."""
        self._bridge.tell(WARNING, text)
        return "FAILED"

    # -- state ------------------------------------------------------------------------------------------------------------------------

    def _arm(self, request: Request) -> Result | None:
        if request.p[1] == 1.0:
            self._arm_vehicle(request.p[2] == FORCE, self._acknowledge_later(request, "Arm"))
        elif request.p[1] == 0.0:
            self._disarm_vehicle(self._acknowledge_later(request, "Disarm"))
        else:
            return "UNSUPPORTED"
        return None

    def _set_mode(self, request: Request) -> Result | None:
        if not request.integer(1) & self._numbers["MAV_MODE_FLAG_CUSTOM_MODE_ENABLED"]:
            return "DENIED"
        mode = BY_ENTRY.get(self._bridge.dialect.name("SUB_MODE", request.integer(2)))
        return self._fail(f"Mode {request.integer(2)} is not supported") if mode is None else self._enter(mode, request)

    def mode_message(self, message: MavlinkMessage, channel: Channel) -> None:
        """Carry out SET_MODE. It is acknowledged as a command with its own message number."""
        values = (math.nan, message.number("base_mode"), message.number("custom_mode"), *(0.0,) * 5)
        command = Entry(self._bridge.dialect.by_name["SET_MODE"].id, "")
        request = Request(command, values, False, RELATIVE_ALTITUDE, channel, message.sender)
        result = self._set_mode(request)
        if result is not None:
            self._acknowledge(request, result)

    def _enter(self, mode: Mode, request: Request) -> Result | None:
        self._bridge.set_mode(mode, self._acknowledge_later(request, f"Mode change to {mode.name} failed"))
        return None

    def _start_mission(self, request: Request) -> Result | None:
        if not self._bridge.readings.state().armed:
            return self._fail("Mission: arm first")
        self._missions.start(self._acknowledge_later(request, "Mission"))
        return None

    def _terminate(self, request: Request) -> Result | None:
        if request.p[1] <= 0.5 or math.isnan(request.p[1]):
            return "FAILED"
        self._disarm_vehicle(self._acknowledge_later(request, "Termination"))
        return None

    def _reboot(self, request: Request) -> Result:
        """Refuse a reboot: there is no board to restart, so nothing would change."""
        if request.integer(1) <= 0:
            return "UNSUPPORTED"
        if self._bridge.readings.state().armed:
            return "FAILED"
        self._bridge.tell(NOTICE, "Reboot is not simulated; reset the world instead")
        return "DENIED"

    # -- messages ---------------------------------------------------------------------------------------------------------------------

    def _set_interval(self, request: Request) -> Result:
        name = self._bridge.dialect.message_name(request.integer(1))
        if name not in self._telemetry.names:
            return "FAILED"
        interval_us = request.p[2]
        if not math.isfinite(interval_us) or interval_us < -1.0:
            return "DENIED"
        request.channel.streams.set_interval(name, None if interval_us == 0.0 else interval_us * 1e-6)
        return "ACCEPTED"

    def _get_interval(self, request: Request) -> Result:
        number = request.integer(1)
        name = self._bridge.dialect.message_name(number)
        interval = 0 if name not in self._telemetry.names else request.channel.streams.interval_ns(name) // 1000 or -1
        self._bridge.send("MESSAGE_INTERVAL", {"message_id": number, "interval_us": interval}, request.channel)
        return "ACCEPTED" if interval else "FAILED"

    def _request_message(self, request: Request) -> Result:
        name = self._bridge.dialect.message_name(request.integer(1))
        if name == "MESSAGE_INTERVAL":  # of the message whose number is parameter 2
            return self._get_interval(structs.replace(request, p=(math.nan, request.p[2])))
        # QGroundControl requests one mode after the other, each when it has the one before. If it gets all at once, it never stops.
        return self._give(name, request, only=request.integer(2) if name == "AVAILABLE_MODES" else 0)

    def _give(self, name: str, request: Request, only: int = 0) -> Result:
        """Send a message. Of several that belong together, send all with 0, or only one, counted from 1."""
        if name not in self._telemetry.names:
            return "FAILED"
        messages = self._telemetry.build(name)
        messages = messages[only - 1 : only] if only > 0 else messages
        # The message follows the acknowledgement, as with ArduPilot: many scripts wait for the one and then for the other.
        request.channel.backlog.appendleft(iter([(name, fields) for fields in messages]))
        return "ACCEPTED" if messages else "FAILED"

    def _banner(self, _: Request) -> Result:
        for line in self._telemetry.banner:
            self._bridge.tell(INFO, line)
        return "ACCEPTED"

    # -- places and speeds ------------------------------------------------------------------------------------------------------------

    def _set_home(self, request: Request) -> Result:
        bridge, state = self._bridge, self._bridge.readings.state()
        place: Place | None
        if request.p[1] == 1.0:
            place = bridge.home.place(state.p_N) if state.p_N is not None else None
        else:
            place = place_of_e7(*request.place_e7)
            if place is not None and GLOBAL_FRAMES.get(request.frame, False):
                place = Place(place.latitude, place.longitude, bridge.home.sea_altitude(place.altitude, True))
        if place is None or bridge.home.origin is None or not math.isfinite(place.altitude):
            return "FAILED"
        bridge.home.home = place
        bridge.tell_home()
        return "ACCEPTED"

    def _reposition(self, request: Request) -> Result | None:
        """Go to a place in GUIDED. Only COMMAND_INT is accepted, because a float resolves latitudes to about a metre."""
        if not request.is_int:
            return "UNSUPPORTED"
        if request.frame not in GLOBAL_FRAMES:
            return "DENIED"  # as ArduSub does; no released dialect has MAV_RESULT_COMMAND_UNSUPPORTED_MAV_FRAME (9) yet
        bridge = self._bridge
        x, y, z = request.place_e7
        point = bridge.home.point(x, y, z, GLOBAL_FRAMES[request.frame])
        if point is None or not math.isfinite(z):
            bridge.tell(WARNING, "Reposition: the origin is not known, or there is no such place")
            return "DENIED"
        if (
            not request.integer(2) & self._numbers["MAV_DO_REPOSITION_FLAGS_CHANGE_MODE"]
            and bridge.readings.state().mode != GUIDED.autopilot
        ):
            return "DENIED"  # the sender does not allow a change of mode
        finish = self._acknowledge_later(request, "Reposition")
        value: dict[str, object] = {"p_N": list(point)}
        if math.isfinite(request.p[4]):
            value["heading"] = math.remainder(from_degrees(request.p[4]), 2 * math.pi)

        def go(reason: str) -> None:
            if reason:
                finish(reason)
            else:
                bridge.autopilot.command("position", value, finish)

        bridge.set_mode(GUIDED, go)
        return None

    def _change_speed(self, request: Request) -> Result | None:
        speed = request.p[2]
        if not math.isfinite(speed) or not 0.0 < speed <= 20.0:
            return "FAILED"
        finish = self._acknowledge_later(request, "Speed")
        self._bridge.autopilot.call("set_gain", {"name": "cruise_mps", "value": speed}, finish)
        return None

    def _turn(self, request: Request) -> Result | None:
        angle, direction, is_relative = from_degrees(request.p[1]), request.p[3], request.p[4] == 1.0
        if not math.isfinite(angle):
            return "DENIED"
        if is_relative and direction < 0.0:
            angle = -angle
        return "ACCEPTED" if self._setpoints.turn_to(angle, is_relative) else "FAILED"

    # -- hardware ---------------------------------------------------------------------------------------------------------------------

    def _motor_test(self, request: Request) -> Result:
        """Turn one more motor, as ArduSub does. Without a command for half a second the vehicle disarms."""
        kind, throttle, numbers = request.integer(2), request.p[3], self._numbers
        percent, pwm = numbers["MOTOR_TEST_THROTTLE_PERCENT"], numbers["MOTOR_TEST_THROTTLE_PWM"]
        if not self._bridge.readings.state().armed:
            return self._fail("Arm motors before testing motors.")
        if request.p[6] != numbers["MOTOR_TEST_ORDER_BOARD"]:
            return self._fail(f"Motor test: bad test type {request.p[6]:g}")
        if kind not in (percent, pwm) or not math.isfinite(throttle):
            return self._fail(f"Motor test: bad throttle type {kind}")
        if kind == percent:
            throttle = pulse(min(100.0, max(0.0, throttle)) / 50.0 - 1.0)
        deflections = self._outputs.test(request.integer(1), throttle, seconds(self._bridge.readings.t_ns))
        if deflections is None:
            return "FAILED"
        # This is acknowledged at once. If it waited for the autopilot, the command for the next motor would get IN_PROGRESS and be lost.
        self._bridge.autopilot.command("test", {"outputs": deflections}, self._bridge.failure_teller("Motor test: "))
        return "ACCEPTED"

    def _set_servo(self, request: Request) -> Result:
        pulse_us = request.p[2]
        is_set = math.isfinite(pulse_us) and self._outputs.set_servo(request.integer(1), pulse_us)
        return "ACCEPTED" if is_set else "FAILED"

    def _point_camera(self, request: Request) -> Result:
        tilt, pan = request.p[1], request.p[3]
        if not (math.isfinite(tilt) and math.isfinite(pan)):
            return "DENIED"
        self._payload.point(tilt, pan)
        return "ACCEPTED"

    def _calibrate(self, _: Request) -> Result:
        if self._bridge.readings.state().armed:
            return self._fail("Disarm to allow calibration")
        self._bridge.tell(INFO, "Calibration: the sensors are as the scenario has them")
        return "ACCEPTED"
