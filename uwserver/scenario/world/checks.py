"""Checks of time and place: rates, the epoch, the clock, and where N lies."""

from __future__ import annotations

import math

from msgspec import UNSET

from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.world.epoch import instant
from uwserver.scenario.world.tables import WorldTable


def check_rate(rate_hz: float, physics_hz: float, path: KeyPath, report: Report) -> None:
    """A rate must be the physics rate over a whole number (to 1e-9), so that samples fall on ticks."""
    ratio = physics_hz / rate_hz
    if math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) <= 1e-9 * max(1.0, ratio):
        return
    if ratio < 1.0:
        report(path, f"{rate_hz:g} Hz is above the physics rate of {physics_hz:g} Hz: use at most {physics_hz:g}")
        return
    nearest = "it is far too low"
    if math.isfinite(ratio):
        below, above = _neighbours(rate_hz, physics_hz)
        nearest = f"the nearest that do are {below:.12g} and {above:.12g}"
    report(path, f"{rate_hz:g} Hz does not divide the physics rate of {physics_hz:g} Hz: {nearest}")


def _neighbours(rate_hz: float, physics_hz: float) -> tuple[float, float]:
    """The nearest rates below and above that divide the physics rate: whole numbers, as people write them, where there are some."""
    if rate_hz > 1.0 and physics_hz.is_integer():
        whole = [rate for rate in range(1, int(physics_hz) + 1) if physics_hz % rate == 0]
        return max(rate for rate in whole if rate < rate_hz), min(rate for rate in whole if rate > rate_hz)
    ratio = physics_hz / rate_hz
    return physics_hz / math.ceil(ratio), physics_hz / math.floor(ratio)


def check_earth(world: WorldTable, report: Report) -> None:
    """The place is whole, and what turns has one."""
    if (world.origin_lat_deg is UNSET) != (world.origin_lon_deg is UNSET):
        report(("world",), "give origin_lat_deg and origin_lon_deg, or none of the two")
    elif world.rotating and world.origin is None:
        text = 'an Earth that turns needs a place on it: give origin_lat_deg and origin_lon_deg, or earth = "flat"'
        report(("world", "earth"), text)


def check_time(world: WorldTable, report: Report) -> None:
    """The epoch is an instant, and the clock's keys fit its mode."""
    path: KeyPath = ("world", "epoch_utc")
    try:
        instant(world.epoch_utc)
    except ValueError as error:
        report(path, f'"{world.epoch_utc}" is no instant: {error}')
    clock = world.clock
    if clock.mode == "lockstep" and not clock.lockstep_clients:
        text = 'mode "lockstep" needs lockstep_clients, the names of the clients that grant each tick'
        report(("world", "clock"), text)
    if clock.mode != "lockstep" and clock.max_speed is not UNSET:
        report(("world", "clock", "max_speed"), f'max_speed is for mode "lockstep"; mode "{clock.mode}" has speed')
    if len(set(clock.lockstep_clients)) < len(clock.lockstep_clients):
        report(("world", "clock", "lockstep_clients"), "a client is named twice")
