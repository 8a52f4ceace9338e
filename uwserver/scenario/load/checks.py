"""Checks of a scenario as a whole that no single key can show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uwserver.scenario.files.convert import Report, convert, silent
from uwserver.scenario.files.merge import named
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.water.checks import check_density, check_environment
from uwserver.scenario.world.checks import check_rate, check_time
from uwserver.scenario.world.tables import WorldTable
from uwserver.sensors.truth import Truth


def check_scenario(
    raw: Mapping[str, Any], scenario: Scenario | None, world: WorldTable | None, report: Report, warn: Report
) -> None:
    """Time, names and ports.

    Args:
        raw: the file.
        scenario: None where the file has faults; then only what could be read is checked.
        world: its table `world`, likewise.
        report, warn: take in faults and warnings.
    """
    if world is not None:
        check_time(world, report)
        for name, entry in named(raw, "vehicles").items():
            truth = convert(entry.get("truth"), Truth, (), silent) if isinstance(entry, dict) else None
            if truth is not None:
                check_rate(truth.rate_hz, world.rate_hz, ("vehicles", name, "truth", "rate_hz"), report)
    if "world" in named(raw, "vehicles"):
        report(
            ("vehicles", "world"), '"world" cannot name a vehicle: the paths of the world\'s own services begin with it'
        )
    check_environment(named(raw, "environment"), report, warn)
    check_density(raw, report, warn)
    if scenario is not None:
        _check_ports(scenario, warn)


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
                f"{taken[port]} uses port {port} too: unless one is TCP and one UDP, one of them cannot start",
            )
        taken.setdefault(port, f"adapters.{name}")
