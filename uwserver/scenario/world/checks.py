"""Checks time and place (rates, the epoch, the clock, and the place of N on the Earth), and water, currents and waves across their keys."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.environment.column import WaterColumn
from uwserver.environment.currents import CurrentConfig, ProfileConfig, UniformConfig, flow_of
from uwserver.environment.waves import WavesConfig
from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.files.errors import KeyPath, not_built
from uwserver.scenario.world.earth import instant
from uwserver.scenario.world.tables import GRAVITY_MPS2, Environment, WorldTable

DENSITY_TOLERANCE = 0.005
"""Relative difference by which density_kgpm3 may lie outside the densities of the water column, so that a rounded density is no error."""
DENSITY_DOUBT = 0.003
"""Relative difference of density that changes how a well trimmed vehicle floats, and so causes a warning."""
STEEPEST = 1.0 / 16.0
"""Ratio of Hs to the deep-water length of the peak period beyond which seas break (the limit of IMO and DNV for the steepest seas is near
1/15)."""


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


# -- water, currents and waves ----------------------------------------------------------------------------------------------------------


def check_density(scenario: Node, report: Report, warn: Report) -> None:
    """Check the one density with which forces act at all depths: the water column must have it somewhere, and should have it where bodies start."""
    environment: Environment | None = scenario.at("environment").value
    if environment is None or isinstance(environment.water, UnsetType) or environment.water.hydrostatics == "uniform":
        return
    column = WaterColumn(environment.water, environment.gravity, environment.density, environment.growth)
    density, least, most = environment.density, column.density.min(), column.density.max()
    given = not isinstance(environment.density_kgpm3, UnsetType)
    path: KeyPath = ("environment", "density_kgpm3" if given else "water")
    if not (1.0 - DENSITY_TOLERANCE) * least <= density <= (1.0 + DENSITY_TOLERANCE) * most:
        text = (
            f"forces would act with {density:g} kg/m3, but the water of environment.water has {least:.1f} to {most:.1f}"
        )
        report(path, f"{text}: remove density_kgpm3, or change the water")
        return
    starts = [
        (p[2], f"{table}.{name}")
        for table in ("vehicles", "objects")
        for name, entry in scenario.at(table).parts.items()
        if (p := entry.at("position_ned_m").value) is not None
    ]
    differences = ((abs(column.density_at(depth) - density), depth, name) for depth, name in starts)
    off, depth, name = max(differences, default=(0.0, 0.0, ""))
    if off > DENSITY_DOUBT * density:
        there = column.density_at(depth)
        text = f"forces act with {density:.1f} kg/m3 at every depth, but at {depth:g} m, where {name} starts, the water has {there:.1f}"
        warn(path, f"{text}: set density_kgpm3 = {there:.1f} if it stays near that depth")


def check_environment(environment: Node, report: Report, warn: Report) -> None:
    """Check the currents, and report waves that are impossible or that linear theory does not describe."""
    for name, current in environment.values("currents").items():
        _check_current(current, ("environment", "currents", name), report)
    waves: WavesConfig | None = environment.at("waves").value
    gravity = environment.parts.get("gravity_mps2", Node(GRAVITY_MPS2)).value
    if waves is None or gravity is None:
        return
    path: KeyPath = ("environment", "waves")
    if gravity == 0:
        report(path, "waves need gravity: set environment.gravity_mps2 above 0, or remove [environment.waves]")
    else:
        length = gravity * waves.peak_period_s**2 / (2.0 * math.pi)
        if waves.significant_height_m > STEEPEST * length:
            warn(
                (*path, "significant_height_m"),
                f"waves {waves.significant_height_m:g} m high and {length:.3g} m long are steeper than 1/16: a real sea would break",
            )


def _check_current(current: CurrentConfig, path: KeyPath, report: Report) -> None:
    try:
        flow = flow_of(current)
        if not isinstance(flow, UniformConfig | ProfileConfig):
            velocity: Any = flow.velocity(0.0, flow.interval_s, None, np.random.default_rng(0))
            if np.shape(velocity) != (3,) or not np.isfinite(velocity).all():
                raise ValueError(f"velocity() must return three finite numbers, not {velocity!r}")
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, not_built(current, error))
        return
    if isinstance(flow, ProfileConfig):
        _check_profile(flow, path, report)


def _check_profile(profile: ProfileConfig, path: KeyPath, report: Report) -> None:
    depths, velocities = len(profile.depth_m), len(profile.velocity_ned_mps)
    if depths != velocities:
        report((*path, "velocity_ned_mps"), f"{velocities} velocities for {depths} depths: give one for each depth")
    for k in range(1, depths):
        if not profile.depth_m[k] > profile.depth_m[k - 1]:
            report(
                (*path, "depth_m", k),
                f"{profile.depth_m[k]:g} m is not below {profile.depth_m[k - 1]:g} m: each depth must be greater than the one before",
            )
