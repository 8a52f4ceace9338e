"""Checks of `uwserver check` for files that are no scenarios: vehicles, devices, missions, mappings of logs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import click

from uwserver.cli.scenarios.listing import body_lines
from uwserver.cli.terminal import coloured_problems, styled
from uwserver.logfiles import LogError
from uwserver.logfiles.mapping import read_mapping
from uwserver.scenario.authoring.plans import BadPlan, Checked, check_mission, check_plan, check_waypoints
from uwserver.scenario.files.convert import Converter
from uwserver.scenario.files.documents import read, read_whole
from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError
from uwserver.scenario.files.formats import FORMATS, Kind
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.devices import check_device, check_profile
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import ThrusterDevice

_MOST_BYTES = 1 << 20


def alone(path: Path) -> Resolved:
    """Return the scenario of one vehicle, by its file, 5 m deep in still water.

    Raises:
        ScenarioError: the file has errors.
    """
    entry = VehicleEntry(model=str(path.absolute()), position_ned_m=(0.0, 0.0, 5.0))
    return load(Scenario(schema=1, vehicles={"vehicle": entry}), adapters={})


def vehicle_summary(file: str, resolved: Resolved) -> str:
    """Return one line with the name of a vehicle, and what it is."""
    (vehicle,) = resolved.vehicles.values()
    return f"ok: {file}: vehicle {vehicle.vehicle.name}: {vehicle.vehicle.description}"


def vehicle_lines(resolved: Resolved) -> Iterator[str]:
    """Yield what a vehicle has."""
    (vehicle,) = resolved.vehicles.values()
    return body_lines(vehicle.vehicle)


def check_other(kind: Kind, path: Path, label: str) -> bool:
    """Print what is wrong with a file of one of the kinds in `CHECKS`, or what it is; return whether nothing is wrong.

    Args:
        kind: kind of the file.
        path: path of the file.
        label: the file as the user types it: a path, or the name of a shipped one.
    """
    try:
        text = CHECKS[kind](path, label)
    except (ScenarioError, LogError) as error:
        click.echo(coloured_problems(str(error)), err=True)
        return False
    except (BadPlan, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        click.echo(coloured_problems(f"{label}: {reason}"), err=True)
        return False
    click.echo(f"{styled('ok', fg='green')}: {label}: {text}")
    return True


def _device(file: Path, label: str) -> str:
    document = read(file)
    problems: list[Problem] = []

    def report(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        problems.append(document.problem(path, text, at))

    kind = document.raw.get("kind")
    if kind == "thruster":
        tree = Converter(report).tree(document.raw, ThrusterDevice)
        check_device(tree, report)
    else:
        check_profile(document.raw, report)
    if problems:
        raise ScenarioError(problems)
    how = "device" if kind == "thruster" else "profile"
    of = "a thruster" if kind == "thruster" else f"a sensor of kind {kind}"
    return f'device file of {of}: {document.raw.get("title") or document.raw.get("name")}; use it by {how} = "{label}"'


def _mission(path: Path, label: str, name: str, check: Callable[[str], Checked]) -> str:
    checked = check(read_whole(path, _MOST_BYTES).decode("utf-8-sig", "replace"))
    if checked.faults:
        raise ScenarioError([Problem(label, 0, 0, "", fault) for fault in checked.faults])
    for warning in checked.warnings:
        click.echo(coloured_problems(str(Problem(label, 0, 0, "", warning, "warning"))), err=True)
    return f"{name}: {checked.summary}"


def _mapping(path: Path, _: str) -> str:
    mapping = read_mapping(path)
    return f"{FORMATS['mapping'].name}: tracks: {', '.join(mapping.tracks) or 'none'}; ports: {', '.join(mapping.ports) or 'none'}"


CHECKS: Mapping[Kind, Callable[[Path, str], str]] = {
    "device": _device,
    "mapping": _mapping,
    "mission": lambda path, label: _mission(path, label, FORMATS["mission"].name, check_mission),
    "plan": lambda path, label: _mission(path, label, FORMATS["plan"].name, check_plan),
    "waypoints": lambda path, label: _mission(path, label, FORMATS["waypoints"].name, check_waypoints),
}
"""By kind: takes path and label, and returns what the file is; ScenarioError, BadPlan, LogError or OSError if something is wrong."""
