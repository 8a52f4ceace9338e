"""A scenario as TOML again: what is left out, how vectors and odd texts are written, and what `explain` adds."""

from __future__ import annotations

import sys
from typing import Any

import msgspec
import pytest
from msgspec import UNSET, UnsetType, field

from uwserver.scenario.load.export import explain, tables, to_toml
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.table import Table

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


class Part(Table, tag="part", tag_field="kind", kw_only=True, frozen=True):
    """A tagged table with every kind of default."""

    needed: int
    size: float = 2.0
    maybe: float | UnsetType = UNSET
    none: str | None = None
    names: tuple[str, ...] = ()
    more: dict[str, float] = field(default_factory=dict)


class Whole(Table, kw_only=True, frozen=True):
    """One that holds others."""

    part: Part = Part(needed=0)
    parts: dict[str, Part] = field(default_factory=dict)
    rows: tuple[tuple[float, float], ...] = ()


@pytest.mark.parametrize(
    ("part", "raw"),
    [
        (Part(needed=1), {"kind": "part", "needed": 1}),
        (Part(needed=0, size=2.0), {"kind": "part", "needed": 0}),
        (Part(needed=1, size=3.0, maybe=0.0), {"kind": "part", "needed": 1, "size": 3.0, "maybe": 0.0}),
        (Part(needed=1, none="x", names=("a",)), {"kind": "part", "needed": 1, "none": "x", "names": ["a"]}),
        (Part(needed=1, more={"b": 1.0}), {"kind": "part", "needed": 1, "more": {"b": 1.0}}),
    ],
)
def test_what_is_at_its_default_is_left_out_and_the_kind_comes_first(part: Part, raw: dict[str, Any]) -> None:
    assert tables(part) == raw
    assert next(iter(tables(part))) == "kind"
    assert msgspec.convert(raw, Part) == part


def test_with_defaults_all_that_has_a_value_is_there() -> None:
    raw = tables(Part(needed=1), defaults=True)
    assert raw == {"kind": "part", "needed": 1, "size": 2.0, "names": [], "more": {}}


def test_tables_in_tables() -> None:
    whole = Whole(parts={"a": Part(needed=1)}, rows=((1.0, 2.0), (3.0, 4.0)))
    assert tables(whole) == {"parts": {"a": {"kind": "part", "needed": 1}}, "rows": [[1.0, 2.0], [3.0, 4.0]]}
    assert tables(whole, defaults=True)["part"]["size"] == 2.0


def test_what_is_given_is_not_shared_with_what_comes_out() -> None:
    entry = VehicleEntry(model="x", override={"rigid_body": {"mass_kg": 1.0}})
    tables(entry)["override"]["rigid_body"]["mass_kg"] = 2.0
    assert entry.override["rigid_body"]["mass_kg"] == 1.0


# -- text -------------------------------------------------------------------------------------------------------------------------------


def test_vectors_stand_on_one_line() -> None:
    scenario = Scenario(schema=1, vehicles={"rov": VehicleEntry(model="x", position_ned_m=(1.0, -2.5, 1e-7))})
    assert "position_ned_m = [1.0, -2.5, 1e-07]\n" in to_toml(scenario)
    assert to_toml(Scenario(schema=1)) == "schema = 1\n\n[adapters]\n"  # a file without the table would get one


def test_text_that_looks_like_a_vector_is_left_alone() -> None:
    title = "[\n    1,\n    2,\n]"
    assert tomllib.loads(to_toml(Scenario(schema=1, title=title)))["title"] == title


@pytest.mark.parametrize("title", ['"', "\\", "\x00", "\u2028", "é", "#", "a\tb", "'''", '"""'])
def test_any_title_comes_back(title: str) -> None:
    assert tomllib.loads(to_toml(Scenario(schema=1, title=title)))["title"] == title


def test_names_of_tables_come_back() -> None:
    scenario = Scenario(schema=1, vehicles={name: VehicleEntry(model="x") for name in ("a-b", "_c", "d.e")})
    assert list(tomllib.loads(to_toml(scenario))["vehicles"]) == ["a-b", "_c", "d.e"]


# -- explain ----------------------------------------------------------------------------------------------------------------------------


@pytest.fixture
def explained(write, files, adapters):
    def run(extra: str = "", vehicle: str = "") -> tuple[str, dict[str, Any]]:
        text = explain(load(write(files["tank"] + extra, files["tiny"] + vehicle), adapters=adapters))
        return text, tomllib.loads(text)

    return run


def test_the_density_in_use_is_written_out(explained) -> None:
    assert explained()[1]["environment"]["density_kgpm3"] == 1025.0
    fresh = '[environment.water]\nkind = "constant"\nsalinity_psu = 0\n'
    assert explained(fresh)[1]["environment"]["density_kgpm3"] == pytest.approx(999.7, abs=0.1)


def test_a_vehicle_is_shown_as_it_will_be_built(explained) -> None:
    extra = "[vehicles.rov.override.rigid_body]\nmass_kg = 10.1\n"
    rov = explained(extra + '[vehicles.rov.sensors.depth]\nkind = "pressure"\nrate_hz = 10\n')[1]["vehicles"]["rov"]
    assert rov["file"]["rigid_body"]["mass_kg"] == 10.1
    assert list(rov["file"]["sensors"]) == ["imu", "depth"]
    assert rov["file"]["sensors"]["depth"]["enabled"] is True
    assert rov["devices"]["./motor.toml"]["curves"]["v16"]["max_forward_N"] == 50.0
    assert "override" not in rov
    assert "sensors" not in rov
    assert rov["model"] == "./tiny.toml"


def test_warnings_come_first_as_comments(explained) -> None:
    text, whole = explained("[vehicles.rov.override.buoyancy]\nvolume_m3 = 0.02\n")
    first = text.splitlines()[0]
    assert first.startswith("# tank.toml:10:24: vehicles.rov.override.buoyancy: warning: the vehicle floats up with")
    assert whole["schema"] == 1
