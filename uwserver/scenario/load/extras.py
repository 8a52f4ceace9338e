"""Finds packages that a scenario needs but that are not installed, and the command that installs them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import NamedTuple

from msgspec import UNSET

from uwserver.adapter import AdapterTable
from uwserver.packages import install_command
from uwserver.physics.collision.engine import AUTO, missing_engine
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.tables import GridSeabed

_SOLID = "uwserver[solid]"
_ENGINES = {
    AUTO: ("pybullet or coal", _SOLID),
    "bullet": ("pybullet", "pybullet"),
    "coal": ("coal", "uwserver[coal]"),
}
"""What is missing without an engine for contacts, and the requirement, by the name of the engine in `[world]`."""


class Missing(NamedTuple):
    """Packages that a scenario needs but that are not installed, and the shell command that installs them."""

    packages: tuple[str, ...]
    command: str

    def __str__(self) -> str:
        return f"{self.what}; install all that this scenario needs: {self.command}"

    @property
    def what(self) -> str:
        """The packages in words."""
        return f"not installed: {', '.join(self.packages)}"


def missing_extras(scenario: Scenario, is_solid: bool) -> Missing | None:
    """Return which packages are missing for a scenario; None if none is missing.

    Args:
        scenario: typed.
        is_solid: whether anything in it can touch anything.
    """
    needed = _needed(scenario, is_solid)
    absent = {module: requirement for module, requirement in needed.items() if not _is_there(module)}
    engine = scenario.world.engine
    if "scipy" in needed and missing_engine(engine):
        name, requirement = _ENGINES[engine]
        absent[name] = requirement
    if not absent:
        return None
    names = dict.fromkeys(module.partition(".")[0] for module in absent)
    return Missing(tuple(names), install_command(*absent.values()))


def _needed(scenario: Scenario, is_solid: bool) -> Mapping[str, str]:
    """Return the requirement of each module that the scenario needs."""
    needed: dict[str, str] = {}
    if is_solid or scenario.objects or scenario.structures or scenario.seabed is not UNSET:
        needed |= {"scipy": _SOLID}
    if isinstance(scenario.seabed, GridSeabed) and scenario.seabed.file.endswith((".nc", ".nc4")):
        needed |= dict.fromkeys(("h5netcdf", "h5py"), "uwserver[netcdf]")
    if scenario.server.uvloop:
        needed["uvloop"] = "uwserver[uvloop]"
    for config in scenario.adapters.values():
        if isinstance(config, AdapterTable) and config.required:
            needed |= config.needs()
    return needed


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ImportError:  # the package around it is missing or broken
        return False
