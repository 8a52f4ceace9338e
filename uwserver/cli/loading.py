"""Loads the scenario of a command, and makes changed copies of it. A vehicle is put into a tank."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from uwserver.cli.terminal import coloured_problems
from uwserver.scenario.files.errors import KeyPath, ScenarioError

if TYPE_CHECKING:
    from uwserver.scenario.files.formats import Kind
    from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
    from uwserver.scenario.load.tables import Scenario


def meant(reference: str) -> tuple[Kind | None, Path]:
    """Return the kind of what a reference means, and its path: the name of something shipped, or a file; None if the kind cannot be told."""
    from uwserver.scenario.files.documents import SHIPPED, shipped
    from uwserver.scenario.files.formats import format_of

    for folder, kind in SHIPPED.items():
        path = shipped(folder).get(reference)
        if path is not None:
            return kind, path
    path = Path(reference)
    return format_of(path), path


def require_kind(path: Path, needed: str, *kinds: Kind, status: int = 1) -> None:
    """Raise a ClickException if a file is clearly of another kind than some: it says what the file is, and which command helps.

    Args:
        path: path of the file.
        needed: the file that the command needs, in words: "a recording".
        kinds: that the command takes.
        status: exit status of the process.
    """
    from uwserver.scenario.files.errors import label_of
    from uwserver.scenario.files.formats import format_of, told

    kind = format_of(path)
    if kind is not None and kind not in kinds:
        refusal = click.ClickException(f"{label_of(path)}: {needed} is needed, and {told(label_of(path), kind)}")
        refusal.exit_code = status  # type: ignore[misc]  # click declares it for classes
        raise refusal


def tank(vehicle: str, adapters: Mapping[str, type[Any]]) -> Scenario:
    """Return the scenario that `uwserver new` writes, with a vehicle by name or file; its title names the vehicle."""
    from uwserver.scenario.authoring.starter import starter
    from uwserver.scenario.files.convert import Converter
    from uwserver.scenario.files.documents import parse
    from uwserver.scenario.load.scenario import scenario_tree

    title = f"{Path(vehicle).stem} in a tank"
    document = parse(starter(title, vehicle), title, Path.cwd() / "tank.toml")

    def report(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        raise ScenarioError([document.problem(path, text, at)])

    scenario: Scenario = scenario_tree(document.raw, adapters, Converter(report)).value
    return scenario


def loaded(reference: str) -> tuple[Resolved, Mapping[str, type[Any]]]:
    """Load a shipped scenario or a file, or print its faults and exit with status 1. A vehicle is put into a tank, and a line says so.

    Returns:
        The scenario, and the configuration type of each installed adapter by kind.
    """
    from uwserver.adapter import installed_adapters
    from uwserver.scenario.load.scenario import load

    adapters = installed_adapters()
    try:
        if meant(reference)[0] != "vehicle":
            return load(reference, adapters=adapters), adapters
        click.echo(
            f"{reference} is a vehicle, so it is put into a tank; `uwserver new NAME --vehicle {reference}` writes this scenario",
            err=True,
        )
        return load(tank(reference, adapters), adapters=adapters), adapters
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
