"""The commands `check`, `schema` and `list`, which are about scenario files and what they are made of."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from typing import Any

import click
from msgspec import Struct

from uwserver.actuators import ActuatorConfig
from uwserver.adapter import AdapterTable, installed_adapters
from uwserver.cli.colour import coloured_problems, styled
from uwserver.cli.own_hull import facing_their_hull
from uwserver.cli.pace import hasty, late
from uwserver.cli.vehicle_parts import parts_of
from uwserver.modifiers import ModifierConfig
from uwserver.scenario.authoring.catalogue import (
    FileKind,
    SensorKind,
    first_sentence,
    json_schema,
    keys_of,
    modifier_kinds,
    sensor_kinds,
)
from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.files.errors import Problem, ScenarioError, Severity, suggestion
from uwserver.scenario.load.export import explain as explain_resolved
from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
from uwserver.scenario.load.scenario import load
from uwserver.sensors import ModemTable, SensorConfig

_MOST_NAMED = 4
"""Sensors that are named in a warning; further ones are counted."""
_MOST_CORES = 0.8
"""Part of a core above which one thread cannot make all pictures in real time."""


@click.command(short_help="Check scenario files, or shipped scenarios by name.")
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option("--explain", is_flag=True, help="Print the loaded scenario as TOML, with every default.")
def check(files: tuple[str, ...], explain: bool) -> None:
    """Check scenario files, or shipped scenarios by name. The exit status is 1 if any of them has a fault."""
    adapters = installed_adapters()
    are_fine = [_check(file, adapters, explain) for file in files]
    sys.exit(0 if all(are_fine) else 1)


def _check(file: str, adapters: Mapping[str, type[Any]], explain: bool) -> bool:
    """Print what is wrong with a scenario, or a summary; return whether nothing is wrong."""
    try:
        resolved = load(file, adapters=adapters)
        if explain:
            click.echo(explain_resolved(resolved), nl=False)
        for warning in resolved.warnings:
            click.echo(coloured_problems(str(warning)), err=True)
        if resolved.missing:
            click.echo(styled(f"{file}: {resolved.missing}", fg="red"), err=True)
            return False
        problems = unserved(resolved)
        if any(problem.severity == "error" for problem in problems):
            raise ScenarioError(problems)
    except ScenarioError as error:
        click.echo(coloured_problems(str(error)), err=True)
        return False
    for warning in problems:
        click.echo(coloured_problems(str(warning)), err=True)
    # With --explain, standard output is TOML and nothing else.
    click.echo(styled("ok", fg="green") + summary(file, resolved).removeprefix("ok"), err=explain)
    for line in parts(resolved):
        click.echo(f"  {line}", err=explain)
    for line in (*pictures(resolved), *late(resolved), *hasty(resolved), *facing_their_hull(resolved)):
        click.echo(line, err=True)
    return True


def summary(file: str, resolved: Resolved) -> str:
    """Return one line with the vehicles, their ports and rates, and the adapters."""
    scenario = resolved.scenario
    vehicles = ", ".join(f"{name} ({v.entry.model})" for name, v in alike(resolved).items()) or "none"
    ports = [
        f"{vehicle}/{name}{rate}"
        for vehicle, v in alike(resolved).items()
        for name, rate in [
            *((sensor.port_of("", name)[1:], f" {sensor.rate_hz:g} Hz") for name, sensor in v.vehicle.sensors.items()),
            *((f"{name}/send", "") for name, sensor in v.vehicle.sensors.items() if isinstance(sensor, ModemTable)),
            *((f"{name}/{key}", "") for name, sensor in v.vehicle.sensors.items() for key in sensor.streams),
            *((name, "") for name in v.vehicle.actuators),
            *((name, "") for name in v.external_ports),
        ]
    ]
    adapters = [
        f"{name} ({config.__struct_config__.tag}{f', port {port}' if (port := getattr(config, 'port', None)) is not None else ''})"
        for name, config in scenario.adapters.items()
    ]
    return (
        f"ok: {file}: physics {scenario.world.rate_hz:g} Hz; vehicles: {vehicles}; ports: {', '.join(ports) or 'none'}; "
        f"adapters: {', '.join(adapters) or 'none'}"
        f"{'; ran ' + ', '.join(scenario.extensions) if scenario.extensions else ''}"
    )


def unserved(resolved: Resolved) -> list[Problem]:
    """Return what adapters name in the world that is missing or does not fit, so that a run would refuse it.

    The world is built only if an adapter has such checks.
    """
    overridden = {
        name: config
        for name, config in resolved.scenario.adapters.items()
        if isinstance(config, AdapterTable) and type(config).faults is not AdapterTable.faults
    }
    if not overridden:
        return []
    # Imported here because it takes a moment, and most scenarios need no such check.
    from uwserver.scenario.build.world import build

    assert resolved.path is not None
    world, document = build(resolved), read(resolved.path)
    problems = []
    for name, config in overridden.items():
        ports = {path: port for path, port in world.ports.items() if config.truth or not port.is_truth}
        for keys, fault in config.faults(ports, world.services):
            # A run tries again and again to start an adapter that is not required.
            severity: Severity = "error" if config.required else "warning"
            text = fault + _off(fault, resolved)
            problems.append(document.problem(("adapters", name, *keys), text, severity=severity))
    return problems


def _off(fault: str, resolved: Resolved) -> str:
    """Return what to do about a fault that names a sensor which exists but is not enabled; "" for other faults."""
    paths = (f'"{vehicle.name}/{sensor}"' for vehicle in resolved.vehicles.values() for sensor in vehicle.off)
    return "; it is off: set enabled = true in its table" if any(path in fault for path in paths) else ""


def parts(resolved: Resolved) -> Iterator[str]:
    """Yield a line for each part of an adapter that serves more than one thing: ``devices.device.dvl: ...``."""
    for name, config in resolved.scenario.adapters.items():
        for key, text in config.parts().items():
            yield f"{name}.{key}: {text}"


def pictures(resolved: Resolved) -> Iterator[str]:
    """Yield a line about the cost in real time of the sensors that make pictures, if there are any."""
    each = [
        (getattr(sensor, "cores", 0.0), f"{vehicle}/{name}")
        for vehicle, v in resolved.vehicles.items()
        for name, sensor in v.vehicle.sensors.items()
        if sensor.enabled
    ]
    each = sorted([one for one in each if one[0] > 0.0], reverse=True)
    if not each:
        return
    total = sum(part for part, _ in each)
    named = ", ".join(f"{path} {100.0 * part:.0f} %" for part, path in each[:_MOST_NAMED])
    more = f" and {len(each) - _MOST_NAMED} more" if len(each) > _MOST_NAMED else ""
    advice = "; one thread makes all pictures, so most will be dropped. Lower rate_hz, beams, bins or rays_vertical, or a clock in mode freerun"
    yield (
        f"pictures: in real time about {100.0 * total:.0f} % of a core while all of them are read ({named}{more})"
        f"{advice if total > _MOST_CORES else ''}"
    )


def alike(resolved: Resolved) -> dict[str, ResolvedVehicle]:
    """Return the first of each run of vehicles that share a file, by their common name: ``rov``, or ``rov_1..rov_40``."""
    groups = [list(group) for _, group in groupby(resolved.vehicles.values(), key=lambda v: id(v.vehicle))]
    return {g[0].name if len(g) == 1 else f"{g[0].name}..{g[-1].name}": g[0] for g in groups}


@click.command(short_help="Print the JSON Schema of scenario, vehicle or device files.")
@click.option("--vehicle", "kind", flag_value="vehicle", help="Print the schema of vehicle files.")
@click.option("--device", "kind", flag_value="device", help="Print the schema of device files: thrusters and sensors.")
@click.option(
    "--scenario", "kind", flag_value="scenario", default=True, help="Print the schema of scenario files (the default)."
)
def schema(kind: FileKind) -> None:
    """Print the JSON Schema of scenario, vehicle or device files."""
    click.echo(json_schema(kind), nl=False)


def _files(folder: str, key: str) -> dict[str, str]:
    return {name: str(read(path).raw.get(key, "")) for name, path in shipped(folder).items()}


def _kinds(kinds: Mapping[str, type]) -> dict[str, str]:
    return {kind: first_sentence(table) for kind, table in kinds.items()}


_LISTS: Mapping[str, Callable[[], dict[str, str]]] = {
    "scenarios": lambda: _files("", "title"),
    "vehicles": lambda: _files("vehicles", "description"),
    "devices": lambda: _files("devices", "kind"),
    "sensors": lambda: _kinds(kinds_of(SensorConfig)),
    "actuators": lambda: _kinds(kinds_of(ActuatorConfig)),
    "modifiers": lambda: _kinds(kinds_of(ModifierConfig)),
    "adapters": lambda: _kinds(installed_adapters()),
}
"""A text for each thing in a section, by its name."""


@click.command("list", short_help="List scenarios, vehicles, devices, and kinds of component.")
@click.argument("what", type=click.Choice(list(_LISTS)), required=False)
@click.argument("kind", required=False)
def list_(what: str | None, kind: str | None) -> None:
    """List what is installed: scenarios, vehicles, devices, and the kinds of sensor, actuator, modifier and adapter.

    `uwserver list sensors` also shows what each kind measures, its keys and its device files; `uwserver list sensors dvl` shows one kind.

    `uwserver list modifiers` also shows the keys of each kind.

    `uwserver list vehicles bluerov2` shows the thrusters, fins, propellers, sensors and actuators of this vehicle.
    """
    for section in [what] if what else list(_LISTS):
        if not what:
            click.echo(f"{section}:")
        lines = _LISTS[section]()
        if kind is not None and kind not in lines:
            raise click.BadParameter(
                f'there is no "{kind}"{suggestion(kind, list(lines), "; there are: ")}', param_hint="KIND"
            )
        details = _DETAILS[section]() if what in _DETAILS else {}
        if section == "vehicles" and kind is not None:
            details = {kind: list(parts_of(kind))}
        for name, line in lines.items():
            if kind in (None, name):
                click.echo(f"{'' if what else '  '}{name:<22} {line}".rstrip())
                for detail in details.get(name, ()):
                    click.echo(f"    {detail}")


def _sensor_lines(kind: SensorKind) -> Iterator[str]:
    for output in kind.outputs:
        yield output.doc
        for field in output.fields:
            yield f"  {field.name:<20} {field.form:<7} {field.unit:<8} {field.frame or '-':<3} {field.doc}"
    yield _keys(kind.table)
    settings = [setting.name for setting in kind.outputs[0].settings]
    yield f"set while it runs: {', '.join(['rate_hz', *settings])}"
    if kind.devices:
        yield "profiles: " + ", ".join(f"{device.name} ({device.title})" for device in kind.devices)


def _keys(table: type[Struct]) -> str:
    keys = [f"{name} ({default})" for name, default in keys_of(table).items()]
    return f"keys: {', '.join(keys) or 'none of its own'}"


_DETAILS: Mapping[str, Callable[[], Mapping[str, list[str]]]] = {
    "sensors": lambda: {name: list(_sensor_lines(kind)) for name, kind in sensor_kinds().items()},
    "modifiers": lambda: {name: [_keys(table)] for name, table in modifier_kinds().items()},
}
"""Further lines about each thing in a section, by its name."""
