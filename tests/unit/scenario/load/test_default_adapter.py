"""A scenario file without a table of adapters gets sockets on TCP 7600; an empty table gets none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario

ROV = '[vehicles.a]\nmodel = "bluerov2"\nposition_ned_m = [0.0, 0.0, 5.0]\n'


def test_a_file_without_the_table_is_served_by_sockets(tmp_path: Path, adapters: Mapping[str, type]) -> None:
    path = tmp_path / "s.toml"
    path.write_text("schema = 1\n" + ROV)
    (config,) = load(path, adapters=adapters).scenario.adapters.values()
    assert config == adapters["sockets"]()
    assert config.port == 7600


@pytest.mark.parametrize(("table", "names"), [("[adapters]\n", []), ('[adapters.gcs]\nkind = "mavlink"\n', ["gcs"])])
def test_a_file_with_the_table_has_what_it_says(tmp_path, adapters, table, names):
    path = tmp_path / "s.toml"
    path.write_text("schema = 1\n" + ROV + table)
    assert list(load(path, adapters=adapters).scenario.adapters) == names


def test_a_scenario_of_python_gets_none(adapters: Mapping[str, type]) -> None:
    assert not load(Scenario(schema=1), adapters=adapters).scenario.adapters


def test_where_sockets_is_not_installed_there_is_none(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("schema = 1\n" + ROV)
    assert not load(path, adapters={}).scenario.adapters
