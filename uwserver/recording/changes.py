"""Changes of a recorded run in a replay: keys of its scenario, and calls of services.

A key is written as in the scenario file: ``environment.current.velocity_ned_mps``, ``vehicles.rov.sensors.dvl.rate_hz``. The keys of a vehicle
include those of its vehicle file. Before the first tick any key can change that does not name a file. While the world runs, only what a service can
do can change.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import UNSET

from uwserver.ports import Call, Refused
from uwserver.ports.checks import checked_args, find
from uwserver.scenario.files.convert import Converter, More, fields
from uwserver.scenario.files.errors import KeyPath, dotted, suggestion
from uwserver.scenario.load.checks import check_faults, check_scenario
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.archive import pack, unpack
from uwserver.scenario.solids.shapes import seabed_solid
from uwserver.scenario.solids.tables import FlatSeabed
from uwserver.scenario.vehicle.checks import check_autopilot, check_vehicle
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.scenario.world.sea import water_of
from uwserver.world.world import World

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SOURCE = "replay"
"""Source of the calls that make changes, in recordings."""
_ENTRY = {info.encode_name for info in fields(VehicleEntry)} - {"model", "copies", "override", "sensors"}
_OWN = {info.encode_name for info in fields(VehicleFile)}
_AS_BUILT = ("collision", "contact", "looks")
_PLACE = ("position", "attitude", "velocity", "angular_velocity")
_AT_ANY_TIME = (
    "environment.current, uniform currents, faults.NAME, gains and mode of an autopilot, the arguments of the service `set` of a sensor, "
    "timeout_s of an actuator, and with --call everything that a service can do"
)
_UNITS = {"m": "_m", "m/s": "_mps", "m^2": "_m2", "dB": "_db", "Hz": "_hz", "s": "_s"}


class BadChange(ValueError):
    """A change that is not possible; the text names the key or service, says why, and what is possible."""


@dataclass(frozen=True)
class Setting:
    """A key of the scenario and its new value, as in TOML."""

    path: tuple[str, ...]
    value: Any

    def __str__(self) -> str:
        return dotted(self.path)


@dataclass(frozen=True)
class Changes:
    """All changes of a replay.

    Attributes:
        settings: changed keys of the scenario.
        calls: additional calls of services, whose arguments are not checked yet.
        from_s: simulation time of the changes, s; with 0 the world is built with them.
    """

    settings: tuple[Setting, ...] = ()
    calls: tuple[Call, ...] = ()
    from_s: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.settings or self.calls)


def setting(text: str) -> Setting:
    """Read ``KEY=VALUE`` of a command line. VALUE is written as in TOML; a bare word is a text. Raises BadChange."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise BadChange(f'"{text}" is not KEY=VALUE, like environment.current.velocity_ned_mps=[0.3,0,0]')
    try:
        node: Any = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError:
        raise BadChange(
            f'"{key}" is not a key of a scenario: write it as in TOML, with dots between its levels'
        ) from None
    path: list[str] = []
    while isinstance(node, dict):
        ((name, node),) = node.items()
        path.append(name)
    return Setting(tuple(path), _value(key, value.strip()))


def _value(key: str, text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, KeyError):
        if text and all(c.isalnum() or c in "_-./:" for c in text):
            return text
        raise BadChange(f"{key}: {text!r} is not a TOML value, like 0.5, true, [0.3, 0, 0] or {{kind = ...}}") from None


def asked(text: str) -> Call:
    """Read ``SERVICE`` or ``SERVICE={...}`` of a command line, with arguments in JSON. Raises BadChange."""
    service, _, given = text.partition("=")
    try:
        args = msgspec.json.decode(given or "{}")
    except msgspec.DecodeError as error:
        raise BadChange(f"{service}: its arguments are not valid JSON: {error}") from None
    if not isinstance(args, dict):
        raise BadChange(f'{service}: give its arguments as an object, like {{"name": "a"}}')
    return Call(service, args, SOURCE)


# -- before the first tick ------------------------------------------------------------------------------------------------------------------


def changed_record(record: Mapping[str, str], settings: Iterable[Setting], more: More) -> dict[str, str]:
    """Return the metadata record of a recording with changed keys.

    Args:
        record: a record that `head_of` can read.
        settings: changed keys of the scenario.
        more: kinds of the extensions of the scenario.

    Raises:
        BadChange: a key is unknown, a value is wrong, the recording does not contain what it needs, or the checks of the scenario refuse it.
    """
    before = msgspec.json.decode(record["scenario"])
    whole, changed = deepcopy(before), dict(record)
    touches_seabed = False
    for each in settings:
        _set(whole, each)
        touches_seabed |= each.path[0] == "seabed"
        if each.path == ("seed",):
            changed["seed"] = str(each.value)
    known = set(_problems(before, more))
    new = [text for text in _problems(whole, more) if text not in known]
    if new:
        raise BadChange("\n".join(new))
    for parts in whole["vehicles"].values():
        for table in ("sensors", "actuators"):  # the loader removes disabled devices in the same way
            devices = parts["vehicle"].get(table, {})
            parts["vehicle"][table] = {key: each for key, each in devices.items() if each.get("enabled", True)}
    if touches_seabed:
        changed["solids"] = _with_seabed(whole, changed["solids"])
    changed["scenario"] = msgspec.json.encode(whole).decode()
    return changed


def _set(whole: dict[str, Any], each: Setting) -> None:
    """Set one value."""
    top, rest = each.path[0], each.path[1:]
    known = [info.encode_name for info in fields(Scenario)]
    if top not in known:
        raise BadChange(f'{each}: unknown key "{top}"{suggestion(top, known)}')
    if top in ("adapters", "server", "schema", "extensions") or each.path[:2] == ("world", "clock"):
        raise BadChange(f"{each}: a replay has no adapters and no clock, and uses the kinds of the recording")
    if top == "structures":
        raise BadChange(f"{each}: the recording contains the structures as built: run the scenario with other ones")
    if top == "objects" and (len(rest) != 2 or not rest[1].startswith(_PLACE) or rest[0] not in whole["scenario"][top]):
        raise BadChange(
            f"{each}: the recording contains the objects as built: only their first pose and speed can change"
        )
    if top != "vehicles":
        _put(whole["scenario"], each.path, each)
        return
    vehicles = whole["vehicles"]
    if len(rest) < 2 or rest[0] not in vehicles:
        name = rest[0] if rest else ""
        if name in vehicles:
            raise BadChange(f"{each}: a vehicle cannot be replaced as a whole: name the key that changes")
        raise BadChange(f'{each}: no vehicle "{name}"{suggestion(name, list(vehicles), "; there are: ")}')
    name, key = rest[0], rest[1]
    if key == "override":
        rest, key = (name, *rest[2:]), rest[2] if len(rest) > 2 else ""
    if key in _AS_BUILT:
        raise BadChange(f"{each}: the recording contains the shape of the vehicle as built, not the files it came from")
    if key in _ENTRY:
        _put(whole["scenario"]["vehicles"][name], rest[1:], each)
    elif key in _OWN:
        _check_mount(vehicles[name]["vehicle"], rest, each)
        _put(vehicles[name]["vehicle"], rest[1:], each)
    else:
        names = sorted((_ENTRY | _OWN) - {"schema", *_AS_BUILT})
        raise BadChange(f'{each}: unknown key "{key}"{suggestion(key, names)}')


def _check_mount(vehicle: Mapping[str, Any], path: tuple[str, ...], each: Setting) -> None:
    """Refuse a new place of a sensor on a mount: it would be ignored, because the mount gives the place."""
    if path[1] == "sensors" and len(path) == 4 and path[3] in ("position_frd_m", "rpy_deg"):
        mount = vehicle["sensors"].get(path[2], {}).get("mount")
        if mount:
            key = dotted(("vehicles", path[0], "mounts", mount, path[3]))
            raise BadChange(f'{each}: the sensor sits on the mount "{mount}": change {key}')


def _put(table: dict[str, Any], path: tuple[str, ...], each: Setting) -> None:
    for name in path[:-1]:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise BadChange(f'{each}: "{name}" is a value, not a table')
    table[path[-1]] = each.value


def _problems(whole: Mapping[str, Any], more: More) -> Iterator[str]:
    """Yield the problems that the checks of a scenario file find in the tables of a recording, without those that need other files."""
    found: list[str] = []

    def report_below(*prefix: str) -> Any:
        return lambda path, text, at=None: found.append(f"{dotted((*prefix, *path))}: {text}")

    def nothing(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        """Ignore a warning; the author of the scenario has seen it."""

    report = report_below()
    tree = Converter(report, more).tree(whole["scenario"], Scenario)
    world, environment = tree.at("world").value, tree.at("environment").value
    files: dict[str, VehicleFile] = {}
    for name, parts in whole["vehicles"].items():
        report_vehicle = report_below("vehicles", name)
        below = Converter(report_vehicle, more).tree(parts["vehicle"], VehicleFile)
        msgspec.convert(parts["devices"], dict[str, ThrusterDevice])  # refuses devices with wrong keys
        check_vehicle(below, world, environment, report_vehicle, nothing)
        autopilot = tree.at("vehicles", name, "autopilot").value
        if autopilot is not None and autopilot is not UNSET:
            check_autopilot(autopilot, below, ("vehicles", name, "autopilot"), world, report)
        if below.value is not None:
            files[name] = below.value
    check_scenario(tree, report, nothing)
    if tree.value is not None and len(files) == len(whole["vehicles"]):
        check_faults(tree, files, environment, report)
    return iter(found)


def _with_seabed(whole: dict[str, Any], packed: str) -> str:
    """Return the packed solids with the seabed of the changed tables, which must be flat, because no file can be read."""
    if whole["scenario"]["seabed"].get("kind") != "flat":
        raise BadChange("seabed: a replay can only change to a flat seabed: run the scenario itself with another file")
    table = msgspec.convert(whole["scenario"]["seabed"], FlatSeabed)
    materials = {name: number for number, name in enumerate(whole["materials"])}
    solids = unpack(packed)
    solids["static/seabed"] = seabed_solid(table, Path(), None, materials)
    whole["materials"] = tuple(materials)
    return pack(solids)


# -- while the world runs -------------------------------------------------------------------------------------------------------------------


def calls_for(changes: Changes, scenario: Scenario, world: World) -> list[Call]:
    """Return the calls that make the changes in a running world.

    Args:
        changes: the changes.
        scenario: the scenario with the changed keys.
        world: the running world.

    Raises:
        BadChange: a key cannot change while the world runs, or a service refuses its arguments; the text says what is possible.
    """
    wanted: list[Call] = []
    for each in changes.settings:
        call = _call_for(each, scenario, world)
        if call not in wanted:  # two keys of a table lead to the same call
            wanted.append(call)
    return [_checked(one, world) for one in (*wanted, *changes.calls)]


def _checked(one: Call, world: World) -> Call:
    try:
        find("service", one.service, world.services)
        return Call(one.service, checked_args(world.services[one.service], one.args), SOURCE)
    except Refused as refused:
        raise BadChange(f"{one.service}: {refused.fault.text}") from None


def _call_for(each: Setting, scenario: Scenario, world: World) -> Call:
    path = each.path
    if path[0] == "environment" and _is_current(path, scenario):
        # A drifting current needs a random generator, but only the constant part is used here.
        water = water_of(scenario.environment, float(world.rate_hz), lambda path: np.random.default_rng(0))
        return Call("world/set_current", {"velocity_N": list(water.current)}, SOURCE)
    if path[0] == "faults" and len(path) > 1:
        fault = msgspec.to_builtins(scenario.faults[path[1]])
        kind, target = fault.pop("kind"), fault.pop("target")
        args = {"name": path[1], "kind": kind, "target": target, "parameters": fault}
        return Call("world/set_fault", args, SOURCE)
    found = _of_vehicle(path, each.value, world) if path[0] == "vehicles" and len(path) > 3 else None
    if found is None:
        always = f"These can change at any time: {_AT_ANY_TIME}"
        raise BadChange(f"{each} cannot change while the world runs, only with --from 0. {always}")
    return found


def _of_vehicle(path: tuple[str, ...], value: Any, world: World) -> Call | None:
    name, table, key = path[1], path[2], path[3:]
    if table == "autopilot" and key[0] == "gains" and len(key) == 2:
        return Call(f"{name}/autopilot/set_gain", {"name": key[1], "value": value}, SOURCE)
    if (table, key) == ("autopilot", ("mode",)):
        return Call(f"{name}/autopilot/set_mode", {"mode": value}, SOURCE)
    if table in ("sensors", "actuators") and len(key) == 2:
        port, what = f"{name}/{key[0]}", key[1]
        if what == "enabled":
            return Call(f"{port}/{'activate' if value else 'deactivate'}", {}, SOURCE)
        service = world.services.get(f"{port}/set")
        for argument in () if service is None else service.arguments:
            if what in (argument.name, argument.name + _UNITS.get(argument.unit, "_")):
                return Call(f"{port}/set", {argument.name: value}, SOURCE)
    return None


def _is_current(path: tuple[str, ...], scenario: Scenario) -> bool:
    """Return whether a key belongs to the uniform, constant part of the current."""
    if path[1:2] == ("current",):
        return True
    current = scenario.environment.currents.get(path[2]) if path[1:2] == ("currents",) and len(path) > 2 else None
    return current is not None and current.__struct_config__.tag == "uniform"
