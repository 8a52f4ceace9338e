"""Sensors a vehicle can carry: one file a kind, one line in the union."""

from __future__ import annotations

from uwserver.sensors.altimeter import AltimeterConfig
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable
from uwserver.sensors.dvl import DvlConfig
from uwserver.sensors.imu import ImuConfig
from uwserver.sensors.instrument import Instrument, Settings
from uwserver.sensors.interrogation import carriers
from uwserver.sensors.lbl import LblConfig
from uwserver.sensors.motion_capture import MotionCaptureConfig
from uwserver.sensors.pressure import PressureConfig
from uwserver.sensors.scanning_sonar import ScanningSonarConfig
from uwserver.sensors.usbl import UsblConfig

SensorConfig = (
    ImuConfig | PressureConfig | MotionCaptureConfig | DvlConfig | AltimeterConfig | ScanningSonarConfig | UsblConfig | LblConfig
)  # fmt: skip

__all__ = [
    "AltimeterConfig", "DvlConfig", "ImuConfig", "Instrument", "LblConfig", "MotionCaptureConfig", "Pose", "PressureConfig",
    "ScanningSonarConfig", "Scope", "Sensor", "SensorConfig", "SensorTable", "Settings", "UsblConfig", "carriers",
]  # fmt: skip
