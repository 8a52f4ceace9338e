"""What a vehicle sends about itself: one function for each message, which returns None when there is nothing to send."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from uwserver.frames import quat_from_rpy, rpy_from_quat
from uwserver_adapters.mavlink.vehicle.bridge import Bridge
from uwserver_adapters.mavlink.vehicle.missions import Missions
from uwserver_adapters.mavlink.vehicle.modes import autopilot_version, available_modes, shown
from uwserver_adapters.mavlink.vehicle.outputs import TILT_LIMIT_DEG, Outputs, Payload
from uwserver_adapters.mavlink.vehicle.pilot import Failsafes, Pilot
from uwserver_adapters.mavlink.vehicle.readings import UNKNOWN_16, Instruments, Readings, State
from uwserver_adapters.mavlink.vehicle.setpoints import LOCAL_NED
from uwserver_adapters.mavlink.wire.codec import (
    compass_centidegrees,
    degrees,
    degrees_e7,
    from_degrees,
    microseconds,
    milliseconds,
    wrapped,
)
from uwserver_adapters.mavlink.wire.dialect import Fields

Builder = Callable[[], "Fields | Sequence[Fields] | None"]

ARMED, CUSTOM, STABILIZED, GUIDED, MANUAL = 128, 1, 16, 8, 64
"""Bits of base_mode in HEARTBEAT."""
GYRO, ACCELEROMETER, MAGNETOMETER, ABSOLUTE_PRESSURE, GPS = 1, 2, 4, 8, 32
RATE_CONTROL, ATTITUDE_CONTROL, YAW_CONTROL, Z_CONTROL, XY_CONTROL = 1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 14
OUTPUTS, GEOFENCE, AHRS, BATTERY, PREARM = 1 << 15, 1 << 20, 1 << 21, 1 << 25, 1 << 28
"""Bits of MAV_SYS_STATUS_SENSOR. ArduSub shows a fence that is switched off as present, healthy and not enabled; ours is always off."""
_LEVEL_FROM_BOW = 4 | 8 | 32
"""Bits of GIMBAL_DEVICE_FLAGS: roll and pitch are relative to the horizon, and yaw to the vehicle."""
_INSTRUMENTS = {"imu": GYRO | ACCELEROMETER, "magnetometer": MAGNETOMETER, "depth": ABSOLUTE_PRESSURE,
                "pressure": ABSOLUTE_PRESSURE, "gps": GPS, "attitude": AHRS, "battery": BATTERY}  # fmt: skip


class Telemetry:
    """Builds messages from the state of the vehicle, which it only reads.

    Args:
        bridge: readings and home.
        epoch_ns: UTC of simulation time zero, ns since 1970.
        banner: lines that a ground station is greeted with.
        failsafes, missions, pilot, outputs, payload: parts of the vehicle whose state is sent.

    Attributes:
        banner: as given.
    """

    def __init__(
        self,
        bridge: Bridge,
        epoch_ns: int,
        banner: Sequence[str],
        failsafes: Failsafes,
        missions: Missions,
        pilot: Pilot,
        outputs: Outputs,
        payload: Payload,
    ) -> None:
        self.banner = banner
        self._bridge = bridge
        self._epoch_ns = epoch_ns
        self._failsafes = failsafes
        self._pilot = pilot
        self._outputs = outputs
        self._payload = payload
        self._home = bridge.home
        self._numbers = bridge.dialect.numbers
        self._readings: Readings = bridge.readings
        self._builders: Mapping[str, Builder] = {
            **Instruments(self._readings).builders,
            "HEARTBEAT": self._heartbeat,
            "SYS_STATUS": self._sys_status,
            "POWER_STATUS": lambda: {"Vcc": 5000, "Vservo": 5000},
            "MEMINFO": lambda: {"freemem": UNKNOWN_16, "freemem32": 1 << 20},
            "SYSTEM_TIME": self._system_time,
            "ATTITUDE": self._attitude,
            "ATTITUDE_QUATERNION": self._attitude_quaternion,
            "AHRS2": self._ahrs2,
            "GLOBAL_POSITION_INT": self._global_position,
            "LOCAL_POSITION_NED": self._local_position,
            "VFR_HUD": self._vfr_hud,
            "EKF_STATUS_REPORT": self._ekf_status,
            "NAV_CONTROLLER_OUTPUT": self._nav_controller,
            "POSITION_TARGET_LOCAL_NED": self._position_target,
            "POSITION_TARGET_GLOBAL_INT": self._position_target_global,
            "RC_CHANNELS": self._rc_channels,
            "SERVO_OUTPUT_RAW": self._servo_output,
            "GIMBAL_DEVICE_ATTITUDE_STATUS": self._gimbal,
            "MISSION_CURRENT": missions.current,
            "HOME_POSITION": bridge.home_position,
            "GPS_GLOBAL_ORIGIN": lambda: self._home.global_origin(microseconds(self._readings.t_ns)),
            "AUTOPILOT_VERSION": lambda: autopilot_version(self._numbers),
            "AVAILABLE_MODES": lambda: available_modes(self._numbers),
            "CURRENT_MODE": self._current_mode,
            "NAMED_VALUE_FLOAT": self._named_values,
        }

    @property
    def names(self) -> Sequence[str]:
        """Names of the messages that can be requested."""
        return tuple(self._builders)

    def build(self, name: str) -> Sequence[Fields]:
        """Return the current messages of a name: one, several (NAMED_VALUE_FLOAT), or none where nothing is known."""
        fields = self._builders[name]()
        if fields is None:
            return ()
        return (fields,) if isinstance(fields, Mapping) else fields

    def announce(self, name: str) -> None:
        """Send a message to all, now."""
        for fields in self.build(name):
            self._bridge.send(name, fields)

    @property
    def _state(self) -> State:
        return self._readings.state()

    @property
    def _boot_ms(self) -> int:
        return milliseconds(self._readings.t_ns)

    # -- the vehicle ----------------------------------------------------------------------------------------------------------------

    def _heartbeat(self) -> Fields:
        state = self._state
        mode = shown(state.mode)
        base = CUSTOM | STABILIZED | MANUAL | (GUIDED if mode.is_guided else 0) | (ARMED if state.armed else 0)
        failed = state.failsafe or self._failsafes.is_active
        status = "CRITICAL" if failed else "ACTIVE" if state.armed else "STANDBY"
        return {
            "type": "MAV_TYPE_SUBMARINE",
            "autopilot": "MAV_AUTOPILOT_ARDUPILOTMEGA",
            "base_mode": base,
            "custom_mode": self._numbers[mode.entry],
            "system_status": f"MAV_STATE_{status}",
            "mavlink_version": 3,
        }

    def _current_mode(self) -> Fields:
        number = self._numbers[shown(self._state.mode).entry]
        return {"custom_mode": number, "intended_custom_mode": number}

    def _sys_status(self) -> Fields:
        readings, state = self._readings, self._state
        present = RATE_CONTROL | ATTITUDE_CONTROL | YAW_CONTROL | Z_CONTROL | XY_CONTROL | OUTPUTS | PREARM | GEOFENCE
        healthy = present
        leaks = bool((readings.last("leak") or {}).get("leak"))
        # An armed vehicle has passed the checks, as in ArduPilot.
        if not state.has_autopilot or (leaks and not state.armed):
            healthy &= ~PREARM
        for kind, bits in _INSTRUMENTS.items():
            if readings.has(kind):
                present |= bits
                healthy |= bits if readings.last(kind) is not None else 0
        enabled = present & ~GEOFENCE if state.armed else present & ~(GEOFENCE | OUTPUTS)
        voltage, current = readings.number("battery", "voltage"), readings.number("battery", "current")
        charge = readings.number("battery", "charge")
        return {
            "onboard_control_sensors_present": present,
            "onboard_control_sensors_enabled": enabled,
            "onboard_control_sensors_health": healthy,
            "voltage_battery": UNKNOWN_16 if voltage is None else voltage * 1e3,
            "current_battery": -1 if current is None else current * 1e2,
            "battery_remaining": -1 if charge is None else charge * 1e2,
        }

    def _system_time(self) -> Fields:
        unix = self._epoch_ns + self._readings.t_ns
        return {"time_unix_usec": unix // 1000, "time_boot_ms": self._boot_ms}

    # -- attitude and position --------------------------------------------------------------------------------------------------------

    def _attitude(self) -> Fields | None:
        state = self._state
        if state.q_NB is None:
            return None
        roll, pitch, yaw = rpy_from_quat(state.q_NB)
        return {**self._rates(), "roll": roll, "pitch": pitch, "yaw": yaw}

    def _attitude_quaternion(self) -> Fields | None:
        state = self._state
        if state.q_NB is None:
            return None
        q1, q2, q3, q4 = state.q_NB
        return {**self._rates(), "q1": q1, "q2": q2, "q3": q3, "q4": q4}

    def _rates(self) -> dict[str, float]:
        """Return time and angular rates, which both attitude messages have."""
        p, q, r = self._state.w_B or (0.0, 0.0, 0.0)
        return {"time_boot_ms": self._boot_ms, "rollspeed": p, "pitchspeed": q, "yawspeed": r}

    def _yaw(self) -> float | None:
        q = self._state.q_NB
        return None if q is None else rpy_from_quat(q)[2]

    def _altitude(self) -> float:
        """Return the altitude above the sea, m."""
        state = self._state
        if state.depth is not None:
            return -state.depth
        return 0.0 if state.p_N is None else -state.p_N[2]

    def _lat_lon(self) -> tuple[float, float]:
        """Return latitude and longitude in 1e-7 degrees; zeros, as in ArduPilot, where they are not known."""
        state = self._state
        place = None if state.p_N is None else self._home.place(state.p_N)
        return (0.0, 0.0) if place is None else (degrees_e7(place.latitude), degrees_e7(place.longitude))

    def _ahrs2(self) -> Fields | None:
        if self._state.q_NB is None:
            return None
        roll, pitch, yaw = rpy_from_quat(self._state.q_NB)
        lat, lng = self._lat_lon()
        return {"roll": roll, "pitch": pitch, "yaw": yaw, "altitude": self._altitude(), "lat": lat, "lng": lng}

    def _global_position(self) -> Fields:
        lat, lon = self._lat_lon()
        altitude, home, yaw = self._altitude(), self._home.home, self._yaw()
        v = self._state.v_N or (0.0, 0.0, self._state.sink)
        return {
            "time_boot_ms": self._boot_ms,
            "lat": lat,
            "lon": lon,
            "alt": altitude * 1e3,
            "relative_alt": (altitude - (home.altitude if home is not None else 0.0)) * 1e3,
            "vx": v[0] * 1e2,
            "vy": v[1] * 1e2,
            "vz": v[2] * 1e2,
            "hdg": UNKNOWN_16 if yaw is None else compass_centidegrees(yaw),
        }

    def _local_position(self) -> Fields | None:
        state = self._state
        if state.p_N is None:
            return None
        v = state.v_N or (0.0, 0.0, 0.0)
        x, y, z = state.p_N
        return {"time_boot_ms": self._boot_ms, "x": x, "y": y, "z": z, "vx": v[0], "vy": v[1], "vz": v[2]}

    def _vfr_hud(self) -> Fields:
        state, yaw = self._state, self._yaw()
        v = state.v_N or (0.0, 0.0, 0.0)
        throttle = 50.0 * (1.0 - self._pilot.deflections[2])
        speed = math.hypot(v[0], v[1])
        return {
            "airspeed": 0.0,
            "groundspeed": speed,
            "heading": 0 if yaw is None else compass_centidegrees(yaw) // 100,
            "throttle": throttle if state.armed else 0,
            "alt": self._altitude(),
            "climb": -state.sink,
        }

    def _nav_controller(self) -> Fields:
        state = self._state
        fields: dict[str, float] = {}
        if state.heading_ref is not None:
            fields["nav_bearing"] = degrees(wrapped(state.heading_ref))
        if state.depth_ref is not None and state.depth is not None:
            fields["alt_error"] = state.depth - state.depth_ref
        if state.p_ref_N is not None and state.p_N is not None:
            north, east = state.p_ref_N[0] - state.p_N[0], state.p_ref_N[1] - state.p_N[1]
            fields["target_bearing"] = degrees(math.atan2(east, north))
            fields["wp_dist"] = math.hypot(north, east)
        return fields

    def _position_target(self) -> Fields | None:
        p = self._state.p_ref_N
        if p is None:
            return None
        return {"time_boot_ms": self._boot_ms, "coordinate_frame": LOCAL_NED, "type_mask": 0xDF8, "x": p[0], "y": p[1], "z": p[2]}  # fmt: skip

    def _position_target_global(self) -> Fields | None:
        p = self._state.p_ref_N
        place = None if p is None else self._home.place(p)
        if place is None:
            return None
        lat, lon = degrees_e7(place.latitude), degrees_e7(place.longitude)
        base: Fields = {"time_boot_ms": self._boot_ms, "coordinate_frame": "MAV_FRAME_GLOBAL_INT", "type_mask": 0xDF8}
        return {**base, "lat_int": lat, "lon_int": lon, "alt": place.altitude}

    def _ekf_status(self) -> Fields:
        """Return what is estimated: attitude, velocity, relative and absolute position, altitude above sea and bottom; 0x80: no position."""
        state = self._state
        known = {
            0x1: state.q_NB is not None,
            0x6: state.v_N is not None,
            0x8: state.p_N is not None,
            0x10: state.p_N is not None and self._home.origin is not None,
            0x20: state.depth is not None,
            0x40: state.altitude is not None,
            0x80: state.q_NB is not None and state.p_N is None,
        }
        return {"flags": sum(bits for bits, is_known in known.items() if is_known)}

    # -- control ----------------------------------------------------------------------------------------------------------------------

    def _rc_channels(self) -> Fields:
        channels = self._pilot.channels
        fields: dict[str, int] = {"time_boot_ms": self._boot_ms, "chancount": len(channels), "rssi": 0xFF}
        return fields | {f"chan{k}_raw": pulse_us for k, pulse_us in enumerate(channels, 1)}

    def _servo_output(self) -> Fields:
        state = self._state
        servos = self._outputs.pulses(state.outputs if state.armed else ())
        fields: dict[str, int] = {"time_usec": microseconds(self._readings.t_ns) & 0xFFFF_FFFF}
        return fields | {f"servo{number}_raw": width for number, width in servos.items()}

    def _gimbal(self) -> Fields:
        """Return the direction of the camera mount: roll and pitch from the horizon, yaw from the bow."""
        payload = self._payload
        q = quat_from_rpy(0.0, from_degrees(payload.tilt), from_degrees(payload.pan))
        return {"time_boot_ms": self._boot_ms, "flags": _LEVEL_FROM_BOW, "q": q}

    def _named_values(self) -> Sequence[Fields]:
        payload, pilot = self._payload, self._pilot
        values = {
            "CamTilt": 0.5 - 0.5 * payload.tilt / TILT_LIMIT_DEG,
            "CamPan": 0.5 - 0.5 * payload.pan / TILT_LIMIT_DEG,
            "TetherTrn": self._readings.turns,
            "Lights1": payload.lights[0],
            "Lights2": payload.lights[1],
            "PilotGain": pilot.gain,
            "InputHold": float(pilot.is_held),
            "RollPitch": float(pilot.steers_attitude),
            "RFTarget": self._state.altitude_target,
        }
        return [{"time_boot_ms": self._boot_ms, "name": name, "value": value} for name, value in values.items()]
