"""A scenario as TOML again: as it was given, or with everything that it resolved to."""

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
from uwserver.scenario.vehicle.external import Following
from uwserver.scenario.vehicle.tracks import pack as pack_tracks

_NUMBERS = re.compile(r"\[\n(?:\s+[-+.\w]+,\n)+\s*\]")


def to_toml(scenario: Scenario) -> str:
    """The scenario file. Loading it gives an equal Scenario; keys at their defaults are left out."""
    whole = tables(scenario)
    whole.setdefault("adapters", {})  # a file without this table would get the default one
    return _toml(whole)


def explain(resolved: Resolved) -> str:
    """The whole scenario as TOML, with every default written out, and each vehicle as it will be built.

    `vehicles.<name>.file` is the vehicle file with overrides and the scenario's sensors merged in, `vehicles.<name>.devices` holds the
    device files of its thrusters. To be read, not to be loaded. Warnings come first, as comments.
    """
    whole = tables(resolved.scenario, defaults=True)
    whole["environment"]["density_kgpm3"] = resolved.scenario.environment.density
    whole["vehicles"] = {name: _vehicle(vehicle) for name, vehicle in resolved.vehicles.items()}
    comments = [f"# {problem}\n" for problem in resolved.warnings]
    return "".join(comments) + _toml(whole)


def engine_named(scenario: Scenario) -> Scenario:
    """The scenario with the engine that "auto" stands for here, so that a run elsewhere does not choose another."""
    world = msgspec.structs.replace(scenario.world, engine=chosen_engine(scenario.world.engine))
    return msgspec.structs.replace(scenario, world=world)


def tables(table: msgspec.Struct, *, defaults: bool = False) -> dict[str, Any]:
    """A Struct as plain tables, its `kind` first; keys without a value are left out, those at their defaults only if told."""
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
    """SHA-256 of all that a state of a world of this scenario depends on: not of its adapters, its server, nor of how its time passes."""
    scenario = resolved.scenario
    world = tables(scenario.world, defaults=True)
    del world["clock"], world["engine"], world["threads"]
    parts = ("environment", "seabed", "structures", "objects")
    whole = {
        "world": world,
        **{part: _plain(getattr(scenario, part), defaults=True) for part in parts},
        "vehicles": {name: _vehicle(vehicle) for name, vehicle in resolved.vehicles.items()},
        "extensions": scenario.extensions,
        "materials": resolved.materials,
    }
    solids = {f"static/{name}": solid for name, solid in resolved.static.items()}
    solids |= {f"vehicles/{name}": v.solid for name, v in resolved.vehicles.items() if v.solid is not None}
    _drop_looks(whole)
    tracks = pack_tracks(resolved.tracks)
    text = msgspec.json.encode(whole, enc_hook=str) + pack(solids).encode() + tracks.encode()
    return hashlib.sha256(text).hexdigest()


def _drop_looks(whole: dict[str, Any]) -> None:
    """Nothing but pictures follows from what a thing looks like."""
    for table in ("structures", "objects"):
        for entry in whole[table].values():
            entry.pop("looks", None)
    for entry in whole["vehicles"].values():
        entry["file"].pop("looks", None)


def _toml(raw: dict[str, Any]) -> str:
    """TOML with each vector on one line (no string holds a line break: they are written escaped)."""
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
