"""The last readings of one vehicle's instruments and its autopilot, and the messages of its instruments. Ground truth is never used."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping

from msgspec import Struct, structs

from uwserver.adapter import AdapterContext
from uwserver.frames import Quat, Vec3, rpy_from_quat
from uwserver.ports import Value
from uwserver_adapters.mavlink.wire.codec import (
    STANDARD_ATMOSPHERE,
    STANDARD_GRAVITY,
    compass_centidegrees,
    degrees_e7,
    finite,
    microseconds,
    milliseconds,
    turns,
    vec3,
    vector,
    wrapped,
)
from uwserver_adapters.mavlink.wire.dialect import Fields

Reading = Mapping[str, Value]
INSTRUMENTS: Mapping[str, str] = {
    "Range": "altimeter", "Attitude": "attitude", "Estimate": "autopilot", "BatteryState": "battery", "Dvl": "dvl", "NavSatFix": "gps",
    "Imu": "imu", "Leak": "leak", "MagneticField": "magnetometer", "FluidPressure": "pressure",
}  # fmt: skip
"""Standard message of a port -> the instrument whose readings are sent to ground stations."""
_ASSUMED_NS = 2_000_000_000
"""An assumed change is dropped when the autopilot's last sample is this much older than the change, ns."""
UNKNOWN_16 = 0xFFFF


class State(Struct, frozen=True):
    """What is known of the vehicle. None stands for unknown.

    Attributes:
        has_autopilot: there is an autopilot, and it has sent a sample.
        mode, armed, failsafe: state of the autopilot.
        p_N, v_N: estimated position (m) and velocity (m/s) in N, when valid.
        sink: vertical speed, m/s down, when the depth is known.
        q_NB, w_B: attitude and angular rates (rad/s).
        depth, altitude: below the surface and above the bottom, m.
        p_ref_N, depth_ref, heading_ref: set points.
        mission_index, mission_count, reached: state of the mission.
        outputs: the autopilot's commands to the actuators, -1 to 1.
    """

    has_autopilot: bool = False
    mode: str = "manual"
    armed: bool = False
    failsafe: str = ""
    p_N: Vec3 | None = None
    v_N: Vec3 | None = None
    sink: float = 0.0
    q_NB: Quat | None = None
    w_B: Vec3 | None = None
    depth: float | None = None
    altitude: float | None = None
    p_ref_N: Vec3 | None = None
    depth_ref: float | None = None
    heading_ref: float | None = None
    mission_index: int = -1
    mission_count: int = 0
    reached: int = 0
    outputs: tuple[float, ...] = ()

    @property
    def altitude_target(self) -> float:
        """Altitude above the bottom (m) that SURFTRAK holds; 0 in other modes."""
        if self.mode != "altitude_hold" or self.depth_ref is None or self.depth is None or self.altitude is None:
            return 0.0
        return self.altitude + self.depth - self.depth_ref


class Readings:
    """The newest samples, found by the kinds of their ports. Runs on the loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle.

    Attributes:
        t_ns: simulation time.
        turns: full turns of the heading since the start, clockwise positive.
    """

    def __init__(self, context: AdapterContext, vehicle: str) -> None:
        self._context = context
        self._vehicle = vehicle
        self.t_ns = 0
        self.turns = 0.0
        self._last_yaw: float | None = None
        self._ports: dict[str, tuple[str, tuple[str, ...]]] = {}
        self._known: tuple[int, State] = (-1, State())
        self._assumed: dict[str, str | bool] = {}
        self._assumed_ns = 0
        self.open_ports()

    def open_ports(self) -> None:
        """Find the ports again. The first port of each kind counts."""
        self._ports.clear()
        self._known = (-1, State())
        for path, port in self._context.ports.items():
            if port.direction == "sensor" and path.startswith(f"{self._vehicle}/") and not port.is_truth:
                names = tuple(field.name for field in port.fields)
                found = INSTRUMENTS.get(port.message or "", "")
                if found == "pressure" and "depth" in names:
                    found = "depth"
                if found and (found != "autopilot" or path == f"{self._vehicle}/autopilot/state"):
                    self._ports.setdefault(found, (path, names))

    @property
    def subscriptions(self) -> Collection[str] | None:
        """The ports that are read. None, which means all, without any such instrument: the telemetry needs some samples to follow the time."""
        return frozenset(path for path, _ in self._ports.values()) or None

    def has(self, kind: str) -> bool:
        """Return whether the vehicle has this instrument of `INSTRUMENTS`; `depth` is a pressure sensor that gives the depth."""
        return kind in self._ports

    def last(self, kind: str) -> Reading | None:
        """Return the fields of the newest sample; None when there is none or it is not valid."""
        known = self._ports.get(kind)
        sample = self._context.last(known[0]) if known is not None else None
        if known is None or sample is None or not sample.valid:
            return None
        return dict(zip(known[1], sample.value, strict=False))

    def number(self, kind: str, field: str) -> float | None:
        """Return a number of the newest valid sample; None when it is not finite."""
        reading = self.last(kind)
        return None if reading is None else finite(reading.get(field))

    def state(self) -> State:
        """Return everything that is known at `t_ns`."""
        if self._known[0] != self.t_ns:
            self._known = (self.t_ns, self._state())
        return self._known[1]

    def forget(self) -> None:
        """Read the samples again at the next call, even at the same time."""
        self._known = (-1, State())

    def count_turns(self) -> None:
        """Count the turns of the heading. Must be called at least twice per turn."""
        q = self.state().q_NB
        if q is None:
            return
        yaw = rpy_from_quat(q)[2]
        if self._last_yaw is not None:
            self.turns += turns(wrapped(yaw - self._last_yaw))
        self._last_yaw = yaw

    def assume(self, t_ns: int, **fields: str | bool) -> None:
        """Assume that the autopilot has changed as requested, although it has not said so yet.

        It sends its state only a few times per second, and a ground station goes on as soon as it has been told that the mode has changed.

        Args:
            t_ns: simulation time of the change. The autopilot's later samples count again.
            fields: `mode` or `armed`.
        """
        self._assumed.update(fields)
        self._assumed_ns = t_ns
        self.forget()

    def _state(self) -> State:
        state = self._said()
        if self._assumed:
            sample = self._context.last(self._ports["autopilot"][0]) if "autopilot" in self._ports else None
            if sample is None or not 0 <= self._assumed_ns - sample.t_ns < _ASSUMED_NS:
                self._assumed.clear()
            else:
                state = structs.replace(state, **self._assumed)
        return state

    def _said(self) -> State:
        said = self.last("autopilot")
        if said is None:
            return self._without_autopilot()
        altitude, depth, v_N = finite(said.get("altitude")), finite(said.get("depth")), vec3(said.get("v_N"))
        return State(
            has_autopilot=True,
            mode=str(said.get("mode")),
            armed=bool(said.get("armed")),
            failsafe=str(said.get("failsafe") or ""),
            p_N=vec3(said.get("p_N")) if said.get("position_valid") else None,
            v_N=v_N if said.get("velocity_valid") else None,
            sink=v_N[2] if v_N is not None and depth is not None else 0.0,
            q_NB=_quat(said.get("q_NB")),
            w_B=vec3(said.get("w_B")),
            depth=depth,
            altitude=self._altitude() if altitude is None else altitude,
            p_ref_N=vec3(said.get("p_ref_N")),
            depth_ref=finite(said.get("depth_ref")),
            heading_ref=finite(said.get("heading_ref")),
            mission_index=_integer(said.get("mission_index"), -1),
            mission_count=_integer(said.get("mission_count"), 0),
            reached=_integer(said.get("reached"), 0),
            outputs=_row(said.get("outputs")),
        )

    def _without_autopilot(self) -> State:
        attitude, imu = self.last("attitude") or {}, self.last("imu") or {}
        return State(
            q_NB=_quat(attitude.get("q_NS")),
            w_B=vec3(imu.get("w_S")),
            depth=self.number("depth", "depth"),
            altitude=self._altitude(),
        )

    def _altitude(self) -> float | None:
        altitude = self.number("altimeter", "range")
        return self.number("dvl", "altitude") if altitude is None else altitude


def _quat(value: object) -> Quat | None:
    row = vector(value, 4)
    if row is None or not 0.5 < sum(entry * entry for entry in row) < 2.0:
        return None
    return (row[0], row[1], row[2], row[3])


def _row(value: object) -> tuple[float, ...]:
    return (vector(value, len(value)) or ()) if isinstance(value, tuple) else ()


def _integer(value: object, default: int) -> int:
    number = finite(value)
    return default if number is None else int(number)


class Instruments:
    """Builds the messages of instruments.

    Args:
        readings: the newest samples.

    Attributes:
        builders: a function for each message, by its name.
    """

    def __init__(self, readings: Readings) -> None:
        self._readings = readings
        self.builders: Mapping[str, Callable[[], Fields | None]] = {
            "RAW_IMU": self._raw_imu,
            "SCALED_PRESSURE": lambda: self._pressure_message(STANDARD_ATMOSPHERE, self._water_temperature()),
            "SCALED_PRESSURE2": self._water_pressure,
            "SCALED_PRESSURE3": self._thermometer,
            "GPS_RAW_INT": self._gps_raw,
            "RANGEFINDER": self._rangefinder,
            "DISTANCE_SENSOR": self._distance_sensor,
            "BATTERY_STATUS": self._battery_status,
            "VIBRATION": lambda: {"time_usec": microseconds(self._readings.t_ns)},
        }

    def _raw_imu(self) -> Fields | None:
        imu, compass = self._readings.last("imu"), self._readings.last("magnetometer")
        f, w = (imu or {}).get("f_S"), (imu or {}).get("w_S")
        if not isinstance(f, tuple) or not isinstance(w, tuple):
            return None
        field = (compass or {}).get("field_S")
        rows = (("acc", f, 1e3 / STANDARD_GRAVITY), ("gyro", w, 1e3), ("mag", field, 1e7))  # mG, mrad/s, mGauss
        fields: dict[str, float] = {"time_usec": microseconds(self._readings.t_ns)}
        for name, row, scale in rows:
            if isinstance(row, tuple):
                fields |= {f"{axis}{name}": v * scale for axis, v in zip("xyz", row, strict=True) if isinstance(v, int | float)}  # fmt: skip
        return fields

    def _water_temperature(self) -> float | None:
        """Return the temperature (degC) of the first instrument that measures it."""
        return next((t for kind in ("pressure", "depth", "imu") if (t := self._readings.number(kind, "temperature")) is not None), None)  # fmt: skip

    def _pressure_message(self, pressure: float | None, temperature: float | None) -> Fields | None:
        if pressure is None:
            return None
        fields = {"time_boot_ms": milliseconds(self._readings.t_ns), "press_abs": pressure / 1e2}  # hPa
        if temperature is not None:
            # 0 stands for an unknown temperature, so MAVLink wants 1 for zero degrees.
            fields["temperature"] = round(temperature * 1e2) or 1
        return fields

    def _water_pressure(self) -> Fields | None:
        return self._pressure_message(self._readings.number("pressure", "pressure"), self._water_temperature())

    def _thermometer(self) -> Fields | None:
        temperature = self._water_temperature()
        return None if temperature is None else self._pressure_message(0.0, temperature)

    def _gps_raw(self) -> Fields:
        gps = self._readings.last("gps") or {}
        fields: dict[str, float] = {
            "time_usec": microseconds(self._readings.t_ns),
            "eph": UNKNOWN_16,
            "epv": UNKNOWN_16,
        }
        number = self._readings.number
        latitude, longitude = number("gps", "latitude"), number("gps", "longitude")
        satellites = number("gps", "satellites")
        if latitude is None or longitude is None:
            # ArduPilot sends 0 satellites then. Cockpit would show 255, which stands for unknown, as a number.
            return {**fields, "satellites_visible": satellites or 0, "fix_type": 1 if self._readings.has("gps") else 0}
        fields["satellites_visible"] = 0xFF if satellites is None else satellites
        height = number("gps", "height") or 0.0
        scaled = {"horizontal_accuracy": "h_acc", "vertical_accuracy": "v_acc", "velocity_accuracy": "vel_acc"}
        fields |= {to: value * 1e3 for field, to in scaled.items() if (value := number("gps", field)) is not None}
        v = gps.get("v_NS")
        if isinstance(v, tuple) and all(isinstance(entry, int | float) for entry in v):
            north, east = float(v[0] or 0.0), float(v[1] or 0.0)
            fields["vel"] = math.hypot(north, east) * 1e2
            fields["cog"] = compass_centidegrees(math.atan2(east, north))
        return {
            **fields,
            "fix_type": number("gps", "fix") or 0.0,
            "lat": degrees_e7(latitude),
            "lon": degrees_e7(longitude),
            "alt": height * 1e3,
            "alt_ellipsoid": height * 1e3,
        }

    def _rangefinder(self) -> Fields | None:
        altitude = self._readings.state().altitude
        return None if altitude is None else {"distance": altitude}

    def _distance_sensor(self) -> Fields | None:
        altitude = self._readings.state().altitude
        if altitude is None:
            return None
        confidence = self._readings.number("altimeter", "confidence")
        return {
            "time_boot_ms": milliseconds(self._readings.t_ns),
            "min_distance": 0,
            "max_distance": 0xFFFF - 1,
            "current_distance": altitude * 1e2,
            "type": "MAV_DISTANCE_SENSOR_ULTRASOUND",
            "orientation": "MAV_SENSOR_ROTATION_PITCH_270",  # down
            "signal_quality": 0 if confidence is None else 1 + 99 * confidence,
        }

    def _battery_status(self) -> Fields | None:
        battery = self._readings
        voltage = battery.number("battery", "voltage")
        if voltage is None:
            return None
        current, charge = battery.number("battery", "current"), battery.number("battery", "charge")
        energy = battery.number("battery", "energy")
        return {
            "temperature": 0x7FFF,
            "voltages": (round(voltage * 1e3), *(UNKNOWN_16,) * 9),
            "current_battery": -1 if current is None else current * 1e2,
            "current_consumed": -1,
            "energy_consumed": -1 if energy is None else energy / 100.0,  # hJ
            "battery_remaining": -1 if charge is None else charge * 1e2,
            "charge_state": "MAV_BATTERY_CHARGE_STATE_OK",
        }
