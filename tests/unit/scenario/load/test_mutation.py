"""A misspelt key never passes: each schema key of each shipped file, changed by one character, must be refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from uwserver.scenario.files.convert import fields, kinds_of
from uwserver.scenario.files.documents import read, shipped
from uwserver.scenario.files.errors import KeyPath, ScenarioError, dotted
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


def schema_keys(raw: Mapping[str, Any], struct: Any, path: KeyPath = ()) -> Iterator[KeyPath]:
    """Paths of the keys that the schema names; names that a user chose are only passed through."""
    types = {info.encode_name: info.type for info in fields(struct)}
    for key, value in raw.items():
        yield (*path, key)
        yield from below(value, VehicleFile if key == "override" else types.get(key), (*path, key))


def below(value: Any, type_: Any, path: KeyPath) -> Iterator[KeyPath]:
    if not isinstance(value, dict):
        return
    if path[:1] == ("adapters",):  # any adapter's table: its keys are schema keys, its name is not
        yield from ((*path, name, key) for name, table in value.items() for key in table)
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


@pytest.mark.parametrize("name", FILES)
def test_every_key_changed_by_one_character_is_refused(
    name: str, adapters: Mapping[str, type], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, struct = FILES[name]
    document = read(path)
    keys = list(schema_keys(document.raw, struct))
    assert len(keys) > 10
    lines = path.read_text(encoding="utf-8").split("\n")
    monkeypatch.chdir(tmp_path)
    scenario, copy = prepared(path, struct, tmp_path)
    legal, elsewhere = [], []
    for key in keys:
        line, column = document.locations[key]
        text, word = lines[line - 1], str(key[-1])
        assert text[column - 1 :].startswith(word)
        changed = text[: column - 1] + mutated(word) + text[column - 1 + len(word) :]
        copy.write_text("\n".join([*lines[: line - 1], changed, *lines[line:]]), encoding="utf-8")
        try:
            load(scenario, adapters=adapters)
        except ScenarioError as error:
            if (copy.name, line) not in {(problem.file, problem.line) for problem in error.problems}:
                elsewhere.append(f"{dotted(key)}: {error}")
        else:
            legal.append(f"{dotted(key)} as {mutated(word)}")
    assert elsewhere == []
    assert len(legal) <= len(keys) // 50
    if legal:  # all others were refused
        pytest.skip(f"mutants that are legal themselves: {', '.join(legal)}")


def prepared(path: Path, struct: Any, folder: Path) -> tuple[Path, Path]:
    """A scenario to load, and the file in it that is to be mutated; it loads as it is."""
    copy = folder / "mutant.toml"
    copy.write_bytes(path.read_bytes())
    if struct is Scenario:
        return copy, copy
    model = "mutant.toml" if struct is VehicleFile else "bluerov2"
    text = f"schema = 1\n[vehicles.v]\nmodel = '{model}'\n"
    if struct is ThrusterDevice:
        text += "[vehicles.v.override.thrusters.t1]\ndevice = 'mutant.toml'\n"
    scenario = folder / "scenario.toml"
    scenario.write_text(text)
    return scenario, copy
