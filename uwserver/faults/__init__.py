"""Faults of thrusters, sensors and hulls: declared in `table`, checked in `targets`, carried out by `timeline`."""

from __future__ import annotations

from uwserver.faults.hull import Hull
from uwserver.faults.table import FaultConfig
from uwserver.faults.targets import Targets, refusals
from uwserver.faults.timeline import Entry, Faults

__all__ = ["Entry", "FaultConfig", "Faults", "Hull", "Targets", "refusals"]
