"""Finds a command that visibly moves a vehicle, for `uwserver run` to suggest."""

from __future__ import annotations

import math

import numpy as np

from uwserver.actuators import ActuatorConfig, ForceTorqueConfig, PropellerConfig, ThrustersConfig
from uwserver.scenario.load.resolved import ResolvedVehicle

STRENGTH = 0.5
"""Command of the strongest thruster as a part of full command: well above a dead band, and not fast."""
_DOWN, _AHEAD = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_TURNING_M = 5.0
"""Weight of moments relative to forces, 1/m. It is large because to go straight matters more than to go fast."""


def first_command(vehicle: ResolvedVehicle) -> str:
    """Return arguments for `uwclient send` that move a vehicle down, or else ahead; "" if no actuator is of a kind known here."""
    for name, actuator in vehicle.vehicle.actuators.items():
        if value := _value(vehicle, actuator):
            # A long hull with one propeller gathers speed slowly.
            seconds = 10 if isinstance(actuator, PropellerConfig) else 3
            return f"{vehicle.name}/{name} {value} --rate 10 --seconds {seconds}"
    return ""


def _value(vehicle: ResolvedVehicle, actuator: ActuatorConfig) -> str:
    if isinstance(actuator, ThrustersConfig) and actuator.input == "u":
        return f"u='[{','.join(f'{u:g}' for u in thruster_command(vehicle, actuator))}]'"
    if isinstance(actuator, ForceTorqueConfig):
        force = 0.3 * 9.8 * vehicle.vehicle.rigid_body.mass_kg
        limit = actuator.max_force_N or force
        return f"force_B='[0,0,{round(min(force, 0.5 * limit)):d}]'"
    if isinstance(actuator, PropellerConfig):
        limit = vehicle.vehicle.propellers[actuator.member].max_speed_radps
        return f"speed_radps={math.floor(limit):d}"
    return ""


def thruster_command(vehicle: ResolvedVehicle, actuator: ThrustersConfig) -> list[float]:
    """Return commands u that push down, or ahead if nothing pushes down, and turn the vehicle as little as its thrusters allow."""
    thrusters = vehicle.vehicle.thrusters
    columns = []
    for thruster in map(thrusters.__getitem__, actuator.members or thrusters):
        axis = np.array(thruster.axis_frd) / np.linalg.norm(thruster.axis_frd)
        moment = np.cross(np.array(thruster.position_frd_m), axis)
        columns.append(np.concatenate([axis, _TURNING_M * moment]))
    effect = np.stack(columns, axis=1)
    for wanted in (_DOWN, _AHEAD):
        shares = np.linalg.pinv(effect, rcond=1e-3) @ np.array(wanted)
        if (effect @ shares) @ np.array(wanted) > 0.5:
            break
    return [round(STRENGTH * float(share) / float(np.abs(shares).max()), 2) + 0.0 for share in shares]
