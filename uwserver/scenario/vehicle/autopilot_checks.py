"""Checks the built-in autopilot of a vehicle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from msgspec import UnsetType

from uwserver.actuators import ActuatorConfig
from uwserver.autopilot.config import AutopilotConfig
from uwserver.autopilot.gains import Gains
from uwserver.scenario.files.convert import Node, Report, convert, fields
from uwserver.scenario.files.errors import KeyPath, suggestion
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.tables import WorldTable


def check_autopilot(
    config: AutopilotConfig, vehicle: Node, path: KeyPath, world: WorldTable | None, report: Report
) -> None:
    """Check the rates, the names and values of gains, and that the autopilot can steer the vehicle.

    Args:
        config: the table in the scenario.
        vehicle: the merged vehicle file, as a `VehicleFile`.
        path: of the table.
        world: of the scenario; None if it has errors.
        report: called for errors.
    """
    for key in ("rate_hz", "state_rate_hz"):
        rate = getattr(config, key)
        if world is not None and not isinstance(rate, UnsetType):
            check_rate(rate, world.rate_hz, (*path, key), report)
    types: dict[str, Any] = {info.name: info.type for info in fields(Gains)}
    for name, value in config.gains.items():
        place: KeyPath = (*path, "gains", name)
        if name not in types:
            report(place, f'unknown gain "{name}"{suggestion(name, tuple(types))}')
        else:
            convert(value, types[name], place, report)
    for table in ("sensors", "actuators"):
        if "autopilot" in vehicle.values(table):
            report(path, f'"autopilot" in {table} would have the same path as the built-in autopilot: rename it')
    if not is_steerable(vehicle.values("actuators")):
        report(
            path,
            "it cannot steer this vehicle: it needs actuators for thrusters, a force_torque, or fins and a propeller",
        )


def is_steerable(actuators: Mapping[str, ActuatorConfig]) -> bool:
    """Return whether the autopilot can control a vehicle with these: thrusters or a wrench, or fins and a propeller."""
    enabled = [config for config in actuators.values() if config.enabled]
    tables = commanded_tables(enabled)
    has_wrench = any(config.message == "Wrench" for config in enabled)
    return has_wrench or "thrusters" in tables or {"fins", "propellers"} <= tables


def commanded_tables(actuators: Iterable[ActuatorConfig]) -> set[str]:
    """Return those tables of a vehicle file whose entries these actuators command."""
    return {devices.table for config in actuators if (devices := config.devices()) is not None}
