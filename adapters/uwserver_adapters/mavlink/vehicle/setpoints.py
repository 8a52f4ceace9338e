"""Set points of a companion computer: SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET."""

from __future__ import annotations

import math

from uwserver.frames import Vec3, quat_from_rpy, rpy_from_quat
from uwserver_adapters.mavlink.vehicle.bridge import WARNING, Bridge
from uwserver_adapters.mavlink.vehicle.modes import ALT_HOLD, shown
from uwserver_adapters.mavlink.wire.codec import turned, vec3, vector
from uwserver_adapters.mavlink.wire.dialect import MavlinkMessage

NO_POSITION, NO_VELOCITY, NO_ACCELERATION, NO_YAW, NO_YAW_RATE = 0x7, 0x38, 0x1C0, 0x400, 0x800
"""Bits of the type mask that exclude a part. Bit 0x200 (acceleration means force) is ignored: ground stations set it without an acceleration."""
LOCAL_NED, RELATIVE_ALTITUDE = "MAV_FRAME_LOCAL_NED", "MAV_FRAME_GLOBAL_RELATIVE_ALT"
_TURNED = ("MAV_FRAME_BODY_NED", "MAV_FRAME_BODY_OFFSET_NED", "MAV_FRAME_BODY_FRD")
_FROM_HERE = ("MAV_FRAME_LOCAL_OFFSET_NED", *_TURNED)
GLOBAL_FRAMES = {
    "MAV_FRAME_GLOBAL": False,
    "MAV_FRAME_GLOBAL_INT": False,
    RELATIVE_ALTITUDE: True,
    "MAV_FRAME_GLOBAL_RELATIVE_ALT_INT": True,
}
"""Frames with latitude and longitude -> whether the altitude is relative to home."""
_NO_ATTITUDE, _NO_THROTTLE = 0x80, 0x40


class SetPoints:
    """Passes set points to the autopilot. Tells senders why one cannot be followed, and repeats a text only after another.

    Args:
        bridge: the way to ground stations and autopilot.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._told = ""

    def local(self, message: MavlinkMessage) -> None:
        """Follow SET_POSITION_TARGET_LOCAL_NED, in GUIDED."""
        frame, mask = message.entry("coordinate_frame").name, message.integer("type_mask")
        state = self._bridge.readings.state()
        if frame != LOCAL_NED and frame not in _FROM_HERE:
            return self._refuse(f"set point in frame {message.integer('coordinate_frame')} is not supported")
        yaw = rpy_from_quat(state.q_NB)[2] if state.q_NB is not None else 0.0
        p, v = message.vec3("x", "y", "z"), message.vec3("vx", "vy", "vz")
        if frame in _TURNED:
            p, v = (None if p is None else turned(p, yaw)), (None if v is None else turned(v, yaw))
        if frame in _FROM_HERE and p is not None and not mask & NO_POSITION:
            if state.p_N is None:
                return self._refuse("set point from here: the position is not known")
            p = (state.p_N[0] + p[0], state.p_N[1] + p[1], state.p_N[2] + p[2])
        return self._follow(message, mask, p, v, yaw if frame in _TURNED else 0.0)

    def geodetic(self, message: MavlinkMessage) -> None:
        """Follow SET_POSITION_TARGET_GLOBAL_INT, in GUIDED. In ALT_HOLD its altitude is the depth to hold."""
        frame, mask = message.entry("coordinate_frame").name, message.integer("type_mask")
        home, state = self._bridge.home, self._bridge.readings.state()
        if frame not in GLOBAL_FRAMES:
            return self._refuse(f"set point in frame {message.integer('coordinate_frame')} is not supported")
        altitude = message.number("alt")
        if shown(state.mode) is ALT_HOLD and not mask & 0x4:
            if not math.isfinite(altitude):
                return self._refuse("set point: the altitude is not a number")
            depth = -home.sea_altitude(altitude, GLOBAL_FRAMES[frame])
            return self._bridge.autopilot.command("depth", {"depth": depth}, self._tell)
        p: Vec3 | None = None
        if not mask & NO_POSITION:
            if home.origin is None:
                return self._refuse("set point: the origin is not known, send SET_GPS_GLOBAL_ORIGIN")
            p = home.point(message.integer("lat_int"), message.integer("lon_int"), altitude, GLOBAL_FRAMES[frame])
        return self._follow(message, mask, p, message.vec3("vx", "vy", "vz"), 0.0)

    def _follow(self, message: MavlinkMessage, mask: int, p: Vec3 | None, v: Vec3 | None, yaw_from: float) -> None:
        if not shown(self._bridge.readings.state().mode).is_guided:
            return self._refuse("set points are followed in GUIDED only")
        if not mask & NO_ACCELERATION:
            return self._refuse("set points of acceleration or force are not supported")
        yaw, rate = message.number("yaw"), message.number("yaw_rate")
        value: dict[str, object] = {}
        if not mask & NO_YAW:
            if not math.isfinite(yaw):
                return self._refuse("set point: the yaw is not a number")
            value["heading"] = math.remainder(yaw + yaw_from, 2 * math.pi)
        command = self._bridge.autopilot.command
        if not mask & NO_POSITION:
            if p is None or vec3(p) is None:
                return self._refuse("set point: the position is not a place")
            return command("position", {"p_N": list(p), **value}, self._tell)
        if not mask & NO_VELOCITY:
            if v is None:
                return self._refuse("set point: the velocity is not a number")
            if not mask & NO_YAW_RATE and "heading" not in value and math.isfinite(rate):
                value["yaw_rate"] = rate
            return command("velocity", {"v_N": list(v), **value}, self._tell)
        if value:
            return command("heading", value, self._tell)
        return self._refuse("set point: it means neither position nor velocity nor yaw")

    def attitude(self, message: MavlinkMessage) -> None:
        """Follow SET_ATTITUDE_TARGET, in GUIDED. Thrust 0.5 holds the depth and more climbs. A rate without an attitude turns the vehicle."""
        mask = message.integer("type_mask")
        if not shown(self._bridge.readings.state().mode).is_guided:
            return self._refuse("set points are followed in GUIDED only")
        value: dict[str, object] = {}
        if not mask & _NO_ATTITUDE:
            q = vector(message.array("q"), 4)
            norm = math.sqrt(sum(entry * entry for entry in q)) if q is not None else 0.0
            if q is None or not 0.9 < norm < 1.1:
                return self._refuse("set point: the attitude is no unit quaternion")
            value["q_NB"] = [entry / norm for entry in q]
        elif not mask & 0x4 and math.isfinite(message.number("body_yaw_rate")):
            rate = message.number("body_yaw_rate")
            return self._bridge.autopilot.command("heading", {"rate": rate}, self._tell)
        thrust = message.number("thrust")
        if not mask & _NO_THROTTLE:
            if not math.isfinite(thrust):
                return self._refuse("set point: the thrust is not a number")
            value["heave"] = min(1.0, max(-1.0, 1.0 - 2.0 * thrust))
        if not value:
            return self._refuse("set point: it means neither attitude nor yaw rate nor thrust")
        return self._bridge.autopilot.command("attitude", value, self._tell)

    def turn_to(self, yaw: float, is_relative: bool) -> bool:
        """Turn to a heading (rad), or by an angle. Returns False when the attitude is not known."""
        state = self._bridge.readings.state()
        if state.q_NB is None:
            return False
        heading = yaw + (rpy_from_quat(state.q_NB)[2] if is_relative else 0.0)
        q = quat_from_rpy(0.0, 0.0, heading)
        self._bridge.autopilot.command("heading", {"heading": rpy_from_quat(q)[2]}, self._tell)
        return True

    def _refuse(self, reason: str) -> None:
        self._bridge.counters["refused"] += 1
        self._tell(reason)

    def _tell(self, reason: str) -> None:
        if reason != self._told:
            self._told = reason
            if reason:
                self._bridge.tell(WARNING, reason)
