"""Sensors a vehicle can carry: one file a kind, one line in the union."""

from __future__ import annotations

from uwserver.sensors.altimeter import AltimeterConfig
from uwserver.sensors.attitude import AttitudeConfig
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, StreamTable
from uwserver.sensors.battery import BatteryConfig
from uwserver.sensors.clock import ClockConfig
from uwserver.sensors.compound import Compound, CompoundConfig
from uwserver.sensors.contact import ContactConfig
from uwserver.sensors.ctd import CtdConfig
from uwserver.sensors.dvl import DvlConfig
from uwserver.sensors.gps import GpsConfig
from uwserver.sensors.imu import ImuConfig
from uwserver.sensors.instrument import Instrument, Settings
from uwserver.sensors.interrogation import carriers
from uwserver.sensors.lbl import LblConfig
from uwserver.sensors.leak import LeakConfig
from uwserver.sensors.magnetometer import MagnetometerConfig
from uwserver.sensors.motion_capture import MotionCaptureConfig
from uwserver.sensors.pressure import PressureConfig
from uwserver.sensors.range_array import RangeArrayConfig
from uwserver.sensors.rpm import RpmConfig
from uwserver.sensors.scanning_sonar import ScanningSonarConfig
from uwserver.sensors.sound_speed import SoundSpeedConfig
from uwserver.sensors.usbl import UsblConfig

SensorConfig = (
    ImuConfig
    | PressureConfig
    | MotionCaptureConfig
    | DvlConfig
    | AltimeterConfig
    | ScanningSonarConfig
    | UsblConfig
    | LblConfig
    | MagnetometerConfig
    | AttitudeConfig
    | GpsConfig
    | CtdConfig
    | SoundSpeedConfig
    | RangeArrayConfig
    | ContactConfig
    | BatteryConfig
    | LeakConfig
    | RpmConfig
    | ClockConfig
    | CompoundConfig
)

__all__ = [
    "AltimeterConfig", "AttitudeConfig", "BatteryConfig", "ClockConfig", "Compound", "CompoundConfig", "ContactConfig",
    "CtdConfig", "DvlConfig", "GpsConfig", "ImuConfig", "Instrument", "LblConfig", "LeakConfig", "MagnetometerConfig",
    "MotionCaptureConfig", "Pose", "PressureConfig", "RangeArrayConfig", "RpmConfig", "ScanningSonarConfig", "Scope", "Sensor",
    "SensorConfig", "SensorTable", "Settings", "SoundSpeedConfig", "StreamTable", "UsblConfig", "carriers",
]  # fmt: skip
