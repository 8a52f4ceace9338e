"""Checks of a scenario as a whole: truth falls on ticks, names and ports are free."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from uwserver.scenario.files.convert import Node
from uwserver.scenario.load.checks import check_scenario
from uwserver.table import Table

METRICS = 9600


class Served(Table, tag="served", tag_field="kind", kw_only=True, frozen=True):
    """Configuration of an adapter that listens."""

    port: Any = 0


class Silent(Table, tag="silent", tag_field="kind", kw_only=True, frozen=True):
    """Configuration of one that does not."""


@pytest.fixture
def told(tree_of, report, warn):
    """What is told of a scenario with tables and adapters' configurations."""

    def check(adapters: dict[str, Table] | None = None, **tables: Any) -> tuple[list[str], list[str]]:
        tree = tree_of({"schema": 1, **tables})
        report.lines.clear()  # what conversion tells has tests of its own
        if tree.value is not None:
            tree = Node(replace(tree.value, adapters=adapters or {}), tree.parts)
        check_scenario(tree, report, warn)
        return report.lines, warn.lines

    return check


def test_a_bare_scenario_passes(told) -> None:
    assert told() == ([], [])


@pytest.mark.parametrize(("rate", "fits"), [(240, True), (20, True), (7, False), (480, False)])
def test_truth_falls_on_ticks(rate: float, fits: bool, told) -> None:
    errors, _ = told(vehicles={"rov": {"model": "x", "truth": {"rate_hz": rate}}})
    assert len(errors) == (not fits)
    assert all(line.startswith(f"vehicles.rov.truth.rate_hz: {rate} Hz ") for line in errors)


def test_the_rate_is_that_of_the_world(told) -> None:
    vehicles = {"rov": {"model": "x", "truth": {"rate_hz": 100}}}
    assert told(vehicles=vehicles)[0]
    assert told(world={"rate_hz": 200}, vehicles=vehicles)[0] == []
    assert told(world={"rate_hz": "fast"}, vehicles=vehicles)[0] == []


def test_a_faulty_vehicle_does_not_hide_its_truth(told) -> None:
    errors, _ = told(vehicles={"rov": {"truth": {"rate_hz": 7}}, "odd": 3, "two": {"model": "x", "truth": 3}})
    assert len(errors) == 1


def test_no_vehicle_is_called_world(told) -> None:
    text = 'vehicles.world: a vehicle cannot be named "world", as paths of services begin with it: choose another name'
    assert told(vehicles={"world": {"model": "x"}}) == ([text], [])


def test_time_water_and_currents_are_checked_too(told) -> None:
    layers = {"kind": "profile", "depth_m": [5, 1], "velocity_ned_mps": [[0, 0, 0], [1, 0, 0]]}
    errors, warnings = told(
        world={"epoch_utc": "now"},
        environment={
            "currents": {"layers": layers},
            "water": {"kind": "constant"},
            "density_kgpm3": 900,
            "waves": {"significant_height_m": 20, "peak_period_s": 5, "direction_deg": 0},
        },
    )
    places = [line.split(":")[0] for line in errors]
    assert places == ["world.epoch_utc", "environment.currents.layers.depth_m[1]", "environment.density_kgpm3"]
    assert [line.split(":")[0] for line in warnings] == ["environment.waves.significant_height_m"]


# -- ports ------------------------------------------------------------------------------------------------------------------------------


def test_ports_that_differ_pass(told) -> None:
    adapters = {"a": Served(port=7600), "b": Served(port=7601), "c": Silent(), "d": Served(), "e": Served()}
    assert told(adapters) == ([], [])


def test_a_port_that_two_use_is_doubted_with_the_first(told) -> None:
    errors, warnings = told({"a": Served(port=7600), "b": Served(port=7600), "c": Served(port=7600)})
    assert errors == []
    text = "adapters.a uses port 7600 too: unless one is TCP and the other UDP, only one of them can start"
    assert warnings == [f"adapters.b.port: {text}", f"adapters.c.port: {text}"]


def test_the_port_of_the_metrics_counts_while_they_are_served(told) -> None:
    (line,) = told({"a": Served(port=METRICS)})[1]
    assert line.startswith(f"adapters.a.port: server.metrics_port uses port {METRICS} too")


def test_metrics_that_are_not_served_leave_their_port(told) -> None:
    assert told({"a": Served(port=METRICS)}, server={"metrics": False})[1] == []
    assert told({"a": Served(port=METRICS)}, server={"metrics_port": 9700})[1] == []


def test_what_is_no_number_is_no_port(told) -> None:
    assert told({"a": Served(port="/dev/ttyS0"), "b": Served(port="/dev/ttyS0")}) == ([], [])


def test_ports_of_a_faulty_scenario_are_left_out(told) -> None:
    assert told({"a": Served(port=METRICS)}, title=3) == ([], [])
