"""Instrument readings as messages, one function for each. A function returns None when there is nothing to send."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from uwserver_adapters.mavlink.vehicle.readings import Readings
from uwserver_adapters.mavlink.wire.codec import (
    STANDARD_ATMOSPHERE,
    STANDARD_GRAVITY,
    compass_centidegrees,
    degrees_e7,
    microseconds,
    milliseconds,
)
from uwserver_adapters.mavlink.wire.dialect import Fields

UNKNOWN_16 = 0xFFFF


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
