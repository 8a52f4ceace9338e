"""Loads a scenario by name, by file or from an object: reads, merges, converts and checks it, and reports all errors at once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import msgspec
from msgspec import UnsetType

from uwserver.autopilot.config import AutopilotConfig
from uwserver.ports.checks import shown
from uwserver.scenario.files.convert import Converter, Node, NodeCache, Report, check_known, check_name
from uwserver.scenario.files.documents import Document, find, from_tables, named, read
from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError, Severity
from uwserver.scenario.files.formats import Kind, kind_of_tables, told
from uwserver.scenario.load.checks import check_components, check_delays, check_faults, check_scenario, check_tables
from uwserver.scenario.load.export import tables
from uwserver.scenario.load.extensions import extension_kinds
from uwserver.scenario.load.extras import Missing, missing_extras
from uwserver.scenario.load.plausibility import check_plausible, check_reachable
from uwserver.scenario.load.resolved import Resolved, ResolvedVehicle
from uwserver.scenario.load.solids import SolidFiles
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.checks import check_autopilot, check_vehicle
from uwserver.scenario.vehicle.component_checks import check_actuators, traits_of
from uwserver.scenario.vehicle.devices import check_device, check_profile, fill_in_profiles
from uwserver.scenario.vehicle.entry import MergedFile, VehicleEntry, check_external, check_names, entries, merged_file
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.scenario.vehicle.tracks import read_track
from uwserver.scenario.world.tables import Environment, WorldTable
from uwserver.units import rad
from uwserver.world.external.track import PoseTrack

MOST_PROBLEMS = 200
"""Most problems that are reported, warnings included. The search ends there, as each may cost a search for a similar word."""
DEFAULT_ADAPTER = "sockets"
"""Kind of the adapter of a scenario file without a table `adapters`."""


def load(source: str | Path | Scenario, *, adapters: Mapping[str, type]) -> Resolved:
    """Return a scenario that is ready to build.

    Args:
        source: name of a shipped scenario, path of a .toml file, or a Scenario.
        adapters: configuration type (a Struct tagged by `kind`) of each installed adapter, by kind.

    Raises:
        ScenarioError: it or one of its files has errors; the exception has all errors and warnings.
        TypeError: the source is something else.
    """
    return _Load(_open(source), adapters).result()


def scenario_tree(raw: dict[str, Any], adapters: Mapping[str, type], converter: Converter) -> Node:
    """Return the converted scenario, with adapters as their own types; its value is a `Scenario`, or None after at least one report."""
    tree = converter.tree(raw, Scenario)
    tables = named(raw, "adapters")
    typed = {name: converter.kind(table, adapters, ("adapters", name)).value for name, table in tables.items()}
    valid = [check_name(("adapters", name), converter.report) for name in typed]
    if tree.value is None or not all(valid) or None in typed.values():
        return Node(None, tree.parts)
    return Node(msgspec.structs.replace(tree.value, adapters=typed), tree.parts)


def _on_earth(tree: Node) -> Node:
    """Return a scenario with gravity and `earth` filled in from its place on the Earth, so that a recording has them in full."""
    world: WorldTable | None = tree.at("world").value
    environment: Environment | None = tree.at("environment").value
    if world is None or environment is None:
        return tree
    placed = environment.on_earth(None if world.origin is None else rad(world.origin[0]), world.rotating)
    world = msgspec.structs.replace(world, earth="rotating" if world.rotating else "flat")
    scenario = None if tree.value is None else msgspec.structs.replace(tree.value, world=world, environment=placed)
    parts = {"world": Node(world, tree.at("world").parts), "environment": Node(placed, tree.at("environment").parts)}
    return Node(scenario, {**tree.parts, **parts})


def with_default_adapter(document: Document, adapters: Mapping[str, type]) -> Document:
    """Return the file with `[adapters.sockets]` at its defaults, TCP port 7600, if it has no table `adapters`.

    An empty table stays empty: nothing listens then. A scenario from Python stays as it is too, as it mostly runs in its own process.
    """
    if document.path is None or "adapters" in document.raw or DEFAULT_ADAPTER not in adapters:
        return document
    return replace(document, raw={**document.raw, "adapters": {DEFAULT_ADAPTER: {"kind": DEFAULT_ADAPTER}}})


def _open(source: str | Path | Scenario) -> Document:
    if isinstance(source, Scenario):
        return from_tables(tables(source), source.title or "scenario")
    if not isinstance(source, str | Path):
        wanted = 'the name of a shipped scenario ("bluerov2_pool"), the path of a .toml file, or a Scenario (ScenarioBuilder makes one)'
        raise TypeError(f"load takes {wanted}, not {shown(repr(source))}")
    problems: list[str] = []
    reference = source if isinstance(source, str) else os.fspath(source.absolute())
    path = find(reference, "", Path.cwd(), problems.append)
    if path is None:
        raise ScenarioError([Problem(str(source), 0, 0, "", text) for text in problems])
    document = read(path)
    if (other := _other_kind(document, "scenario")) is not None:
        raise ScenarioError([other])
    return document


def _other_kind(document: Document, wanted: Kind) -> Problem | None:
    """Return a problem that says what a file is if it is clearly another kind of file than the wanted one: one line, not one for each key."""
    kind = kind_of_tables(document.raw)
    if kind in (None, wanted) or document.path is None:
        return None
    text = told(document.label, kind)
    return Problem(document.label, 0, 0, "", text if wanted == "scenario" else f"a {wanted} file is needed, and {text}")


class _Load:
    """One run through all files of a scenario. It collects problems; `result` raises them or returns what was read."""

    def __init__(self, document: Document, adapters: Mapping[str, type]) -> None:
        self._problems: list[Problem] = []
        self._document = document
        # Files that several vehicles name are read, and their errors reported, once.
        self._read = cache(self._read_file)
        self._model = cache(self._read_model)
        self._device = cache(self._read_device)
        self._profile = cache(self._read_profile)
        check_tables(document)
        given, report = document.raw.get("extensions"), self._report(document)
        within = None if document.path is None else document.folder
        self._more = extension_kinds(given, document.folder, report, self._problems.append, within)
        self._known: NodeCache = {}
        self._document = document = with_default_adapter(self._with_profiles(document), adapters)
        self._tree = _on_earth(scenario_tree(document.raw, adapters, self._converter(document)))
        self._world: WorldTable | None = self._tree.at("world").value
        self._environment: Environment | None = self._tree.at("environment").value
        self._vehicles: dict[str, tuple[VehicleFile | None, Mapping[str, ThrusterDevice]]] = {}
        self._tracks: dict[str, PoseTrack] = {}
        self._solids = SolidFiles(document, self._tree, self._report(document), self._warn(document))

    def result(self) -> Resolved:
        """Return the resolved scenario; raise ScenarioError if there was any error."""
        report = self._report(self._document)
        for name, entry in named(self._document.raw, "vehicles").items():
            if isinstance(entry, dict):
                self._vehicle(name, entry)
        self._solids.check_places()
        self._solids.check_engines()
        check_names(self._tree, report)
        check_scenario(self._tree, report, self._warn(self._document))
        files = {name: _without_disabled(file) for name, (file, _) in self._vehicles.items() if file is not None}
        if files.keys() == self._tree.at("vehicles").parts.keys() and self._environment is not None:
            check_faults(self._tree, files, self._environment, report)
        scenario: Scenario | None = self._tree.value
        if scenario is not None:
            check_components(scenario, files, report)
            check_delays(scenario, files, report)
        missing = None if scenario is None else missing_extras(scenario, len(self._solids.vehicles) > 1)
        if scenario is None or self._errors():
            if missing:
                self._problems.append(Problem(self._document.label, 0, 0, "", str(missing), "warning"))
            raise ScenarioError(_in_order(self._problems))
        by_table = {
            key: [
                self._vehicle_of(key, name, entry, files[key])
                for name, entry in entries(key, scenario.vehicles[key]).items()
            ]
            for key in self._vehicles
        }
        check_plausible(scenario, by_table, self._solids.objects, self._warn(self._document))
        if self._document.path is not None and "adapters" in self._document.raw:
            check_reachable(scenario, self._warn(self._document))
        return self._resolved(scenario, by_table, missing)

    def _resolved(
        self, scenario: Scenario, by_table: Mapping[str, list[ResolvedVehicle]], missing: Missing | None
    ) -> Resolved:
        vehicles = {vehicle.name: vehicle for group in by_table.values() for vehicle in group}
        scenario = msgspec.structs.replace(scenario, vehicles={name: each.entry for name, each in vehicles.items()})
        path, solids, problems = self._document.path, self._solids, _in_order(self._problems)
        name, materials = path.stem if path else self._document.label, tuple(solids.materials)
        looks = {thing: data for (table, thing), data in solids.looks.items() if table == "structures"}
        return Resolved(
            name, scenario, vehicles, path, problems, solids.static, solids.objects, materials, missing, looks
        )

    def _vehicle_of(self, key: str, name: str, entry: VehicleEntry, file: VehicleFile) -> ResolvedVehicle:
        """Return one of the vehicles of a table that has no errors."""
        solids, looks = self._solids, self._solids.looks.get(("vehicles", key), b"")
        track = self._tracks.get(key)
        whole, devices = self._vehicles[key]
        off = () if whole is None else tuple(sensor for sensor in whole.sensors if sensor not in file.sensors)
        return ResolvedVehicle(
            name, entry, file, devices, solids.vehicles.get(key), looks, solids.ghosts.get(key), track, off
        )

    def _vehicle(self, name: str, entry: Mapping[str, Any]) -> None:
        document, path = self._document, ("vehicles", name, "model")
        model = entry.get("model")
        if not isinstance(model, str) or not model:
            return
        file = self._model(find(model, "vehicles", document.folder, partial(self._report(document), path)))
        if file is None:
            return
        merged = merged_file(document, name, entry, file)
        tree = self._converter(merged).tree(merged.raw, VehicleFile)
        devices = self._thruster_devices(merged)
        before = self._errors()
        self._check_others(tree, merged)
        check_vehicle(tree, self._world, self._environment, self._report(merged), self._warn(merged))
        autopilot: AutopilotConfig | None = self._tree.at("vehicles", name, "autopilot").value
        if autopilot is not None:
            place: KeyPath = ("vehicles", name, "autopilot")
            check_autopilot(autopilot, tree, place, self._world, self._report(document))
        self._solids.read_vehicle(name, merged, tree, self._report(merged), self._warn(merged))
        self._follow(name)
        self._vehicles[name] = tree.value, devices
        whole = tree.value is not None and all(key in devices for key in tree.value.thrusters)
        if whole and self._environment is not None and self._errors() == before:
            check_actuators(_without_disabled(tree.value), devices, self._environment, self._report(merged))

    def _follow(self, name: str) -> None:
        """Check an external vehicle, and read the log that it follows."""
        report = self._report(self._document)
        check_external(name, self._tree, report)
        entry: VehicleEntry | None = self._tree.at("vehicles", name).value
        if entry is None or not entry.is_external:
            return
        if entry.solid and name not in self._solids.vehicles:
            report(
                ("vehicles", name, "solid"),
                f'"{entry.model}" has no collision shapes, so it cannot be solid: choose another model, or set solid = false',
            )
        if not isinstance(entry.log, UnsetType):
            try:
                self._tracks[name], remarks = read_track(entry, self._document.folder)
            except ValueError as error:
                report(("vehicles", name, "log"), str(error))
                return
            for remark in remarks:
                self._warn(self._document)(("vehicles", name, "log"), remark)

    def _errors(self) -> int:
        return sum(problem.severity == "error" for problem in self._problems)

    def _check_others(self, tree: Node, merged: MergedFile) -> None:
        """Check that the vehicles and structures which sensors name exist."""
        there, report = {table: self._tree.names(table) for table in ("vehicles", "structures")}, self._report(merged)
        for name, sensor in tree.values("sensors").items():
            for key, table, wanted in traits_of(sensor).names:
                if table in there:
                    check_known(wanted, there[table], table.removesuffix("s"), ("sensors", name, *key), report)

    def _thruster_devices(self, merged: MergedFile) -> dict[str, ThrusterDevice]:
        devices: dict[str, ThrusterDevice] = {}
        for name, thruster in named(merged.raw, "thrusters").items():
            reference = thruster.get("device") if isinstance(thruster, dict) else None
            if not isinstance(reference, str) or not reference:
                continue
            path: KeyPath = ("thrusters", name, "device")
            fail = partial(self._report(merged), path)
            device = self._device(find(reference, "devices", merged.folder_of(path), fail))
            if device is not None:
                devices[name] = device
        return devices

    def _read_device(self, path: Path | None) -> ThrusterDevice | None:
        document = self._read_kind(path, "device")
        if document is None:
            return None
        tree = self._converter(document).tree(document.raw, ThrusterDevice)
        check_device(tree, self._report(document))
        return tree.value  # type: ignore[no-any-return]  # a ThrusterDevice, or None

    def _read_model(self, path: Path | None) -> Document | None:
        """Return a vehicle file with its sensors' device files filled in; the same raw tables each time, so that they are converted once."""
        file = self._read_kind(path, "vehicle")
        return None if file is None else self._with_profiles(file)

    def _with_profiles(self, document: Document) -> Document:
        """Fill the device files of its sensors into a file, and return it."""
        report = self._report(document)
        fill_in_profiles(
            document.raw,
            lambda name, place: self._profile(find(name, "devices", document.folder, partial(report, place))),
            report,
        )
        return document

    def _read_profile(self, path: Path | None) -> Mapping[str, Any] | None:
        """Return the keys that the device file of a sensor gives."""
        file = self._read_kind(path, "device")
        return None if file is None else check_profile(file.raw, self._report(file), self._more)

    def _read_kind(self, path: Path | None, wanted: Kind) -> Document | None:
        document = self._read(path)
        other = None if document is None else _other_kind(document, wanted)
        if other is not None:
            self._problems.append(other)
        return document if other is None else None

    def _read_file(self, path: Path | None) -> Document | None:
        try:
            return None if path is None else read(path)
        except ScenarioError as error:
            self._problems.extend(error.problems)
            return None

    def _converter(self, place: Document | MergedFile) -> Converter:
        return Converter(self._report(place), self._more, self._known)

    def _report(self, place: Document | MergedFile, severity: Severity = "error") -> Report:
        def report(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
            self._problems.append(place.problem(path, text, at, severity))
            if len(self._problems) >= MOST_PROBLEMS:
                last = Problem(self._document.label, 0, 0, "", f"{MOST_PROBLEMS} problems: the rest was not checked")
                raise ScenarioError([*_in_order(self._problems), last])

        return report

    def _warn(self, place: Document | MergedFile) -> Report:
        return self._report(place, "warning")


def _without_disabled(vehicle: VehicleFile) -> VehicleFile:
    return msgspec.structs.replace(
        vehicle,
        sensors={name: sensor for name, sensor in vehicle.sensors.items() if sensor.enabled},
        actuators={name: actuator for name, actuator in vehicle.actuators.items() if actuator.enabled},
    )


def _in_order(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Return the problems without repetitions: errors first, by file (in the order of reading) and place."""
    unique = list(dict.fromkeys(problems))
    files = list(dict.fromkeys(problem.file for problem in unique))
    return tuple(sorted(unique, key=lambda p: (p.severity == "warning", files.index(p.file), p.line, p.column)))
