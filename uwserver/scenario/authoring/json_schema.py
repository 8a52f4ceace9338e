"""JSON Schemas of scenario, vehicle and device files, for editors that complete and check TOML."""

from __future__ import annotations

import json
from typing import Any, Literal

import msgspec

from uwserver.scenario.files.convert import kinds_of
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.appendage_tables import Sourced
from uwserver.scenario.vehicle.profiles import SensorDevice
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.sensors import SensorConfig

FileKind = Literal["scenario", "vehicle", "device"]
FILES: dict[FileKind, type[msgspec.Struct]] = {"scenario": Scenario, "vehicle": VehicleFile, "device": ThrusterDevice}


def json_schema(kind: FileKind) -> str:
    """Return the schema as JSON text. It allows any keys in adapters, as these depend on what is installed."""
    schema = _devices() if kind == "device" else msgspec.json.schema(FILES[kind])
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def _devices() -> dict[str, Any]:
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
