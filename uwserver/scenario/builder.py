"""Builds a scenario in Python. The methods give the same `Scenario` as a file, and refuse a wrong key at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from uwserver.environment.currents import CurrentConfig
from uwserver.environment.waves import WavesConfig
from uwserver.modifiers import ModifierConfig
from uwserver.scenario.files.convert import NO_MORE, Converter, More, Report, check_name
from uwserver.scenario.files.documents import from_tables
from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError, did_you_mean
from uwserver.scenario.load.extensions import extension_kinds
from uwserver.scenario.load.scenario import scenario_tree
from uwserver.scenario.load.tables import Scenario, Server
from uwserver.scenario.solids.tables import ObjectEntry, Seabed, Structure
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Clock, Current, Environment, WorldTable
from uwserver.sensors import SensorConfig, StreamTable
from uwserver.sensors.truth import Truth
from uwserver.world.faults import FaultConfig


class ScenarioBuilder:
    """Collects the tables of a scenario; every method returns the builder itself.

    Keys are those of the scenario file. Every method raises ScenarioError for a key or value that the file could not hold either. What needs
    the whole scenario (rates, mounts, the vehicle file) is checked later, by `uwserver.scenario.load.scenario.load`.
    """

    def __init__(
        self,
        title: str,
        *,
        seed: int = 0,
        rate_hz: float = 240.0,
        start: str = "free",
        adapters: Mapping[str, type] | None = None,
    ) -> None:
        """Begin a scenario.

        Args:
            title: title of the scenario.
            seed: seed of all random streams.
            rate_hz: physics ticks per second.
            start: "held" keeps the vehicles where they start until something on board acts; see `Scenario`.
            adapters: configuration types by kind, as for `load`; default: those that are installed.
        """
        self._raw: dict[str, Any] = {"schema": 1, "title": title, "start": start, "seed": seed}
        self._installed = adapters
        self._more: More = NO_MORE
        self.world(rate_hz=rate_hz)

    def extension(self, file: str | Path) -> ScenarioBuilder:
        """Run a Python file that adds kinds of component, which later calls may then use."""
        files = [*self._raw.get("extensions", []), str(Path(file).resolve())]
        self._more = self._checked(
            lambda report, add: extension_kinds(files, Path.cwd(), lambda _, text: report(("extensions",), text), add)
        )
        self._raw["extensions"] = files
        return self

    def world(self, **keys: Any) -> ScenarioBuilder:
        """Set keys of `[world]`."""
        return self._update(("world",), WorldTable, keys)

    def clock(self, **keys: Any) -> ScenarioBuilder:
        """Set keys of `[world.clock]`."""
        return self._update(("world", "clock"), Clock, keys)

    def environment(self, **keys: Any) -> ScenarioBuilder:
        """Set keys of `[environment]`."""
        return self._update(("environment",), Environment, keys)

    def current(self, **keys: Any) -> ScenarioBuilder:
        """Set keys of `[environment.current]`."""
        return self._update(("environment", "current"), Current, keys)

    def add_current(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """Add a table to `[environment.currents]`; all currents add up."""
        return self._update(("environment", "currents", name), CurrentConfig, {"kind": kind, **keys})

    def waves(self, **keys: Any) -> ScenarioBuilder:
        """Set keys of `[environment.waves]`."""
        return self._update(("environment", "waves"), WavesConfig, keys)

    def server(self, **keys: Any) -> ScenarioBuilder:
        """Set keys of `[server]`."""
        return self._update(("server",), Server, keys)

    def vehicle(self, name: str, model: str, **keys: Any) -> ScenarioBuilder:
        """Add a vehicle; its keys may include `override`."""
        return self._update(("vehicles", name), VehicleEntry, {"model": model, **keys})

    def seabed(self, kind: str, **keys: Any) -> ScenarioBuilder:
        """Set `[seabed]`."""
        return self._update(("seabed",), Seabed, {"kind": kind, **keys})

    def structure(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """Add a structure, which never moves."""
        return self._update(("structures", name), Structure, {"kind": kind, **keys})

    def free_object(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """Add a table to `[objects]`: something that drifts and can be pushed."""
        return self._update(("objects", name), ObjectEntry, {"kind": kind, **keys})

    def truth(self, vehicle: str, **keys: Any) -> ScenarioBuilder:
        """Set the ground truth of a vehicle that was added before."""
        self._known(vehicle)
        return self._update(("vehicles", vehicle, "truth"), Truth, keys)

    def sensor(self, vehicle: str, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """Add a sensor to a vehicle that was added before. It replaces a sensor of the same name in the vehicle file."""
        self._known(vehicle)
        return self._update(("vehicles", vehicle, "sensors", name), SensorConfig, {"kind": kind, **keys})

    def stream(self, vehicle: str, sensor: str, name: str, **keys: Any) -> ScenarioBuilder:
        """Add a stream to a sensor that was added before, or to the sensor of that name in the vehicle file."""
        return self._update((*self._sensor(vehicle, sensor), "streams", name), StreamTable, keys)

    def modifier(
        self, vehicle: str, sensor: str, name: str, kind: str, *, stream: str | None = None, **keys: Any
    ) -> ScenarioBuilder:
        """Add a modifier (an error model) to a sensor as for `stream`, or to one of the sensor's further streams."""
        of_stream = () if stream is None else ("streams", stream)
        path = (*self._sensor(vehicle, sensor), *of_stream, "modifiers", name)
        return self._set(path, ModifierConfig, {"kind": kind, **_plain(keys)})

    def fault(self, name: str, kind: str, target: str, **keys: Any) -> ScenarioBuilder:
        """Add a fault of a vehicle or of one of its components."""
        return self._update(("faults", name), FaultConfig, {"kind": kind, "target": target, **keys})

    def adapter(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """Add an adapter."""
        if self._installed is None:
            # Imported only here, as looking for installed adapters takes time.
            from uwserver.adapter import installed_adapters

            self._installed = installed_adapters()
        return self._set(("adapters", name), self._installed, {"kind": kind, **_plain(keys)})

    def build(self) -> Scenario:
        """Return the scenario; the builder can be used further."""
        adapters = self._installed or {}
        tree = self._checked(lambda report, _: scenario_tree(self._raw, adapters, Converter(report, self._more)))
        return tree.value  # type: ignore[no-any-return]  # a Scenario, as nothing was reported

    def _sensor(self, vehicle: str, sensor: str) -> KeyPath:
        """Return the path of a sensor's table: in the scenario, or in the tables that override the vehicle file."""
        added = sensor in self._known(vehicle).get("sensors", {})
        return ("vehicles", vehicle, *(() if added else ("override",)), "sensors", sensor)

    def _known(self, vehicle: str) -> dict[str, Any]:
        vehicles: dict[str, dict[str, Any]] = self._raw.get("vehicles", {})
        if vehicle not in vehicles:
            text = f'there is no vehicle "{vehicle}" yet{did_you_mean(vehicle, list(vehicles))}: add it first'
            raise ScenarioError([Problem(self._raw["title"], 0, 0, "vehicles", text)])
        return vehicles[vehicle]

    def _update(self, path: KeyPath, type_: Any, keys: Mapping[str, Any]) -> ScenarioBuilder:
        """Check the table at a path with these keys added, and put it there."""
        table: Any = self._raw
        for key in path:
            table = table.get(key, {})
        return self._set(path, type_, {**table, **_plain(keys)})

    def _set(self, path: KeyPath, type_: Any, raw: dict[str, Any]) -> ScenarioBuilder:
        """Check a table against its type, or against Structs by their kind, and put it at a path."""

        def check(report: Report, _: Any) -> None:
            converter = Converter(report, self._more)
            converted = converter.kind if isinstance(type_, Mapping) else converter.tree
            if check_name(path, report):
                converted(raw, type_, path)

        self._checked(check)
        table: Any = self._raw
        for key in path[:-1]:
            table = table.setdefault(key, {})
        table[path[-1]] = raw
        return self

    def _checked(self, conversion: Callable[[Report, Callable[[Problem], None]], Any]) -> Any:
        """Return the result of `conversion(report, add)`; raise ScenarioError if anything was reported or added."""
        problems: list[Problem] = []
        place = from_tables({}, self._raw["title"] or "scenario")
        result = conversion(lambda path, text, at=None: problems.append(place.problem(path, text, at)), problems.append)
        if problems:
            raise ScenarioError(problems)
        return result


def _plain(value: Any) -> Any:
    """Return what a TOML parser would give: lists for tuples and arrays, Python numbers for numpy's."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
