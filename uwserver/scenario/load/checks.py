"""Checks of a scenario as a whole that no single key can show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from msgspec import UNSET

from uwserver.scenario.files.convert import Report, convert, silent
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.load.tables import Scenario, WorldTable
from uwserver.scenario.vehicle.assembly import named
from uwserver.scenario.water.checks import check_density, check_environment
from uwserver.scenario.world.epoch import instant
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
        _check_time(world, report)
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


def check_rate(rate_hz: float, physics_hz: float, path: KeyPath, report: Report) -> None:
    """A rate must be the physics rate over a whole number (to 1e-9), so that samples fall on ticks."""
    ratio = physics_hz / rate_hz
    if math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) <= 1e-9 * max(1.0, ratio):
        return
    if ratio < 1.0:
        report(path, f"{rate_hz:g} Hz is above the physics rate of {physics_hz:g} Hz: use at most {physics_hz:g}")
        return
    nearest = (
        f"the nearest that do are {physics_hz / math.ceil(ratio):.12g} and {physics_hz / math.floor(ratio):.12g}"
        if math.isfinite(ratio)
        else "it is far too low"
    )
    report(path, f"{rate_hz:g} Hz does not divide the physics rate of {physics_hz:g} Hz: {nearest}")


def _check_time(world: WorldTable, report: Report) -> None:
    path: KeyPath = ("world", "epoch_utc")
    try:
        instant(world.epoch_utc)
    except ValueError as error:
        report(path, f'"{world.epoch_utc}" is no instant: {error}')
    clock = world.clock
    if clock.mode == "lockstep" and not clock.lockstep_clients:
        report(
            ("world", "clock"), 'mode "lockstep" needs lockstep_clients, the names of the clients that grant each tick'
        )
    if clock.mode != "lockstep" and clock.max_speed is not UNSET:
        report(("world", "clock", "max_speed"), f'max_speed is for mode "lockstep"; mode "{clock.mode}" has speed')
    if len(set(clock.lockstep_clients)) < len(clock.lockstep_clients):
        report(("world", "clock", "lockstep_clients"), "a client is named twice")


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
