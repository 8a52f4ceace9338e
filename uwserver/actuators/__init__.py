"""The kinds of actuators: one file for each family, one line in the union for each kind."""

from __future__ import annotations

from uwserver.actuators.base import Actuator, ActuatorTable, Body, Devices, Given
from uwserver.actuators.camera_mount import CameraMount, CameraMountConfig
from uwserver.actuators.force_torque import ForceTorqueConfig
from uwserver.actuators.lamps import Lamps, LampsConfig
from uwserver.actuators.servo import BallastConfig, FinConfig, FinsConfig, MovingMassConfig, PropellerConfig
from uwserver.actuators.teleport import TeleportConfig
from uwserver.actuators.thruster import ThrusterConfig, Thrusters, ThrustersConfig

ActuatorConfig = (
    ThrustersConfig
    | ThrusterConfig
    | FinsConfig
    | FinConfig
    | PropellerConfig
    | BallastConfig
    | MovingMassConfig
    | ForceTorqueConfig
    | TeleportConfig
    | LampsConfig
    | CameraMountConfig
)

__all__ = [
    "Actuator", "ActuatorConfig", "ActuatorTable", "BallastConfig", "Body", "CameraMount", "CameraMountConfig", "Devices", "FinConfig", "FinsConfig",
    "ForceTorqueConfig", "Given", "Lamps", "LampsConfig", "MovingMassConfig", "PropellerConfig", "TeleportConfig", "ThrusterConfig",
    "Thrusters", "ThrustersConfig",
]  # fmt: skip
