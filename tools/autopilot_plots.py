"""Draws docs/images/autopilot_*.png: step responses of the built-in autopilot on simulated sensors."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uwserver.scenario.build.world import build
from uwserver.scenario.builder import ScenarioBuilder
from uwserver.scenario.load.scenario import load
from uwserver.units import deg
from uwserver.world import World

IMAGES = Path(__file__).parents[1] / "docs" / "images"
ROVS = ("bluerov2", "bluerov2_heavy", "rexrov")
TORPEDOES = {"remus100": 1.5, "lauv": 1.0, "tethys": 0.9}
CURRENT = (0.15, 0.2, 0.0)
PILOT = "v/autopilot/"
Rows = np.ndarray[Any, np.dtype[np.float64]]


def vehicle(model: str, depth: float, speed: float) -> World:
    """One vehicle in a current over a bottom, with AHRS, DVL and depth sensor, armed."""
    builder = ScenarioBuilder(model, seed=3, adapters={})
    builder.current(velocity_ned_mps=CURRENT)
    builder.seabed("flat", depth_m=50.0)
    start = [0.0, 0.0, depth]
    builder.vehicle(
        "v", model, position_ned_m=start, velocity_frd_mps=[speed, 0.0, 0.0], autopilot={"start_position_ned_m": start}
    )
    builder.sensor("v", "ahrs", "attitude", rate_hz=40, noise_deg=0.05, tilt_sigma_deg=0.3, heading_sigma_deg=0.3)
    builder.sensor("v", "dvl", "dvl", rate_hz=8, processing_s=0.05)
    world = build(load(builder.build(), adapters={}))
    world.step(120)
    world.call(PILOT + "arm")
    return world


def recorded(world: World, seconds: float, steer: Callable[[World], None] | None = None) -> Rows:
    """Time and true pose (7 columns: s, m, rad) at 10 Hz; `steer` is called as often."""
    rows = []
    begun = world.t_ns
    for _ in range(round(10 * seconds)):
        if steer is not None:
            steer(world)
        world.step(24)
        body = world.vehicles["v"]
        rows.append(((world.t_ns - begun) * 1e-9, *body.p_NB, *body.pose.rpy))
    return np.array(rows)


def rovs() -> None:
    """Depth and heading at once, then a place 3 m north and 2 m east, in a current of 0.25 m/s."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    for model in ROVS:
        world = vehicle(model, 5.0, 0.0)
        world.call(PILOT + "set_mode", mode="depth_hold")
        world.command(PILOT + "depth", depth=8.0)
        world.command(PILOT + "heading", heading=1.0)
        rows = recorded(world, 30.0)
        axes[0].plot(rows[:, 0], rows[:, 3], label=model)
        axes[1].plot(rows[:, 0], [deg(yaw) for yaw in rows[:, 6]], label=model)
        world = vehicle(model, 5.0, 0.0)
        world.call(PILOT + "set_mode", mode="position_hold")
        recorded(world, 10.0)
        world.command(PILOT + "position", p_N=[3.0, 2.0, 5.0])
        rows = recorded(world, 40.0)
        axes[2].plot(rows[:, 0], np.hypot(rows[:, 1] - 3.0, rows[:, 2] - 2.0), label=model)
    axes[0].axhline(8.0, color="k", linestyle=":")
    axes[0].invert_yaxis()
    axes[1].axhline(deg(1.0), color="k", linestyle=":")
    for axis, name in zip(axes, ("depth, m", "heading, °", "distance from the place, m"), strict=True):
        axis.set_ylabel(name)
    _save(figure, list(axes), "autopilot_rov.png")


def torpedoes() -> None:
    """Depth and heading at cruising speed, and the track of a mission in a current."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    places = [(150.0, 0.0), (150.0, 100.0), (0.0, 100.0)]
    for model, speed in TORPEDOES.items():
        world = vehicle(model, 10.0, speed)
        world.call(PILOT + "set_mode", mode="velocity")
        world.command(PILOT + "depth", depth=13.0)

        def steer(world: World, speed: float = speed) -> None:
            world.command(PILOT + "velocity", v_B=[speed, 0.0, 0.0], heading=1.0)

        rows = recorded(world, 90.0, steer)
        axes[0].plot(rows[:, 0], rows[:, 3], label=model)
        axes[1].plot(rows[:, 0], [deg(yaw) for yaw in rows[:, 6]], label=model)
        world = vehicle(model, 10.0, speed)
        items = [{"kind": "waypoint", "position_ned_m": [*p, 12.0], "radius_m": 3.0} for p in places]
        world.call(PILOT + "set_mission", items=items)
        world.call(PILOT + "start_mission")
        rows = recorded(world, 420.0 / speed)
        axes[2].plot(rows[:, 2], rows[:, 1], label=model)
    axes[0].axhline(13.0, color="k", linestyle=":")
    axes[0].invert_yaxis()
    axes[1].axhline(deg(1.0), color="k", linestyle=":")
    axes[2].plot(*np.array([(0.0, 0.0), *places]).T[::-1], "k:")
    axes[2].set_aspect("equal")
    axes[2].set_xlabel("east, m")
    for axis, name in zip(axes, ("depth, m", "heading, °", "north, m"), strict=True):
        axis.set_ylabel(name)
    _save(figure, list(axes), "autopilot_torpedo.png")


def _save(figure: Figure, axes: list[Axes], name: str) -> None:
    for axis in axes:
        axis.grid(visible=True, alpha=0.3)
        if not axis.get_xlabel():
            axis.set_xlabel("time, s")
    axes[0].legend(fontsize=8)
    # Without the version of matplotlib in it, the same plot is the same file.
    figure.savefig(IMAGES / name, dpi=90, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    rovs()
    torpedoes()
    sys.exit(0)
