"""A scenario in Python: verbs that give the same `Scenario` as a file, and refuse a wrong key at once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uwserver.environment.currents import CurrentConfig
from uwserver.environment.waves import WavesConfig
from uwserver.modifiers import ModifierConfig
from uwserver.scenario.files.convert import NO_MORE, Converter, More, check_name, convert, kinds_of
from uwserver.scenario.files.documents import from_tables
from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError, did_you_mean
from uwserver.scenario.load.extensions import extension_kinds
from uwserver.scenario.load.scenario import scenario_tree
from uwserver.scenario.load.tables import Scenario, Server
from uwserver.scenario.solids.tables import ObjectEntry, Seabed, Structure
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.water.tables import Current, Environment
from uwserver.scenario.world.tables import Clock, WorldTable
from uwserver.sensors import SensorConfig, StreamTable
from uwserver.sensors.truth import Truth
from uwserver.world.faults import FaultConfig


class ScenarioBuilder:
    """Collects tables; every verb returns the builder itself.

    Keys are those of the scenario file. All verbs raise ScenarioError for a key or value that the file could not hold either. What only
    the whole scenario shows (rates, mounts, the vehicle file) is checked by `uwserver.scenario.load.scenario.load`.
    """

    def __init__(
        self, title: str, *, seed: int = 0, rate_hz: float = 240.0, adapters: Mapping[str, type] | None = None
    ) -> None:
        """Begin a scenario.

        Args:
            title: names the scenario.
            seed: of all random streams.
            rate_hz: physics ticks a second.
            adapters: configuration types by kind, as for `load`; default: those installed.
        """
        self._raw: dict[str, Any] = {"schema": 1, "title": title, "seed": seed}
        self._installed = adapters
        self._more: More = NO_MORE
        self.world(rate_hz=rate_hz)

    def extension(self, file: str | Path) -> ScenarioBuilder:
        """A Python file with further kinds of component for the verbs that follow; it is run."""
        path = str(Path(file).resolve())
        files, problems = [*self._raw.get("extensions", []), path], list[Problem]()
        label = self._raw["title"] or "scenario"

        def report(_: KeyPath, text: str) -> None:
            problems.append(Problem(label, 0, 0, "extensions", text))

        more = extension_kinds(files, Path.cwd(), report, problems.append)
        if problems:
            raise ScenarioError(problems)
        self._more, self._raw["extensions"] = more, files
        return self

    def world(self, **keys: Any) -> ScenarioBuilder:
        """Keys of `[world]`."""
        return self._update(("world",), WorldTable, keys)

    def clock(self, **keys: Any) -> ScenarioBuilder:
        """Keys of `[world.clock]`."""
        return self._update(("world", "clock"), Clock, keys)

    def environment(self, **keys: Any) -> ScenarioBuilder:
        """Keys of `[environment]`."""
        return self._update(("environment",), Environment, keys)

    def current(self, **keys: Any) -> ScenarioBuilder:
        """Keys of `[environment.current]`."""
        return self._update(("environment", "current"), Current, keys)

    def add_current(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """A current beside the others."""
        return self._update(("environment", "currents", name), CurrentConfig, {"kind": kind, **keys})

    def waves(self, **keys: Any) -> ScenarioBuilder:
        """Keys of `[environment.waves]`."""
        return self._update(("environment", "waves"), WavesConfig, keys)

    def server(self, **keys: Any) -> ScenarioBuilder:
        """Keys of `[server]`."""
        return self._update(("server",), Server, keys)

    def vehicle(self, name: str, model: str, **keys: Any) -> ScenarioBuilder:
        """A vehicle; `override` may be among its keys."""
        return self._update(("vehicles", name), VehicleEntry, {"model": model, **keys})

    def seabed(self, kind: str, **keys: Any) -> ScenarioBuilder:
        """`[seabed]`."""
        return self._update(("seabed",), Seabed, {"kind": kind, **keys})

    def structure(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """A structure that never moves."""
        return self._update(("structures", name), Structure, {"kind": kind, **keys})

    def free_object(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """Something that drifts and can be pushed: a table of `[objects]`."""
        return self._update(("objects", name), ObjectEntry, {"kind": kind, **keys})

    def truth(self, vehicle: str, **keys: Any) -> ScenarioBuilder:
        """Ground truth of a vehicle added before."""
        self._known(vehicle)
        return self._update(("vehicles", vehicle, "truth"), Truth, keys)

    def sensor(self, vehicle: str, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """A sensor for a vehicle added before; replaces one of its vehicle file with the same name."""
        self._known(vehicle)
        return self._update(("vehicles", vehicle, "sensors", name), SensorConfig, {"kind": kind, **keys})

    def stream(self, vehicle: str, sensor: str, name: str, **keys: Any) -> ScenarioBuilder:
        """One more stream of a sensor: of one added before, else of the sensor of that name in the vehicle file."""
        return self._update((*self._sensor(vehicle, sensor), "streams", name), StreamTable, keys)

    def modifier(
        self, vehicle: str, sensor: str, name: str, kind: str, *, stream: str | None = None, **keys: Any
    ) -> ScenarioBuilder:
        """An error of a sensor as for `stream`, or of one of its further streams."""
        raw = {"kind": kind, **_plain(keys)}
        path = self._sensor(vehicle, sensor)
        path = (*path, "modifiers", name) if stream is None else (*path, "streams", stream, "modifiers", name)
        self._checked(lambda report: Converter(report).kind(raw, kinds_of(ModifierConfig, self._more), path))
        self._put(path, raw)
        return self

    def fault(self, name: str, kind: str, target: str, **keys: Any) -> ScenarioBuilder:
        """A fault of a vehicle or of one of its components."""
        return self._update(("faults", name), FaultConfig, {"kind": kind, "target": target, **keys})

    def adapter(self, name: str, kind: str, **keys: Any) -> ScenarioBuilder:
        """An adapter."""
        if self._installed is None:
            # Late: which adapters are installed is asked for only when one is used.
            from uwserver.adapter import installed_adapters

            self._installed = installed_adapters()
        installed, raw, path = self._installed, {"kind": kind, **_plain(keys)}, ("adapters", name)
        self._checked(lambda report: Converter(report).kind(raw, installed, path))
        self._put(path, raw)
        return self

    def build(self) -> Scenario:
        """The scenario; the builder may be used further."""
        adapters = self._installed or {}
        tree = self._checked(lambda report: scenario_tree(self._raw, adapters, Converter(report, self._more)))
        scenario: Scenario = tree.value
        return scenario

    def _sensor(self, vehicle: str, sensor: str) -> KeyPath:
        """Where a sensor's table stands: in the scenario, or what overrides the vehicle file."""
        added = sensor in self._known(vehicle).get("sensors", {})
        return ("vehicles", vehicle, *(() if added else ("override",)), "sensors", sensor)

    def _known(self, vehicle: str) -> dict[str, Any]:
        vehicles: dict[str, dict[str, Any]] = self._raw.get("vehicles", {})
        if vehicle not in vehicles:
            text = f'no vehicle "{vehicle}" added before{did_you_mean(vehicle, list(vehicles))}'
            raise ScenarioError([Problem(self._raw["title"], 0, 0, "vehicles", text)])
        return vehicles[vehicle]

    def _update(self, path: KeyPath, type_: Any, keys: Mapping[str, Any]) -> ScenarioBuilder:
        raw = {**self._at(path), **_plain(keys)}
        self._checked(lambda report: check_name(path, report) and convert(raw, type_, path, report, self._more))
        self._put(path, raw)
        return self

    def _at(self, path: KeyPath) -> dict[str, Any]:
        table: Any = self._raw
        for key in path:
            table = table.get(key, {})
        return dict(table)

    def _put(self, path: KeyPath, raw: dict[str, Any]) -> None:
        table: Any = self._raw
        for key in path[:-1]:
            table = table.setdefault(key, {})
        table[path[-1]] = raw

    def _checked(self, conversion: Any) -> Any:
        """The result of `conversion(report)`; ScenarioError if anything was reported."""
        problems: list[Problem] = []
        place = from_tables({}, self._raw["title"] or "scenario")
        result = conversion(lambda path, text, at=None: problems.append(place.problem(path, text, at)))
        if problems:
            raise ScenarioError(problems)
        return result


def _plain(value: Any) -> Any:
    """What a TOML parser would give: lists for tuples and arrays, Python numbers for numpy's."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
