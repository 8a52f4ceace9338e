"""Tables of adapters that are given apart from a scenario file, by a program that serves its world."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from uwserver.scenario.files.convert import Converter, check_name
from uwserver.scenario.files.documents import from_tables
from uwserver.scenario.files.errors import KeyPath, Problem, ScenarioError
from uwserver.scenario.load.extras import missing_extras
from uwserver.scenario.load.tables import Scenario


def adapters_of(tables: Mapping[str, Any], kinds: Mapping[str, type], scenario: Scenario) -> dict[str, Any]:
    """Return the configuration of each adapter by name.

    Args:
        tables: by name, as in the table `adapters` of a scenario file, or finished configurations.
        kinds: configuration type of each installed adapter, by kind.
        scenario: that they serve.

    Raises:
        ScenarioError: tables have faults, or packages that they need are not installed; the text has all of them.
    """
    document = from_tables({"adapters": {**tables}}, "serve")
    problems: list[Problem] = []

    def report(path: KeyPath, text: str, at: KeyPath | None = None) -> None:
        problems.append(document.problem(path, text, at))

    converter, configs = Converter(report), {}
    for name, table in tables.items():
        is_named = check_name(("adapters", name), report)
        config = table if isinstance(table, msgspec.Struct) else converter.kind(table, kinds, ("adapters", name)).value
        if is_named and config is not None:
            configs[name] = config
    if not problems:
        missing = missing_extras(msgspec.structs.replace(scenario, adapters=configs), is_solid=False)
        if missing is not None:
            problems.append(Problem(document.label, 0, 0, "adapters", str(missing)))
    if problems:
        raise ScenarioError(problems)
    return configs
