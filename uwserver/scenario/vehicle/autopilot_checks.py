"""Checks of a vehicle's built-in autopilot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec import UnsetType

from uwserver.actuators import (
    ActuatorConfig,
    FinConfig,
    FinsConfig,
    ForceTorqueConfig,
    PropellerConfig,
    ThrusterConfig,
    ThrustersConfig,
)
from uwserver.autopilot.config import AutopilotConfig
from uwserver.autopilot.gains import Gains
from uwserver.scenario.files.convert import Report, convert, fields
from uwserver.scenario.files.errors import KeyPath, suggestion
from uwserver.scenario.vehicle.assembly import Draft
from uwserver.scenario.world.checks import check_rate
from uwserver.scenario.world.tables import WorldTable


def check_autopilot(
    config: AutopilotConfig, draft: Draft, path: KeyPath, world: WorldTable | None, report: Report
) -> None:
    """Rates, names and values of gains, and whether there is something to steer with.

    Args:
        config: the table in the scenario.
        draft: the merged vehicle.
        path: of the table.
        world: of the scenario; None where it has faults.
        report: takes in faults.
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
    for table, present in (("sensors", draft.sensors), ("actuators", draft.actuators)):
        if "autopilot" in present:
            report(path, f'"autopilot" in {table} would have the path of the built-in one: rename it')
    if not is_steerable(draft.actuators):
        text = "the vehicle has nothing that the autopilot could steer with: it takes thrusters, a force_torque, or fins and a propeller"
        report(path, text)


def is_steerable(actuators: Mapping[str, ActuatorConfig]) -> bool:
    """Whether the autopilot can control a vehicle with these: thrusters or a wrench, or fins and a propeller."""
    kinds = {type(config) for config in actuators.values() if config.enabled}
    hovers = {ThrusterConfig, ThrustersConfig, ForceTorqueConfig} & kinds
    return bool(hovers or ({FinConfig, FinsConfig} & kinds and PropellerConfig in kinds))
