"""Loads the scenario of a command, and makes changed copies of it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING, Any

import click
import msgspec

from uwserver.cli.terminal import coloured_problems

if TYPE_CHECKING:
    from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle


def loaded(reference: str) -> tuple[Resolved, Mapping[str, type[Any]]]:
    """Load a shipped scenario or a file, or print its faults and exit with status 1.

    Returns:
        The scenario, and the configuration type of each installed adapter by kind.
    """
    from uwserver.adapter import installed_adapters
    from uwserver.scenario.files.errors import ScenarioError
    from uwserver.scenario.load.scenario import load

    adapters = installed_adapters()
    try:
        return load(reference, adapters=adapters), adapters
    except ScenarioError as error:
        click.echo(coloured_problems(str(error)), err=True)
        sys.exit(1)


def require_packages(resolved: Resolved) -> None:
    """Raise a ClickException if a package that the scenario needs is not installed."""
    if resolved.missing:
        raise click.ClickException(f"{resolved.name}: {resolved.missing}")


def with_changes(resolved: Resolved, **changes: Any) -> Resolved:
    """Return the scenario with other values of `Scenario`, such as `adapters` or `server`."""
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, **changes))


def with_adapter(resolved: Resolved, name: str, config: Any) -> Resolved:
    """Return the scenario with this configuration for one of its adapters, or for one more."""
    return with_changes(resolved, adapters={**resolved.scenario.adapters, name: config})


def alike(resolved: Resolved) -> dict[str, ResolvedVehicle]:
    """Return the first of each run of vehicles that share a file, by their common name: ``rov``, or ``rov_1..rov_40``."""
    groups = [list(group) for _, group in groupby(resolved.vehicles.values(), key=lambda v: id(v.vehicle))]
    return {g[0].name if len(g) == 1 else f"{g[0].name}..{g[-1].name}": g[0] for g in groups}
