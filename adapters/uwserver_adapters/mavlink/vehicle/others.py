"""Other systems on the links lead external vehicles of the world: their reports set pose and velocity, and their outputs turn the thrusters."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping

from uwserver.adapter import AdapterContext, Conversation
from uwserver.frames import Quat, Vec3, conjugate, quat_from_rpy, rotate
from uwserver_adapters.mavlink.vehicle.bridge import Home, command
from uwserver_adapters.mavlink.wire.codec import deflection, vector
from uwserver_adapters.mavlink.wire.dialect import MavlinkMessage

LOCAL_NED, BODY_FRD = 1, 12
"""The values of MAV_FRAME for world and body that an ODOMETRY may use. Velocities may be in either."""
FRESH_S = 2.0
"""For this time after an ODOMETRY of a system its GLOBAL_POSITION_INT is ignored, because the two may differ."""
MOST_PULSES = 16
NO_PULSE = (0.0, 0xFFFF)
"""Values of SERVO_OUTPUT_RAW for an output that is switched off."""


class OtherSystems:
    """Reads position, attitude and outputs of other systems. Runs on the loop thread.

    Pose and velocity come from ODOMETRY, or else from GLOBAL_POSITION_INT with ATTITUDE or ATTITUDE_QUATERNION. Outputs come from the main
    outputs of SERVO_OUTPUT_RAW, or from ACTUATOR_OUTPUT_STATUS.

    Args:
        externals: the system that each external vehicle follows, by the vehicle's name.
        context: the world.
        home: where N lies.
        counters: counts what was received and not used.
    """

    def __init__(
        self, externals: Mapping[str, int], context: AdapterContext, home: Home, counters: Counter[str]
    ) -> None:
        self._context, self._home, self._counters = context, home, counters
        self._names: dict[int, list[str]] = {}
        for name, system in externals.items():
            self._names.setdefault(system, []).append(name)
        self._peers = {system: Conversation(context, f"system {system}") for system in self._names}
        self._attitudes: dict[int, tuple[Quat, Vec3]] = {}
        self._odometry_at: dict[int, float] = {}

    def take(self, message: MavlinkMessage, now: float) -> None:
        """Take a message of any system. `now` is the time of a clock that never jumps, s."""
        system = message.system
        if system not in self._names:
            return
        if message.name == "ODOMETRY":
            self._odometry_at[system] = now
            self._lead(system, _odometry(message), "other_odometry")
        elif message.name in ("ATTITUDE", "ATTITUDE_QUATERNION"):
            attitude = _attitude(message)
            if attitude is not None:
                self._attitudes[system] = attitude, _rates(message) or (0.0, 0.0, 0.0)
        elif message.name == "GLOBAL_POSITION_INT" and now - self._odometry_at.get(system, -math.inf) > FRESH_S:
            self._lead(system, self._global(message), "other_position")
        elif message.name == "SERVO_OUTPUT_RAW" and message.integer("port") == 0:
            self._turn(system, [_output(message.number(f"servo{k}_raw")) for k in range(1, MOST_PULSES + 1)])
        elif message.name == "ACTUATOR_OUTPUT_STATUS":
            self._turn(system, [min(1.0, max(-1.0, u)) if math.isfinite(u) else 0.0 for u in message.array("actuator")])

    def _turn(self, system: int, outputs: list[float]) -> None:
        """Command the outputs of a system (-1 to 1) to the actuators of the vehicles that follow it, in the order of the file."""
        for name in self._names[system]:
            port = self._context.ports.get(f"{name}/actuators")
            if port is None:  # a body without actuators
                continue
            count = port.fields[0].shape[0]
            u = (*outputs[:count], *[0.0] * (count - len(outputs)))
            command(self._peers[system], port.path, {"u": u}, self._answered)

    def _global(self, message: MavlinkMessage) -> dict[str, object] | None:
        """Return the pose of a GLOBAL_POSITION_INT, or None where N has no place on the Earth yet or there is no such place."""
        number = message.number
        place = self._home.point(number("lat"), number("lon"), number("alt") / 1e3, is_relative=False)
        if place is None:
            return None
        v = (number("vx") / 1e2, number("vy") / 1e2, number("vz") / 1e2)
        value: dict[str, object] = {"p_NB": place}
        known = self._attitudes.get(message.system)
        if known is not None:
            q, w = known
            value |= {"q_NB": q, "v_NB_B": rotate(conjugate(q), v), "w_NB_B": w}
        return value

    def _lead(self, system: int, value: dict[str, object] | None, reason: str) -> None:
        """Move all vehicles that follow a system to a pose. Without one, count the reason."""
        if value is None:
            self._counters[reason] += 1
            return
        for name in self._names[system]:
            command(self._peers[system], f"{name}/pose", value, self._answered)

    def _answered(self, reason: str) -> None:
        if reason:
            self._counters["other_refused"] += 1
            self._context.stats.count_error(reason)


def _odometry(message: MavlinkMessage) -> dict[str, object] | None:
    """Return the pose of an ODOMETRY in LOCAL_NED, or None for another frame, or without position or attitude."""
    p, q, v, w = (
        message.vec3("x", "y", "z"),
        _quaternion(message.array("q")),
        message.vec3("vx", "vy", "vz"),
        _rates(message),
    )
    if message.integer("frame_id") != LOCAL_NED or p is None or q is None:
        return None
    value: dict[str, object] = {"p_NB": p, "q_NB": q}
    child = message.integer("child_frame_id")
    if v is not None and child in (LOCAL_NED, BODY_FRD):
        value["v_NB_B"] = v if child == BODY_FRD else rotate(conjugate(q), v)
    return value if w is None else {**value, "w_NB_B": w}


def _output(pulse_us: float) -> float:
    """Convert a pulse width to an actuator's output, -1 to 1, as logs of such outputs are read (`uwserver.world.external.motion`)."""
    return deflection(pulse_us) if math.isfinite(pulse_us) and pulse_us not in NO_PULSE else 0.0


def _attitude(message: MavlinkMessage) -> Quat | None:
    """Return the attitude of an ATTITUDE or ATTITUDE_QUATERNION."""
    if message.name == "ATTITUDE_QUATERNION":
        return _quaternion(tuple(message.number(name) for name in ("q1", "q2", "q3", "q4")))
    angles = message.vec3("roll", "pitch", "yaw")
    return None if angles is None else quat_from_rpy(*angles)


def _quaternion(row: tuple[float, ...]) -> Quat | None:
    """Return a normalised quaternion, or None if it is far from a unit quaternion. Zeros and NaN stand for an unknown attitude."""
    found = vector(row, 4)
    norm = 0.0 if found is None else math.hypot(*found)
    if found is None or not 0.5 < norm < 2.0:
        return None
    w, x, y, z = found
    return w / norm, x / norm, y / norm, z / norm


def _rates(message: MavlinkMessage) -> Vec3 | None:
    return message.vec3("rollspeed", "pitchspeed", "yawspeed")
