"""Actuators a vehicle can have: one file a family, one line in the union each."""

from __future__ import annotations

from uwserver.actuators.base import Actuator, ActuatorTable, Body, Given
from uwserver.actuators.force_torque import ForceTorqueConfig
from uwserver.actuators.teleport import TeleportConfig
from uwserver.actuators.thruster import ThrusterConfig, Thrusters, ThrustersConfig

ActuatorConfig = ThrustersConfig | ThrusterConfig | ForceTorqueConfig | TeleportConfig

__all__ = [
    "Actuator", "ActuatorConfig", "ActuatorTable", "Body", "ForceTorqueConfig", "Given", "TeleportConfig", "ThrusterConfig",
    "Thrusters", "ThrustersConfig",
]  # fmt: skip
