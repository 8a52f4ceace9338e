"""Faults of thrusters, sensors and hulls: `table` declares them, `targets` checks them, and `timeline` carries them out."""

from __future__ import annotations

from uwserver.world.faults.table import (
    BuoyancyChange,
    FaultConfig,
    FaultTable,
    MassLoss,
    SensorFrozen,
    SensorSilent,
    ThrusterDead,
    ThrusterStuck,
    ThrusterWeak,
)
from uwserver.world.faults.targets import Hull, Targets, effects, refusals
from uwserver.world.faults.timeline import Entry, Faults

__all__ = [
    "BuoyancyChange", "Entry", "FaultConfig", "FaultTable", "Faults", "Hull", "MassLoss", "SensorFrozen", "SensorSilent", "Targets",
    "ThrusterDead", "ThrusterStuck", "ThrusterWeak", "effects", "refusals",
]  # fmt: skip
