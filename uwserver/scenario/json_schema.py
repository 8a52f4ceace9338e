"""JSON Schema of the three kinds of file, for editors that complete and check TOML while it is typed."""

from __future__ import annotations

import json
from typing import Literal

import msgspec

from uwserver.scenario.schema import Scenario
from uwserver.scenario.vehicle_schema import ThrusterDevice, Vehicle

FileKind = Literal["scenario", "vehicle", "device"]
FILES: dict[FileKind, type[msgspec.Struct]] = {"scenario": Scenario, "vehicle": Vehicle, "device": ThrusterDevice}


def json_schema(kind: FileKind) -> str:
    """The schema as JSON text. Adapters are open in it: their keys depend on what is installed."""
    return json.dumps(msgspec.json.schema(FILES[kind]), indent=2, ensure_ascii=False) + "\n"
