"""A scenario by name, by file or as an object: read, merged, typed and checked, with every fault told at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from uwserver.scenario.files.convert import NO_MORE, More, check_name, convert, convert_kind, convert_struct, silent
from uwserver.scenario.files.documents import Document, find, from_tables, read
from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError, suggestion
from uwserver.scenario.files.merge import named
from uwserver.scenario.load.checks import check_scenario
from uwserver.scenario.load.export import tables
from uwserver.scenario.load.extensions import extension_kinds
from uwserver.scenario.load.fault_checks import check_faults
from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
from uwserver.scenario.load.solids import SolidFiles
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.assembly import Draft, MergedFile, drafted, merged_file
from uwserver.scenario.vehicle.autopilot_checks import check_autopilot
from uwserver.scenario.vehicle.checks import check_vehicle
from uwserver.scenario.vehicle.copies import check_names, entries, raw_places
from uwserver.scenario.vehicle.device_checks import check_device
from uwserver.scenario.vehicle.profiles import check_profile, expanded
from uwserver.scenario.vehicle.tables import ThrusterDevice, Vehicle
from uwserver.scenario.water.tables import Environment
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors import carriers


def load(source: str | Path | Scenario, *, adapters: Mapping[str, type]) -> Resolved:
    """A scenario that is ready to build.

    Args:
        source: name of a shipped scenario, path of a .toml file, or a Scenario.
        adapters: configuration type (a Struct tagged by `kind`) of each installed adapter, by kind.

    Raises:
        ScenarioError: all faults of the scenario and of the files it names, and the warnings.
    """
    return _Load(_open(source), adapters).result()


def scenario_from(
    raw: dict[str, Any], adapters: Mapping[str, type], report: Callable[..., None], more: More = NO_MORE
) -> Scenario | None:
    """The typed scenario, its adapters too; None after at least one report."""
    scenario = convert_struct(raw, Scenario, (), report, more=more)
    typed = {
        name: convert_kind(table, adapters, ("adapters", name), report)
        for name, table in named(raw, "adapters").items()
    }
    valid = [check_name(("adapters", name), report) for name in typed]
    if scenario is None or not all(valid) or None in typed.values():
        return None
    checked: Scenario = msgspec.structs.replace(scenario, adapters=typed)
    return checked


def _open(source: str | Path | Scenario) -> Document:
    if isinstance(source, Scenario):
        return from_tables(tables(source), source.title or "scenario")
    problems: list[Problem] = []

    def fail(text: str) -> None:
        problems.append(Problem(str(source), 0, 0, "", text))

    reference = source if isinstance(source, str) else os.fspath(source.absolute())
    path = find(reference, "", Path.cwd(), fail)
    if path is None:
        raise ScenarioError(problems)
    return read(path)


class _Load:
    """One run through all files. Collects problems; `result` raises them or gives what was read."""

    def __init__(self, document: Document, adapters: Mapping[str, type]) -> None:
        self._problems: list[Problem] = []
        self._files: dict[Path, Document | None] = {}
        self._devices: dict[Path, ThrusterDevice | None] = {}
        self._profiles: dict[Path, Mapping[str, Any] | None] = {}
        beside = document.path.parent if document.path else Path.cwd()
        given, report = document.raw.get("extensions"), self._report(document)
        self._more = extension_kinds(given, beside, report, self._problems.append)
        self._document = document = self._with_profiles(document)
        self._scenario = scenario_from(document.raw, adapters, self._report(document), self._more)
        self._world = _quietly(document.raw, "world", WorldTable)
        self._environment = _quietly(document.raw, "environment", Environment)
        self._vehicles: dict[str, tuple[Vehicle | None, Mapping[str, ThrusterDevice]]] = {}
        self._solids = SolidFiles(
            document, self._world, self._environment, self._report(document), self._warn(document)
        )

    def result(self) -> Resolved:
        """The resolved scenario; ScenarioError if there was any fault."""
        for name, entry in named(self._document.raw, "vehicles").items():
            if isinstance(entry, dict):
                self._vehicle(name, entry)
        self._solids.check_places()
        self._solids.check_engines(tuple(raw_places(self._document.raw, "vehicles")))
        check_names(self._document.raw, self._report(self._document))
        check_scenario(
            self._document.raw, self._scenario, self._world, self._report(self._document), self._warn(self._document)
        )
        files = {name: _without_disabled(file) for name, (file, _) in self._vehicles.items() if file is not None}
        if len(files) == len(named(self._document.raw, "vehicles")) and self._environment is not None:
            check_faults(self._document.raw, files, self._environment, self._report(self._document))
        problems = _in_order(self._problems)
        scenario = self._scenario
        if scenario is None or any(problem.severity == "error" for problem in problems):
            raise ScenarioError(problems)
        vehicles = {
            name: ResolvedVehicle(name, entry, files[key], devices, self._solids.vehicles.get(key))
            for key, (_, devices) in self._vehicles.items()
            for name, entry in entries(key, scenario.vehicles[key]).items()
        }
        scenario = msgspec.structs.replace(scenario, vehicles={name: each.entry for name, each in vehicles.items()})
        path = self._document.path
        solids = self._solids
        return Resolved(
            path.stem if path else self._document.label, scenario, vehicles, path, problems, solids.static, solids.objects,
            solids.materials.names,
        )  # fmt: skip

    def _vehicle(self, name: str, entry: Mapping[str, Any]) -> None:
        document, path = self._document, ("vehicles", name, "model")
        model = entry.get("model")
        if not isinstance(model, str) or not model:
            return
        beside = document.path.parent if document.path else Path.cwd()
        file = self._read(find(model, "vehicles", beside, lambda text: self._report(document)(path, text)))
        if file is None:
            return
        merged = merged_file(document, name, entry, self._with_profiles(file))
        vehicle = convert_struct(merged.raw, Vehicle, (), self._report(merged), more=self._more)
        devices = self._thruster_devices(merged)
        draft: Draft = drafted(merged.raw, devices, self._more)
        self._check_carriers(draft, merged)
        check_vehicle(draft, self._world, self._environment, self._report(merged), self._warn(merged))
        if "autopilot" in entry:
            place: KeyPath = ("vehicles", name, "autopilot")
            check_autopilot(entry["autopilot"], draft, place, self._world, self._report(document))
        self._solids.read_vehicle(name, merged, self._report(merged), self._warn(merged))
        self._vehicles[name] = vehicle, devices

    def _check_carriers(self, draft: Draft, merged: MergedFile) -> None:
        """Beacons sit on vehicles that there are."""
        vehicles = tuple(named(self._document.raw, "vehicles"))
        for name, sensor in draft.sensors.items():
            for beacon, vehicle in carriers(sensor):
                if vehicle not in vehicles:
                    path: KeyPath = ("sensors", name, "beacons", beacon, "vehicle")
                    self._report(merged)(
                        path, f'no vehicle "{vehicle}"{suggestion(vehicle, vehicles, "; there are: ")}'
                    )

    def _thruster_devices(self, merged: MergedFile) -> dict[str, ThrusterDevice]:
        devices: dict[str, ThrusterDevice] = {}
        for name, thruster in named(merged.raw, "thrusters").items():
            reference = thruster.get("device") if isinstance(thruster, dict) else None
            if not isinstance(reference, str) or not reference:
                continue
            path: KeyPath = ("thrusters", name, "device")

            def fail(text: str, path: KeyPath = path) -> None:
                self._report(merged)(path, text)

            device = self._device(find(reference, "devices", merged.folder_of(path), fail))
            if device is not None:
                devices[name] = device
        return devices

    def _device(self, path: Path | None) -> ThrusterDevice | None:
        if path is None:
            return None
        if path not in self._devices:
            document = self._read(path)
            device = None
            if document is not None:
                report = self._report(document)
                device = convert_struct(document.raw, ThrusterDevice, (), report)
                check_device(document.raw, report)
            self._devices[path] = device
        return self._devices[path]

    def _with_profiles(self, document: Document) -> Document:
        """The file with the sensors' device files filled in."""
        report = self._report(document)
        beside = document.path.parent if document.path else Path.cwd()

        def keys_of(reference: str, place: KeyPath) -> Mapping[str, Any] | None:
            path = find(reference, "devices", beside, lambda text: report(place, text))
            if path is not None and path not in self._profiles:
                file = self._read(path)
                self._profiles[path] = None if file is None else check_profile(file.raw, self._report(file), self._more)
            return None if path is None else self._profiles[path]

        return expanded(document, keys_of, report)

    def _read(self, path: Path | None) -> Document | None:
        if path is None:
            return None
        if path not in self._files:
            self._files[path] = None
            try:
                self._files[path] = read(path)
            except ScenarioError as error:
                self._problems.extend(error.problems)
        return self._files[path]

    def _report(self, place: Document | MergedFile) -> Callable[..., None]:
        def report(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
            self._problems.append(place.problem(path, text, at))

        return report

    def _warn(self, place: Document | MergedFile) -> Callable[..., None]:
        def warn(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
            self._problems.append(place.problem(path, text, at, "warning"))

        return warn


def _quietly(raw: Mapping[str, Any], table: str, type_: Any) -> Any:
    return convert(raw.get(table, {}), type_, (), silent)


def _without_disabled(vehicle: Vehicle) -> Vehicle:
    enabled: Vehicle = msgspec.structs.replace(
        vehicle,
        sensors={name: sensor for name, sensor in vehicle.sensors.items() if sensor.enabled},
        actuators={name: actuator for name, actuator in vehicle.actuators.items() if actuator.enabled},
    )
    return enabled


def _in_order(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Without repetitions, errors first, by file (in the order they were met) and place."""
    unique = list(dict.fromkeys(problems))
    files = list(dict.fromkeys(problem.file for problem in unique))
    return tuple(sorted(unique, key=lambda p: (p.severity == "warning", files.index(p.file), p.line, p.column)))
