"""A command that visibly moves a vehicle: what `uwserver run` proposes to type."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from uwserver.actuators import ActuatorConfig, ForceTorqueConfig, PropellerConfig, ThrustersConfig
from uwserver.scenario.load.resolved import ResolvedVehicle

STRENGTH = 0.5
"""Of the strongest thruster, as part of full command: well above a dead band, and not a race."""
_DOWN, _AHEAD = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_TURNING_M = 5.0
"""Weight of moments against forces, 1/m: a vehicle that goes straight is worth more than one that goes fast."""


def first_command(vehicle: ResolvedVehicle) -> str:
    """Arguments for `uwclient send`: down, else ahead; "" for a vehicle with nothing of a kind that is known here."""
    for name, actuator in vehicle.vehicle.actuators.items():
        value = _value(vehicle, actuator)
        if value:
            seconds = 10 if isinstance(actuator, PropellerConfig) else 3  # one propeller on a long hull takes its time
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
    """Commands u that push down, or ahead where nothing pushes down; without turning the vehicle, as far as its thrusters can."""
    table: Mapping[str, object] = vehicle.vehicle.thrusters
    members = [vehicle.vehicle.thrusters[name] for name in actuator.members or table]
    columns = []
    for thruster in members:
        axis = np.array(thruster.axis_frd) / np.linalg.norm(thruster.axis_frd)
        moment = np.cross(np.array(thruster.position_frd_m), axis)
        columns.append(np.concatenate([axis, _TURNING_M * moment]))
    effect = np.stack(columns, axis=1)
    for wanted in (_DOWN, _AHEAD):
        shares = np.linalg.pinv(effect, rcond=1e-3) @ np.array(wanted)
        if (effect @ shares) @ np.array(wanted) > 0.5:
            break
    return [round(STRENGTH * float(share) / float(np.abs(shares).max()), 2) + 0.0 for share in shares]
