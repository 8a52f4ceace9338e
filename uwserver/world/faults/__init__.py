"""Faults of thrusters, sensors and hulls: declared in `table`, checked in `targets`, carried out by `timeline`."""

from __future__ import annotations

from uwserver.world.faults.hull import Hull
from uwserver.world.faults.table import FaultConfig
from uwserver.world.faults.targets import Targets, refusals
from uwserver.world.faults.timeline import Entry, Faults

__all__ = ["Entry", "FaultConfig", "Faults", "Hull", "Targets", "refusals"]
