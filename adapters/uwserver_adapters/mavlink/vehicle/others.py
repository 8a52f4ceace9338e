"""Other systems on the links: what they say of their place leads external vehicles of the world, and their outputs turn the thrusters of these."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping

from uwserver.adapter import AdapterContext, Conversation
from uwserver.frames import Quat, Vec3, conjugate, quat_from_rpy, rotate
from uwserver.ports import Refused, Reply
from uwserver_adapters.mavlink.vehicle.home import Home
from uwserver_adapters.mavlink.wire.codec import vec3, vector
from uwserver_adapters.mavlink.wire.dialect import Message

LOCAL_NED, BODY_FRD = 1, 12
"""Of MAV_FRAME: world and body of an ODOMETRY that is understood; velocities may be in either."""
FRESH_S = 2.0
"""So long after an ODOMETRY of a system its GLOBAL_POSITION_INT counts for nothing: the two may differ."""
PULSE_MIDDLE_US, PULSE_HALF_US, NO_PULSE = 1500.0, 400.0, 0xFFFF
"""Of a SERVO_OUTPUT_RAW, as in a log (`uwserver.world.external.motion`): at rest, from there to full, and what stands for none, as 0 does."""
MOST_PULSES = 16


class Others:
    """Reads ODOMETRY, or else GLOBAL_POSITION_INT with ATTITUDE or ATTITUDE_QUATERNION, of other systems; and their
    SERVO_OUTPUT_RAW of the main outputs, or ACTUATOR_OUTPUT_STATUS. Loop thread."""

    def __init__(
        self, externals: Mapping[str, int], context: AdapterContext, home: Home, counters: Counter[str]
    ) -> None:
        """Of one router.

        Args:
            externals: numbers of systems by the names of the vehicles that follow them.
            context: the world.
            home: where N lies.
            counters: of what came and was not taken.
        """
        self._context, self._home, self._counters = context, home, counters
        self._names: dict[int, list[str]] = {}
        for name, system in externals.items():
            self._names.setdefault(system, []).append(name)
        self._peers = {system: Conversation(context, f"system {system}") for system in self._names}
        self._attitudes: dict[int, tuple[Quat, Vec3]] = {}
        self._odometry_at: dict[int, float] = {}

    def hear(self, message: Message, now: float) -> None:
        """A message of any system; `now`: of a clock that never jumps, s."""
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
        elif message.name == "SERVO_OUTPUT_RAW" and message.whole("port") == 0:
            self._turn(system, [_part(message.number(f"servo{k}_raw")) for k in range(1, MOST_PULSES + 1)])
        elif message.name == "ACTUATOR_OUTPUT_STATUS":
            self._turn(system, [min(1.0, max(-1.0, u)) if math.isfinite(u) else 0.0 for u in message.row("actuator")])

    def _turn(self, system: int, parts: list[float]) -> None:
        """Let the actuators of the vehicles that follow a system give these parts (-1..1): the first output is the first actuator of the file."""
        for name in self._names[system]:
            port = self._context.ports.get(f"{name}/actuators")
            if port is None:  # a body without any
                continue
            count = port.fields[0].shape[0]
            u = (*parts[:count], *[0.0] * (count - len(parts)))
            try:
                self._peers[system].command(port.path, {"u": u}, self._answered)
            except Refused as refused:
                self._refused(refused.fault.text)

    def _global(self, message: Message) -> dict[str, object] | None:
        """Of a GLOBAL_POSITION_INT; None where N lies nowhere yet, or there is no such place."""
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
        """Let all vehicles that follow a system stand there; what is refused is counted, and told in the adapter's state."""
        if value is None:
            self._counters[reason] += 1
            return
        for name in self._names[system]:
            try:
                self._peers[system].command(f"{name}/pose", value, self._answered)
            except Refused as refused:
                self._refused(refused.fault.text)

    def _answered(self, reply: Reply) -> None:
        if reply.fault is not None:
            self._refused(reply.fault.text)

    def _refused(self, text: str) -> None:
        self._counters["other_refused"] += 1
        self._context.stats.errors += 1
        self._context.stats.last_error = text


def _odometry(message: Message) -> dict[str, object] | None:
    """Of an ODOMETRY in LOCAL_NED; None for one in other frames, or without place or attitude."""
    p, q, v, w = (
        _three(message, "x", "y", "z"),
        _quaternion(message.row("q")),
        _three(message, "vx", "vy", "vz"),
        _rates(message),
    )
    if message.whole("frame_id") != LOCAL_NED or p is None or q is None:
        return None
    value: dict[str, object] = {"p_NB": p, "q_NB": q}
    child = message.whole("child_frame_id")
    if v is not None and child in (LOCAL_NED, BODY_FRD):
        value["v_NB_B"] = v if child == BODY_FRD else rotate(conjugate(q), v)
    return value if w is None else {**value, "w_NB_B": w}


def _part(pulse_us: float) -> float:
    """Of all that an actuator can give, -1..1; a pulse of 0 is an output that is switched off."""
    if not math.isfinite(pulse_us) or pulse_us in (0.0, NO_PULSE):
        return 0.0
    return min(1.0, max(-1.0, (pulse_us - PULSE_MIDDLE_US) / PULSE_HALF_US))


def _attitude(message: Message) -> Quat | None:
    """Of an ATTITUDE or ATTITUDE_QUATERNION."""
    if message.name == "ATTITUDE_QUATERNION":
        return _quaternion(tuple(message.number(name) for name in ("q1", "q2", "q3", "q4")))
    angles = _three(message, "roll", "pitch", "yaw")
    return None if angles is None else quat_from_rpy(*angles)


def _quaternion(row: tuple[float, ...]) -> Quat | None:
    """Normalised; None for one that is far from a unit quaternion, as that of zeros or NaN, which stands for an unknown attitude."""
    found = vector(row, 4)
    norm = 0.0 if found is None else math.hypot(*found)
    if found is None or not 0.5 < norm < 2.0:
        return None
    w, x, y, z = found
    return w / norm, x / norm, y / norm, z / norm


def _rates(message: Message) -> Vec3 | None:
    return _three(message, "rollspeed", "pitchspeed", "yawspeed")


def _three(message: Message, *names: str) -> Vec3 | None:
    """Three fields that are all numbers."""
    return vec3(tuple(message.number(name) for name in names))
