"""A misspelt key never passes: each schema key of each shipped file, changed by one character, must be refused."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from uwserver.scenario.files.convert import fields, kinds_of
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError, dotted
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile

FILES = {
    **{f"{name} (scenario)": (path, Scenario) for name, path in shipped().items()},
    **{f"{name} (vehicle)": (path, VehicleFile) for name, path in shipped("vehicles").items()},
    **{
        f"{name} (device)": (path, ThrusterDevice)
        for name, path in shipped("devices").items()
        if read(path).raw["kind"] == "thruster"
    },
}


Key = tuple[KeyPath, tuple[object, ...]]
"""Where a key stands in a file, and what it is of: the same table of the schema, in an override or not, or an adapter of the same kind."""


def schema_keys(raw: Mapping[str, Any], struct: Any, path: KeyPath = ()) -> Iterator[Key]:
    """The keys that the schema names; names that a user chose are only passed through."""
    types = {info.encode_name: info.type for info in fields(struct)}
    for key, value in raw.items():
        yield (*path, key), (struct, key, "override" in path)
        yield from below(value, VehicleFile if key == "override" else types.get(key), (*path, key))


def below(value: Any, type_: Any, path: KeyPath) -> Iterator[Key]:
    if not isinstance(value, dict):
        return
    if path[:1] == ("adapters",):  # any adapter's table: its keys are schema keys, its name is not
        yield from (((*path, name, key), (table.get("kind"), key)) for name, table in value.items() for key in table)
        return
    if hasattr(type_, "__metadata__"):
        type_ = type_.__origin__
    arguments = getattr(type_, "__args__", ())
    if getattr(type_, "__origin__", None) is dict:
        for name, table in value.items():
            yield from below(table, arguments[1], (*path, name))
        return
    if "kind" in value and value["kind"] in kinds_of(type_):  # a vehicle's is a key like others
        type_, arguments = kinds_of(type_)[value["kind"]], ()
    structs = [t for t in (*arguments, type_) if hasattr(t, "__struct_fields__")]
    yield from schema_keys(value, structs[0], path)


def mutated(key: str) -> str:
    """One character changed, by a rule that depends on the key alone and keeps it a bare key."""
    place = sum(map(ord, key)) % len(key)
    letter = "x" if key[place] != "x" else "y"
    return key[:place] + letter + key[place + 1 :]


CHOOSING = "kind", "model", "profile", "device"
"""Keys by which it is decided what the others beside them and below mean."""
TOGETHER = 50
"""Keys that are changed at once; many more faults are not told."""


def together(keys: Iterable[KeyPath], lines: Mapping[KeyPath, int]) -> Iterator[list[KeyPath]]:
    """Keys in groups whose faults do not hide each other: none below another, no two in a line, those that choose beside their like alone."""
    groups: dict[tuple[int, object], list[list[KeyPath]]] = {}
    for key in keys:
        alike = groups.setdefault((len(key), key[-1] if key[-1] in CHOOSING else ""), [])
        for group in alike:
            of_this_table = {mutated(str(other[-1])) for other in group if other[:-1] == key[:-1]}
            in_lines = {lines[other] for other in group}
            if len(group) < TOGETHER and lines[key] not in in_lines and mutated(str(key[-1])) not in of_this_table:
                group.append(key)
                break
        else:
            alike.append([key])
    return (group for alike in groups.values() for group in alike)


class Mutants:
    """Of a file, which a scenario names."""

    def __init__(self, path: Path, struct: Any, adapters: Mapping[str, type], folder: Path) -> None:
        self.document = read(path)
        self.keys = [key for key, _ in schema_keys(self.document.raw, struct)]
        self._lines = path.read_text(encoding="utf-8").split("\n")
        self._adapters = adapters
        self._scenario, self._copy = prepared(path, struct, folder)

    def groups(self, keys: Iterable[KeyPath]) -> Iterator[list[KeyPath]]:
        return together(keys, {key: self.document.locations[key][0] for key in keys})

    def told(self, keys: list[KeyPath]) -> list[Problem] | None:
        """What is told in the file where these are changed, one in a line; None where nothing is refused."""
        lines = list(self._lines)
        for key in keys:
            line, column = self.document.locations[key]
            text, word = lines[line - 1], str(key[-1])
            assert text[column - 1 :].startswith(word)
            lines[line - 1] = text[: column - 1] + mutated(word) + text[column - 1 + len(word) :]
        self._copy.write_text("\n".join(lines), encoding="utf-8")
        try:
            load(self._scenario, adapters=self._adapters)
        except ScenarioError as error:
            return [problem for problem in error.problems if problem.file == self._copy.name]
        return None

    def unknown(self, keys: list[KeyPath]) -> list[KeyPath]:
        """Those of some keys, changed at once, that are not told as unknown where they stand."""
        told = {(problem.line, problem.text.partition('"')[2].partition('"')[0]) for problem in self.told(keys) or ()}
        return [key for key in keys if (self.document.locations[key][0], mutated(str(key[-1]))) not in told]


@pytest.fixture(scope="module")
def new_keys() -> dict[str, list[KeyPath]]:
    """By file the keys that no file before it has, those of most keys before the others."""
    keys = {name: list(schema_keys(read(path).raw, struct)) for name, (path, struct) in FILES.items()}
    seen: set[tuple[object, ...]] = set()
    found = {}
    for name in sorted(keys, key=lambda name: -len(keys[name])):
        found[name] = [key for key, of in keys[name] if of not in seen]
        seen.update(of for _, of in keys[name])
    return found


@pytest.mark.parametrize("which", ["new", pytest.param("all", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FILES)
def test_every_key_changed_by_one_character_is_refused(
    name: str, which: str, new_keys: dict[str, list[KeyPath]], adapters: Mapping[str, type], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """Many are changed at once, and those alone of which nothing is told then."""
    monkeypatch.chdir(tmp_path)
    mutants = Mutants(*FILES[name], adapters, tmp_path)
    assert len(mutants.keys) > 10
    keys = mutants.keys if which == "all" else new_keys[name]
    legal, elsewhere = [], []
    for key in [key for group in mutants.groups(keys) for key in mutants.unknown(group)]:
        told = mutants.told([key])
        if told is None:
            legal.append(f"{dotted(key)} as {mutated(str(key[-1]))}")
        elif mutants.document.locations[key][0] not in {problem.line for problem in told}:
            elsewhere.append(f"{dotted(key)}: {told}")
    assert elsewhere == []
    assert len(legal) <= len(mutants.keys) // 50
    if legal:  # all others were refused
        pytest.skip(f"mutants that are legal themselves: {', '.join(legal)}")


def prepared(path: Path, struct: Any, folder: Path) -> tuple[Path, Path]:
    """A scenario to load, and the file in it that is to be mutated; it loads as it is."""
    copy = folder / "mutant.toml"
    copy.write_bytes(path.read_bytes())
    if struct is Scenario:
        return copy, copy
    model = "mutant.toml" if struct is VehicleFile else "bluerov2_heavy_von_benzon"
    text = f"schema = 1\n[vehicles.v]\nmodel = '{model}'\n"
    if struct is ThrusterDevice:
        text += "[vehicles.v.override.thrusters.t1]\ndevice = 'mutant.toml'\n"
    scenario = folder / "scenario.toml"
    scenario.write_text(text)
    return scenario, copy
