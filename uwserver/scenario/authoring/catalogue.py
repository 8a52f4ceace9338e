"""Lists the kinds of sensor and modifier with their fields, units, frames, keys and devices, and makes the JSON Schemas of all files.

`uwserver list` and the reference pages show the kinds. Editors complete and check TOML by the schemas.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple

import msgspec
from msgspec import NODEFAULT, UNSET, Struct

from uwserver.modifiers import ModifierConfig
from uwserver.ports import Argument, Field
from uwserver.scenario.files.convert import Converter, fields, kinds_of
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.scenario import load, scenario_tree
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.appendage_tables import Sourced
from uwserver.scenario.vehicle.devices import SensorDevice
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.sensors import Pose, SensorConfig, SensorTable


class Output(NamedTuple):
    """Output of a kind of sensor: doc and fields of its port, settings of its service ``set``, and an example sensor in `one_of_everything`."""

    example: str
    doc: str
    fields: tuple[Field, ...]
    settings: tuple[Argument, ...]


class Value(NamedTuple):
    """One value of a device file, with its source; `key` is dotted."""

    key: str
    value: Any
    status: str
    source: str


class Device(NamedTuple):
    """A shipped device file of a sensor."""

    name: str
    title: str
    values: tuple[Value, ...]


class SensorKind(NamedTuple):
    """One kind of sensor. It has several outputs if a key of its table decides what it measures."""

    kind: str
    table: type[Struct]
    outputs: tuple[Output, ...]
    devices: tuple[Device, ...]


def sensor_kinds() -> dict[str, SensorKind]:
    """Return all kinds of sensor, in the order of the union. Their outputs come from the scenario `one_of_everything`."""
    found: dict[str, dict[tuple[str, ...], Output]] = {kind: {} for kind in kinds_of(SensorConfig)}
    for name, sensor in _examples():
        built = sensor.build(Pose())
        names = tuple(field.name for field in built.fields)
        output = Output(name, built.doc, built.fields, built.arguments)
        found[str(sensor.__struct_config__.tag)].setdefault(names, output)
    devices, tables = _devices(), kinds_of(SensorConfig)
    return {k: SensorKind(k, table, tuple(found[k].values()), devices.get(k, ())) for k, table in tables.items()}


def modifier_kinds() -> dict[str, type[Struct]]:
    """Return the tables of all modifiers by their kind."""
    return kinds_of(ModifierConfig)


def keys_of(table: type[Struct]) -> dict[str, str]:
    """Return the keys of a sensor's or modifier's table, each with its default in file syntax; without the keys that all sensors have."""
    common = {info.name for info in fields(SensorTable)} if issubclass(table, SensorTable) else set()
    return {info.encode_name: _default(info) for info in fields(table) if info.name not in common}


def first_sentence(component: Any) -> str:
    """Return the first sentence of a component's docstring; that of its module if its own only lists keys."""
    own = inspect.getdoc(component) or ""
    doc = own if own and not own.startswith("Attributes") else inspect.getdoc(inspect.getmodule(component)) or ""
    return " ".join(doc.split("\n\n")[0].split()).partition(". ")[0].removesuffix(".")


def _examples() -> Iterator[tuple[str, Any]]:
    """Yield the sensors of the scenario `one_of_everything` by name. Its adapters are left out, as they may not be installed."""
    document = read(shipped()["one_of_everything"])
    problems: list[str] = []
    raw = {**document.raw, "adapters": {}}
    converter = Converter(lambda path, text, at=None: problems.append(f"{path}: {text}"))
    scenario = scenario_tree(raw, {}, converter).value
    if scenario is None:
        raise ScenarioError([document.problem((), text) for text in problems])
    for vehicle in load(scenario, adapters={}).vehicles.values():
        yield from vehicle.vehicle.sensors.items()


def _devices() -> dict[str, tuple[Device, ...]]:
    found: dict[str, tuple[Device, ...]] = {}
    for name, path in shipped("devices").items():
        raw = read(path).raw
        if "properties" not in raw:
            continue
        values = [value for group in raw["properties"].values() for value in _values(group, "", group)]
        kind = str(raw["kind"])
        found[kind] = (*found.get(kind, ()), Device(name, str(raw["title"]), tuple(values)))
    return found


def _values(table: Mapping[str, Any], prefix: str, group: Mapping[str, Any]) -> Iterator[Value]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _values(value, f"{prefix}{key}.", group)
        elif key not in Sourced.__struct_fields__:
            yield Value(prefix + key, value, str(group["status"]), str(group["source"]))


def _default(info: Any) -> str:
    if info.default is UNSET:
        return "none"
    if info.default is not NODEFAULT:
        return "its own" if isinstance(info.default, Struct) else _plain(info.default)
    return "required" if info.default_factory is NODEFAULT else "none"


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_plain, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


# -- JSON Schemas -----------------------------------------------------------------------------------------------------------------------


FileKind = Literal["scenario", "vehicle", "device"]
FILES: dict[FileKind, type[msgspec.Struct]] = {"scenario": Scenario, "vehicle": VehicleFile, "device": ThrusterDevice}


def json_schema(kind: FileKind) -> str:
    """Return the schema as JSON text. It allows any keys in adapters, as these depend on what is installed."""
    schema = _device_schema() if kind == "device" else msgspec.json.schema(FILES[kind])
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def _device_schema() -> dict[str, Any]:
    """Return the schema of device files: of thrusters, and of each kind of sensor, whose groups of properties have keys and their source."""
    sensors = kinds_of(SensorConfig)
    types = (ThrusterDevice, SensorDevice, Sourced, *sensors.values())
    references, definitions = msgspec.json.schema_components(types, ref_template="#/$defs/{name}")
    names = [reference["$ref"].rsplit("/", 1)[1] for reference in references]
    device, sourced = definitions.pop(names[1]), definitions.pop(names[2])
    files = [references[0]]
    for (kind, struct), name in zip(sensors.items(), names[3:], strict=True):
        keys = {key: value for key, value in definitions.pop(name)["properties"].items() if key != "kind"}
        group = {**sourced, "title": "Properties", "properties": {**sourced["properties"], **keys}}
        groups = {"type": "object", "additionalProperties": group}
        properties = {**device["properties"], "kind": {"const": kind}, "properties": groups}
        own_name = f"{struct.__name__}Device"
        definitions[own_name] = {**device, "title": f"Device of kind {kind}", "properties": properties}
        files.append({"$ref": f"#/$defs/{own_name}"})
    return {"anyOf": files, "$defs": definitions}
