"""Checks time and place: rates, the epoch, the clock, and the place of N on the Earth."""

from __future__ import annotations

import math

from msgspec import UNSET

from uwserver.scenario.files.convert import Report
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.world.epoch import instant
from uwserver.scenario.world.tables import WorldTable


def check_rate(rate_hz: float, physics_hz: float, path: KeyPath, report: Report) -> None:
    """Check that a rate is the physics rate over a whole number (to 1e-9), so that samples fall on ticks."""
    ratio = physics_hz / rate_hz
    if math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) <= 1e-9 * max(1.0, ratio):
        return
    if ratio < 1.0:
        report(path, f"{rate_hz:g} Hz is above the physics rate of {physics_hz:g} Hz: use at most {physics_hz:g}")
    elif math.isinf(ratio):
        report(path, f"{rate_hz:g} Hz is far too low")
    else:
        below, above = _neighbours(rate_hz, physics_hz)
        text = f"{rate_hz:g} Hz does not divide the physics rate of {physics_hz:g} Hz"
        report(path, f"{text}: the nearest rates that do are {below:.12g} and {above:.12g}")


def _neighbours(rate_hz: float, physics_hz: float) -> tuple[float, float]:
    """Return the nearest rates below and above that divide the physics rate; whole numbers, as people write them, if there are any."""
    if rate_hz > 1.0 and physics_hz.is_integer():
        whole = [rate for rate in range(1, int(physics_hz) + 1) if physics_hz % rate == 0]
        return max(rate for rate in whole if rate < rate_hz), min(rate for rate in whole if rate > rate_hz)
    ratio = physics_hz / rate_hz
    return physics_hz / math.ceil(ratio), physics_hz / math.floor(ratio)


def check_earth(world: WorldTable, report: Report) -> None:
    """Check that latitude and longitude are given together, and are given if the Earth rotates."""
    if (world.origin_lat_deg is UNSET) != (world.origin_lon_deg is UNSET):
        report(("world",), "only one of origin_lat_deg and origin_lon_deg is given: give both or none")
    elif world.rotating and world.origin is None:
        report(
            ("world", "earth"),
            'a rotating Earth needs the place of N on it: give origin_lat_deg and origin_lon_deg, or set earth = "flat"',
        )


def check_time(world: WorldTable, report: Report) -> None:
    """Check that the epoch is an instant, and that the keys of the clock fit its mode."""
    path: KeyPath = ("world", "epoch_utc")
    try:
        instant(world.epoch_utc)
    except ValueError as error:
        report(path, f'"{world.epoch_utc}" is not an instant: {error}')
    clock = world.clock
    if clock.mode == "lockstep" and not clock.lockstep_clients:
        report(("world", "clock"), 'mode "lockstep" needs lockstep_clients: name the clients that grant each tick')
    if clock.mode != "lockstep" and clock.max_speed is not UNSET:
        report(
            ("world", "clock", "max_speed"),
            'max_speed is for mode "lockstep": remove it, or use speed in mode "realtime"',
        )
    if len(set(clock.lockstep_clients)) < len(clock.lockstep_clients):
        report(("world", "clock", "lockstep_clients"), "a client is named twice: remove one")
