"""Merges one vehicle of a scenario from its parts: the vehicle file, `override`, and the sensors that the scenario adds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uwserver.scenario.files.documents import Document
from uwserver.scenario.files.errors import KeyPath, Problem, Severity
from uwserver.scenario.files.merge import merged
from uwserver.scenario.vehicle.external import DYNAMIC_TABLES


@dataclass(frozen=True)
class MergedFile:
    """The merged tables of one vehicle, with the two files that its keys come from.

    Attributes:
        scenario, file: the scenario file and the vehicle file.
        name: of the vehicle in the scenario.
        raw: the merged tables.
    """

    scenario: Document
    file: Document
    name: str
    raw: dict[str, Any]

    def problem(self, path: KeyPath, text: str, at: KeyPath | None = None, severity: Severity = "error") -> Problem:
        """Return a problem, placed in the scenario file if the key (or the nearest table around it) is there, else in the vehicle file."""
        place = path if at is None else at
        while place:
            prefix = self._in_scenario(place)
            if prefix is not None:
                return self.scenario.problem(prefix + path, text, prefix + place, severity)
            if place in self.file.locations:
                break
            place = place[:-1]
        return self.file.problem(path, text, place, severity)

    def folder_of(self, path: KeyPath) -> Path:
        """Return the folder where a relative file name at this key starts: that of the file which has the key."""
        return (self.file if self._in_scenario(path) is None else self.scenario).folder

    def _in_scenario(self, path: KeyPath) -> KeyPath | None:
        prefix: KeyPath = ("vehicles", self.name)
        if path[0] == "sensors" and len(path) > 1 and prefix + path in self.scenario.locations:
            return prefix
        prefix = (*prefix, "override")
        return prefix if prefix + path in self.scenario.locations else None


def merged_file(scenario: Document, name: str, entry: Mapping[str, Any], file: Document) -> MergedFile:
    """Merge `override` into the vehicle file key by key, then add the scenario's sensors, which replace sensors of the same name as a whole.

    Of an external vehicle, which has no dynamics, only its looks and its solid shapes are left.
    """
    override = entry.get("override")
    raw = merged(file.raw, override) if isinstance(override, dict) else dict(file.raw)
    added = entry.get("sensors")
    if isinstance(added, dict):
        present = raw.get("sensors")
        raw["sensors"] = {**(present if isinstance(present, dict) else {}), **added}
    if entry.get("kind") == "external":
        raw = {key: table for key, table in raw.items() if key not in DYNAMIC_TABLES}
        if isinstance(added, dict):
            raw["sensors"] = dict(added)
    return MergedFile(scenario, file, name, raw)
