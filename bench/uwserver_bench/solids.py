"""Solid things: loading a large seabed, rays on it, and the cost of contact geometry near it and far from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from uwserver.physics.geometry.shapes import ConvexHull, Placed, Solid, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.solids.bathymetry import Grid, triangulate
from uwserver.simulation.clock import SystemTime
from uwserver_bench.rows import Row

if TYPE_CHECKING:
    from uwserver.physics.collision.solids import Solids
    from uwserver.physics.rays.casting import Rays

POINTS = 224
"""Points along an edge of the seabed. It has 99 458 triangles of 2 m."""
DT = 1.0 / 240.0
BODIES = 100
RAYS = 10_000
GATE_BAR_US = 20.0
LOAD_BAR_S = 2.0
RAYS_BAR = 1.5


def bench_solids(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on solid things.

    Args:
        quick: two short repeats.
        say: gets a line of progress.
    """
    try:
        from uwserver.physics.collision.solids import Solids
        from uwserver.physics.rays.casting import Rays
    except ImportError as error:
        return [Row("solids", "seabed and rays", "s", (), note=f'pip install "uwserver[solid]" ({error})')]
    repeats, times = (2, 2) if quick else (7, 50)
    seabed = Solid("seabed", (Placed(seabed_mesh()),))
    hull = Solid("hull", (Placed(ConvexHull(pebble())),))
    rows: dict[str, list[float]] = {"load": [], "rays": [], "far": [], "resting": []}
    for repeat in range(-1, repeats):  # the first one compiles
        say(f"solids: repeat {repeat + 1} of {repeats}")
        with Solids() as solids:
            found = _repeat(solids, Rays(), seabed, hull, 1 if repeat < 0 else times)
        if repeat >= 0:
            for name, value in found.items():
                rows[name].append(value)
    return [
        Row(
            "solids",
            "load a seabed of 99 458 triangles for contact and rays",
            "s",
            tuple(rows["load"]),
            at_most=LOAD_BAR_S,
        ),
        Row("solids", f"{RAYS} rays on it, exact range and normal", "M/s", tuple(rows["rays"]), at_least=RAYS_BAR),
        Row(
            "solids",
            f"{BODIES} hulls 20 m above it: search for contacts",
            "us",
            tuple(rows["far"]),
            at_most=GATE_BAR_US,
        ),
        Row("solids", f"{BODIES} hulls on it: search for contacts", "us", tuple(rows["resting"])),
    ]


def _repeat(solids: Solids, rays: Rays, seabed: Solid, hull: Solid, times: int) -> dict[str, float]:
    """Return one figure for each row."""
    far, resting = states_above(20.0), states_above(0.2)
    origin, direction = np.tile([0.0, 0.0, -20.0], (RAYS, 1)), _down()
    look = rays.at(far)

    def load() -> None:
        solids.add_static(seabed)
        rays.add_static(0, seabed)
        look.raycast(origin[:1], direction[:1], 100.0)

    figures = {
        "load": _seconds(load, 1),
        "rays": 1e-6 * RAYS / _seconds(lambda: look.raycast(origin, direction, 100.0), times),
    }
    for row in range(BODIES):
        solids.add_moving(hull, row)
    figures["far"] = 1e6 * _seconds(lambda: solids.find_contacts(far, DT), 10 * times)
    figures["resting"] = 1e6 * _seconds(lambda: solids.find_contacts(resting, DT), times)
    return figures


def _depth(north: FloatArray, east: FloatArray) -> FloatArray:
    depth: FloatArray = 3.0 * np.sin(north / 20.0) + 3.0 * np.cos(east / 17.0)
    return depth


def seabed_mesh() -> TriangleMesh:
    """Return a seabed with waves of 3 m, in a square of 446 m."""
    axis = 2.0 * (np.arange(POINTS) - 0.5 * (POINTS - 1))
    north, east = np.meshgrid(axis, axis, indexing="ij")
    (mesh,) = triangulate(Grid(north, east, _depth(north, east)))
    return mesh


def pebble() -> FloatArray:
    """Return the 32 corners of an egg-shaped hull."""
    points = np.random.Generator(np.random.PCG64(1)).normal(size=(32, 3))
    egg: FloatArray = points / np.linalg.norm(points, axis=1)[:, None] * [0.3, 0.25, 0.2]
    return egg


def _down() -> FloatArray:
    d = np.random.Generator(np.random.PCG64(2)).normal(size=(RAYS, 3))
    d[:, 2] = np.abs(d[:, 2])
    unit: FloatArray = d / np.linalg.norm(d, axis=1)[:, None]
    return unit


def states_above(above: float) -> FloatArray:
    """Return the states of bodies that move slowly, 20 m apart and `above` (m) over the seabed."""
    state = np.zeros((BODIES, 13))
    k = np.arange(BODIES)
    state[:, 0], state[:, 1] = 20.0 * (k % 10) - 100.0, 20.0 * (k // 10) - 100.0
    state[:, 2] = _depth(state[:, 0], state[:, 1]) - above
    state[:, 3], state[:, 7] = 1.0, 0.5
    return state


def _seconds(work: Callable[[], object], times: int) -> float:
    clock = SystemTime()
    start = clock.now_ns()
    for _ in range(times):
        work()
    return (clock.now_ns() - start) * 1e-9 / times
