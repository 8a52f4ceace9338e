"""Checks of currents and waves across their keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uwserver.environment.currents import CurrentConfig, ProfileConfig
from uwserver.environment.waves import WavesConfig
from uwserver.scenario.assembly import named
from uwserver.scenario.convert import Report, convert, silent
from uwserver.scenario.errors import KeyPath
from uwserver.scenario.schema import Environment

BREAKING = 1.0 / 16.0
"""Hs over the deep-water length of the peak period, beyond which seas break (IMO's and DNV's limit for the steepest seas is near 1/15)."""


def check_environment(raw: Mapping[str, Any], report: Report, warn: Report) -> None:
    """Depths of profiles; waves that cannot be, or that linear theory does not describe. `raw` is the table `environment`."""
    for name, table in named(raw, "currents").items():
        current = convert(table, CurrentConfig, (), silent)
        if isinstance(current, ProfileConfig):
            _check_profile(current, ("environment", "currents", name), report)
    waves = convert(raw["waves"], WavesConfig, (), silent) if "waves" in raw else None
    if waves is None:
        return
    gravity = raw.get("gravity_mps2", Environment().gravity_mps2)
    path: KeyPath = ("environment", "waves")
    if gravity == 0:
        report(path, "waves need gravity: set environment.gravity_mps2 above 0, or take them out")
    elif isinstance(gravity, int | float) and gravity > 0:
        length = gravity * waves.peak_period_s**2 / (2.0 * math.pi)
        if waves.significant_height_m > BREAKING * length:
            text = f"{waves.significant_height_m:g} m in waves of {length:.3g} m is steeper than 1/16: a real sea would break"
            warn((*path, "significant_height_m"), text)


def _check_profile(profile: ProfileConfig, path: KeyPath, report: Report) -> None:
    depths, velocities = len(profile.depth_m), len(profile.velocity_ned_mps)
    if depths != velocities:
        report((*path, "velocity_ned_mps"), f"has {velocities} velocities for {depths} depths: one a depth is needed")
    for k in range(1, depths):
        if not profile.depth_m[k] > profile.depth_m[k - 1]:
            text = f"{profile.depth_m[k]:g} m does not lie below {profile.depth_m[k - 1]:g} m: the depths must rise"
            report((*path, "depth_m", k), text)
