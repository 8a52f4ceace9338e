"""The scenario file as a whole: what may be left out, and what no file can hold."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import UNSET

from uwserver.scenario.load.tables import Scenario, Server


def test_the_schema_alone_is_a_scenario(tree_of, report) -> None:
    scenario: Scenario = tree_of({"schema": 1}).value
    assert report.lines == []
    assert scenario == Scenario(schema=1)
    assert (scenario.title, scenario.seed, scenario.extensions, scenario.seabed) == ("", 0, (), UNSET)
    for table in ("structures", "objects", "vehicles", "faults", "adapters"):
        assert getattr(scenario, table) == {}


def test_defaults_of_the_server() -> None:
    server = Server()
    assert (server.name, server.metrics, server.metrics_bind, server.metrics_port) == (
        "uwserver",
        True,
        "127.0.0.1",
        9600,
    )
    assert not server.uvloop


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"schema": 2}, "schema: expected 1, found 2"),
        ({"seed": -1}, "seed: expected a whole number of at least 0, found -1"),
        ({"seed": 1.0}, "seed: expected a whole number of at least 0, found 1.0"),
        ({"title": 3}, "title: expected a string, found 3"),
        ({"extensions": "mine.py"}, "extensions: expected an array"),
        ({"extensions": [""]}, "extensions[0]: expected a string that is not empty"),
        ({"server": {"metrics_port": -1}}, "server.metrics_port: expected a whole number from 0 to 65535, found -1"),
        ({"server": {"name": ""}}, 'server.name: expected a string that is not empty, found the string ""'),
        ({"vehicles": []}, "vehicles: expected a table, found an array of 0"),
        ({"vehicles": {"a b": {"model": "x"}}}, 'vehicles."a b": "a b" cannot be a name'),
        ({"structures": {"s": {"kind": "cone"}}}, 'structures.s.kind: unknown kind "cone"'),
        ({"vehicle": {}}, ' [vehicle]: unknown key "vehicle" (did you mean "vehicles"?)'),
    ],
)
def test_what_no_file_can_hold(keys: dict[str, Any], line: str, tree_of, report) -> None:
    assert tree_of({"schema": 1, **keys}).value is None
    assert report.lines[0].startswith(line)


def test_adapters_are_of_types_that_are_not_known_here(tree_of, report) -> None:
    tree = tree_of({"schema": 1, "adapters": {"any thing": {"kind": "mine", "x": [1]}}})
    assert report.lines == []
    assert tree.value.adapters == {"any thing": {"kind": "mine", "x": [1]}}
