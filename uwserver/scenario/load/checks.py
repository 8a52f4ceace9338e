"""Checks of a scenario across its tables."""

from __future__ import annotations

from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.water.checks import check_density, check_environment
from uwserver.scenario.world.checks import check_earth, check_rate, check_time


def check_scenario(tree: Node, report: Report, warn: Report) -> None:
    """Check time, place, names, water and ports.

    Args:
        tree: the scenario file; only what has no errors yet is checked.
        report, warn: called for errors and warnings.
    """
    world, vehicles = tree.at("world").value, tree.at("vehicles").parts
    if world is not None:
        check_time(world, report)
        check_earth(world, report)
        for name, entry in vehicles.items():
            truth = entry.at("truth").value
            if truth is not None:
                check_rate(truth.rate_hz, world.rate_hz, ("vehicles", name, "truth", "rate_hz"), report)
    if "world" in vehicles:
        report(
            ("vehicles", "world"),
            'a vehicle cannot be named "world", as paths of services begin with it: choose another name',
        )
    check_environment(tree.at("environment"), report, warn)
    check_density(tree, report, warn)
    if tree.value is not None:
        _check_ports(tree.value, warn)


def _check_ports(scenario: Scenario, warn: Report) -> None:
    taken: dict[int, str] = {}
    if scenario.server.metrics:
        taken[scenario.server.metrics_port] = "server.metrics_port"
    for name, config in scenario.adapters.items():
        port = getattr(config, "port", 0)
        if not isinstance(port, int) or port == 0:
            continue
        if port in taken:
            warn(
                ("adapters", name, "port"),
                f"{taken[port]} uses port {port} too: unless one is TCP and the other UDP, only one of them can start",
            )
        taken.setdefault(port, f"adapters.{name}")
