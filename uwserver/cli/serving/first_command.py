"""Finds a command that visibly moves a vehicle, for `uwserver run` to suggest."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uwserver.actuators import Devices
from uwserver.scenario.load.resolved import ResolvedVehicle

STRENGTH = 0.5
"""Command of the strongest thruster as a part of full command: well above a dead band, and not fast."""
_DOWN, _AHEAD = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_TURNING_M = 5.0
"""Weight of moments relative to forces, 1/m. It is large because to go straight matters more than to go fast."""


def first_command(vehicle: ResolvedVehicle) -> str:
    """Return arguments for `uwclient send` that move a vehicle down, or else ahead; "" if there is no such command for any actuator."""
    for name, actuator in vehicle.vehicle.actuators.items():
        devices = actuator.devices()
        value = actuator.nudge(vehicle.vehicle.rigid_body.mass_kg) if devices is None else _value(vehicle, devices)
        if value:
            # A long hull with one propeller gathers speed slowly.
            seconds = 10 if devices is not None and devices.table == "propellers" else 3
            return f"{vehicle.name}/{name} {value} --rate 10 --seconds {seconds}"
    return ""


def _value(vehicle: ResolvedVehicle, devices: Devices) -> str:
    if devices.table == "thrusters" and devices.field == "u" and devices.is_vector:
        return f"u='[{','.join(f'{u:g}' for u in thruster_command(vehicle, devices.members))}]'"
    if devices.table == "propellers":
        limit = vehicle.vehicle.propellers[devices.members[0]].max_speed_radps
        return f"{devices.field}={math.floor(limit):d}"
    return ""


def thruster_command(vehicle: ResolvedVehicle, names: Sequence[str]) -> list[float]:
    """Return commands u that push down, or ahead if nothing pushes down, and turn the vehicle as little as its thrusters allow.

    Args:
        vehicle: whose thrusters they are.
        names: names of the thrusters; none for all.
    """
    thrusters = vehicle.vehicle.thrusters
    columns = []
    for thruster in map(thrusters.__getitem__, names or thrusters):
        axis = np.array(thruster.axis_frd) / np.linalg.norm(thruster.axis_frd)
        moment = np.cross(np.array(thruster.position_frd_m), axis)
        columns.append(np.concatenate([axis, _TURNING_M * moment]))
    effect = np.stack(columns, axis=1)
    for wanted in (_DOWN, _AHEAD):
        shares = np.linalg.pinv(effect, rcond=1e-3) @ np.array(wanted)
        if (effect @ shares) @ np.array(wanted) > 0.5:
            break
    return [round(STRENGTH * float(share) / float(np.abs(shares).max()), 2) + 0.0 for share in shares]
