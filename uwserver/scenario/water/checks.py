"""Checks of water, currents and waves across their keys."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from msgspec import UnsetType

from uwserver.environment.column import WaterColumn
from uwserver.environment.currents import CurrentConfig, ProfileConfig, UniformConfig, flow_of
from uwserver.environment.waves import WavesConfig
from uwserver.scenario.files.convert import Node, Report
from uwserver.scenario.files.errors import KeyPath
from uwserver.scenario.files.wording import not_built
from uwserver.scenario.water.tables import GRAVITY_MPS2, Environment

WRONG = 0.005
"""Part by which the density of forces may lie outside of what the water has anywhere: a round number for sea water is no contradiction."""
TELLING = 0.003
"""Part of the density that changes how a well trimmed vehicle floats."""
BREAKING = 1.0 / 16.0
"""Hs over the deep-water length of the peak period, beyond which seas break (IMO's and DNV's limit for the steepest seas is near 1/15)."""


_EARTHLY = Node(GRAVITY_MPS2)


def check_density(scenario: Node, report: Report, warn: Report) -> None:
    """Forces act with one density at all depths: it must be one that the water over depth can have, and should be that where bodies start."""
    environment: Environment | None = scenario.at("environment").value
    if environment is None or isinstance(environment.water, UnsetType) or environment.water.hydrostatics == "uniform":
        return
    column = WaterColumn(environment.water, environment.gravity, environment.density, environment.growth)
    density, least, most = environment.density, column.density.min(), column.density.max()
    given = not isinstance(environment.density_kgpm3, UnsetType)
    path: KeyPath = ("environment", "density_kgpm3" if given else "water")
    if not (1.0 - WRONG) * least <= density <= (1.0 + WRONG) * most:
        has = f"the water of environment.water has {least:.1f} to {most:.1f}"
        text = f"forces would act with {density:g} kg/m3, but {has}"
        report(path, f"{text}: leave density_kgpm3 out, or change the water")
        return
    starts = [
        (p[2], f"{table}.{name}")
        for table in ("vehicles", "objects")
        for name, entry in scenario.at(table).parts.items()
        if (p := entry.at("position_ned_m").value) is not None
    ]
    differences = ((abs(column.density_at(depth) - density), depth, name) for depth, name in starts)
    off, depth, name = max(differences, default=(0.0, 0.0, ""))
    if off > TELLING * density:
        there = column.density_at(depth)
        text = f"forces act with {density:.1f} kg/m3 at every depth, but at {depth:g} m, where {name} starts, the water has {there:.1f}"
        warn(path, f"{text}: set density_kgpm3 = {there:.1f} if that is where it works")


def check_environment(environment: Node, report: Report, warn: Report) -> None:
    """Depths of profiles; waves that cannot be, or that linear theory does not describe."""
    for name, current in environment.values("currents").items():
        _check_current(current, ("environment", "currents", name), report)
    waves: WavesConfig | None = environment.at("waves").value
    gravity = environment.parts.get("gravity_mps2", _EARTHLY).value
    if waves is None or gravity is None:
        return
    path: KeyPath = ("environment", "waves")
    if gravity == 0:
        report(path, "waves need gravity: set environment.gravity_mps2 above 0, or take them out")
    else:
        length = gravity * waves.peak_period_s**2 / (2.0 * math.pi)
        if waves.significant_height_m > BREAKING * length:
            text = f"{waves.significant_height_m:g} m in waves of {length:.3g} m is steeper than 1/16: a real sea would break"
            warn((*path, "significant_height_m"), text)


def _check_current(current: CurrentConfig, path: KeyPath, report: Report) -> None:
    try:
        flow = flow_of(current)
        if not isinstance(flow, UniformConfig | ProfileConfig):
            _check_velocity(flow.velocity(0.0, flow.interval_s, None, np.random.default_rng(0)))
    except Exception as error:  # noqa: BLE001 - code of the user may fail in any way
        report(path, not_built(current, error))
        return
    if isinstance(flow, ProfileConfig):
        _check_profile(flow, path, report)


def _check_velocity(velocity: Any) -> None:
    if np.shape(velocity) != (3,) or not np.isfinite(velocity).all():
        raise ValueError(f"velocity() must give three finite numbers, not {velocity!r}")


def _check_profile(profile: ProfileConfig, path: KeyPath, report: Report) -> None:
    depths, velocities = len(profile.depth_m), len(profile.velocity_ned_mps)
    if depths != velocities:
        report((*path, "velocity_ned_mps"), f"has {velocities} velocities for {depths} depths: one a depth is needed")
    for k in range(1, depths):
        if not profile.depth_m[k] > profile.depth_m[k - 1]:
            text = f"{profile.depth_m[k]:g} m does not lie below {profile.depth_m[k - 1]:g} m: the depths must rise"
            report((*path, "depth_m", k), text)
