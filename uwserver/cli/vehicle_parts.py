"""Describes a vehicle file in lines of text: where its thrusters are and push, its fins, propellers, sensors and actuators."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.table import Vector3


def parts_of(name: str) -> Iterator[str]:
    """Yield lines about a shipped vehicle, with positions in B (forward, right, down)."""
    scenario = ScenarioBuilder(name).vehicle("v", name, position_ned_m=(0.0, 0.0, 5.0)).build()
    file = load(scenario, adapters={}).vehicles["v"].vehicle
    body = file.rigid_body
    yield f"{body.mass_kg:g} kg, displaces {1e3 * file.buoyancy.volume_m3:g} l"
    yield from _propulsors(file)
    if file.fins:
        yield f"fins: {', '.join(file.fins)}"
    for title, table in (("sensors", file.sensors), ("actuators", file.actuators)):
        kinds = [f"{key} ({part.__struct_config__.tag})" for key, part in table.items()]
        yield f"{title}: {', '.join(kinds) or 'none'}"
    yield f"picture: uwserver plot vehicle {name}; what it does: uwserver manoeuvres {name}"


def _propulsors(file: VehicleFile) -> Iterator[str]:
    placed = [("thruster", key, each.position_frd_m, each.axis_frd) for key, each in file.thrusters.items()]
    placed += [("propeller", key, each.position_frd_m, each.axis_frd) for key, each in file.propellers.items()]
    if placed:
        yield f"{'':10} {'':14} {'at, m: x forward':>16} {'y right':>8} {'z down':>8}   pushes to, at a positive command"
    for kind, key, place, axis in placed:
        x, y, z = place
        yield f"{kind:10} {key:14} {x:>16.3f} {y:>8.3f} {z:>8.3f}   {_direction(axis)}"


def _direction(axis: Vector3) -> str:
    """Return a direction in B in words, followed by its components: ``ahead and right (0.71, 0.71, 0.00)``."""
    unit = np.array(axis) / np.linalg.norm(axis)
    names = (("ahead", "astern"), ("right", "left"), ("down", "up"))
    words = [names[k][int(unit[k] < 0)] for k in range(3) if abs(unit[k]) > 0.2]
    return f"{' and '.join(words)} ({', '.join(f'{each + 0.0:.2f}' for each in unit)})"
