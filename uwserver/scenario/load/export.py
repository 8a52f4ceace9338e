"""Writes a scenario as TOML: as it was given, or with everything that it resolved to."""

from __future__ import annotations

import hashlib
import re
from typing import Any

import msgspec
import tomli_w

from uwserver.physics.collision.engine import chosen_engine
from uwserver.scenario.files.convert import fields
from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.archive import pack
from uwserver.scenario.vehicle.entry import Following
from uwserver.scenario.vehicle.tracks import pack as pack_tracks

_NUMBERS = re.compile(r"\[\n(?:\s+[-+.\w]+,\n)+\s*\]")


def to_toml(scenario: Scenario) -> str:
    """Return the text of a scenario file. Loading it gives an equal Scenario; keys at their defaults are left out."""
    whole = tables(scenario)
    whole.setdefault("adapters", {})  # a file without this table would get the default adapter
    return _toml(whole)


def explain(resolved: Resolved) -> str:
    """Return the whole scenario as TOML, with every default written out, and each vehicle as it will be built.

    `vehicles.<name>.file` is the vehicle file with overrides and the scenario's sensors merged in, `vehicles.<name>.devices` holds the
    device files of its thrusters. Warnings come first, as comments. The text is for readers; it cannot be loaded.
    """
    whole = tables(resolved.scenario, defaults=True)
    whole["environment"]["density_kgpm3"] = resolved.scenario.environment.density
    whole["vehicles"] = {name: _vehicle(vehicle) for name, vehicle in resolved.vehicles.items()}
    comments = [f"# {problem}\n" for problem in resolved.warnings]
    return "".join(comments) + _toml(whole)


def engine_named(scenario: Scenario) -> Scenario:
    """Return the scenario with the engine that "auto" stands for here, so that a run on another machine uses the same."""
    world = msgspec.structs.replace(scenario.world, engine=chosen_engine(scenario.world.engine))
    return msgspec.structs.replace(scenario, world=world)


def tables(table: msgspec.Struct, *, defaults: bool = False) -> dict[str, Any]:
    """Return a Struct as plain tables, its `kind` first, without keys that have no value, and without defaults unless `defaults`."""
    config = table.__struct_config__
    raw: dict[str, Any] = {str(config.tag_field): config.tag} if config.tag_field else {}
    for info in fields(type(table)):
        value = getattr(table, info.name)
        default = info.default if info.default_factory is msgspec.NODEFAULT else info.default_factory()
        if value is None or value is msgspec.UNSET or (not defaults and not info.required and value == default):
            continue
        raw[info.encode_name] = _plain(value, defaults)
    return raw


def identity(resolved: Resolved) -> str:
    """Return a SHA-256 of everything that a world state depends on. Adapters, the server and the clock do not count."""
    scenario = resolved.scenario
    world = tables(scenario.world, defaults=True)
    del world["clock"], world["engine"], world["threads"]
    parts = ("environment", "seabed", "structures", "objects")
    whole = {
        "world": world,
        **({} if scenario.start == "free" else {"start": scenario.start}),
        **{part: _plain(getattr(scenario, part), defaults=True) for part in parts},
        "vehicles": {name: _vehicle(vehicle) for name, vehicle in resolved.vehicles.items()},
        "extensions": scenario.extensions,
        "materials": resolved.materials,
    }
    solids = {f"static/{name}": solid for name, solid in resolved.static.items()}
    solids |= {f"vehicles/{name}": v.solid for name, v in resolved.vehicles.items() if v.solid is not None}
    # Looks change pictures only, not the state.
    for entry in [*whole["structures"].values(), *whole["objects"].values()]:
        entry.pop("looks", None)
    for entry in whole["vehicles"].values():
        entry["file"].pop("looks", None)
    tracks = pack_tracks(resolved.tracks)
    text = msgspec.json.encode(whole, enc_hook=str) + pack(solids).encode() + tracks.encode()
    return hashlib.sha256(text).hexdigest()


def _toml(raw: dict[str, Any]) -> str:
    """Return TOML with each vector on one line. Strings are safe: their line breaks are written escaped."""
    return _NUMBERS.sub(
        lambda match: " ".join(match[0].split()).replace("[ ", "[").replace(", ]", "]"), tomli_w.dumps(raw)
    )


def _plain(value: Any, defaults: bool) -> Any:
    if isinstance(value, msgspec.Struct):
        return tables(value, defaults=defaults)
    if isinstance(value, dict):
        return {key: _plain(item, defaults) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, defaults) for item in value]
    return value


def _vehicle(resolved: ResolvedVehicle) -> dict[str, Any]:
    entry = tables(resolved.entry, defaults=True)
    del entry["override"], entry["sensors"]
    if not resolved.entry.is_external:
        entry = {key: value for key, value in entry.items() if key not in Following.__struct_fields__}
    used = {resolved.vehicle.thrusters[name].device: device for name, device in resolved.devices.items()}
    devices = {reference: tables(device, defaults=True) for reference, device in used.items()}
    return {**entry, "file": tables(resolved.vehicle, defaults=True), "devices": devices}
