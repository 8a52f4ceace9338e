"""The sensors that a vehicle can carry: each kind has one file, and one line in the union below."""

from __future__ import annotations

from uwserver.sensors.acoustic.acoustic_modem import AcousticModemConfig
from uwserver.sensors.acoustic.altimeter import AltimeterConfig
from uwserver.sensors.acoustic.bathymetry import BathymetryConfig
from uwserver.sensors.acoustic.doppler.adcp import AdcpConfig
from uwserver.sensors.acoustic.doppler.dvl import DvlConfig
from uwserver.sensors.acoustic.multibeam import MultibeamConfig
from uwserver.sensors.acoustic.positioning.lbl import LblConfig
from uwserver.sensors.acoustic.positioning.usbl import UsblConfig
from uwserver.sensors.acoustic.profiler import ProfilerConfig
from uwserver.sensors.acoustic.scanning_sonar import ScanningSonarConfig
from uwserver.sensors.acoustic.side_scan import SideScanConfig
from uwserver.sensors.base import IdealSensor, Pose, Scope, Sensor, SensorTable, Settings, StreamTable, Traits
from uwserver.sensors.compound import CompoundConfig
from uwserver.sensors.modem import ModemTable
from uwserver.sensors.motion.attitude import AttitudeConfig
from uwserver.sensors.motion.gps import GpsConfig
from uwserver.sensors.motion.imu import ImuConfig
from uwserver.sensors.motion.magnetometer import MagnetometerConfig
from uwserver.sensors.motion.motion_capture import MotionCaptureConfig
from uwserver.sensors.onboard.battery import BatteryConfig
from uwserver.sensors.onboard.clock import ClockConfig
from uwserver.sensors.onboard.contact import ContactConfig
from uwserver.sensors.onboard.leak import LeakConfig
from uwserver.sensors.onboard.rpm import RpmConfig
from uwserver.sensors.onboard.training import TrainingConfig
from uwserver.sensors.optical.camera.camera import CameraConfig
from uwserver.sensors.optical.optical_modem import OpticalModemConfig
from uwserver.sensors.optical.range_array import RangeArrayConfig
from uwserver.sensors.water.ctd import CtdConfig
from uwserver.sensors.water.pressure import PressureConfig
from uwserver.sensors.water.sound_speed import SoundSpeedConfig

SensorConfig = (
    ImuConfig
    | PressureConfig
    | MotionCaptureConfig
    | DvlConfig
    | AdcpConfig
    | AltimeterConfig
    | ScanningSonarConfig
    | MultibeamConfig
    | SideScanConfig
    | BathymetryConfig
    | ProfilerConfig
    | UsblConfig
    | LblConfig
    | AcousticModemConfig
    | OpticalModemConfig
    | MagnetometerConfig
    | AttitudeConfig
    | GpsConfig
    | CtdConfig
    | SoundSpeedConfig
    | RangeArrayConfig
    | CameraConfig
    | ContactConfig
    | BatteryConfig
    | LeakConfig
    | RpmConfig
    | ClockConfig
    | TrainingConfig
    | CompoundConfig
)

__all__ = [
    "AcousticModemConfig", "AdcpConfig", "AltimeterConfig", "AttitudeConfig", "BathymetryConfig", "BatteryConfig",
    "CameraConfig", "ClockConfig", "CompoundConfig", "ContactConfig", "CtdConfig", "DvlConfig", "GpsConfig",
    "IdealSensor", "ImuConfig", "LblConfig", "LeakConfig", "MagnetometerConfig", "ModemTable", "MotionCaptureConfig",
    "MultibeamConfig", "OpticalModemConfig", "Pose", "PressureConfig", "ProfilerConfig", "RangeArrayConfig",
    "RpmConfig", "ScanningSonarConfig", "Scope", "Sensor", "SensorConfig", "SensorTable", "Settings",
    "SideScanConfig", "SoundSpeedConfig", "StreamTable", "TrainingConfig", "Traits", "UsblConfig",
]  # fmt: skip
