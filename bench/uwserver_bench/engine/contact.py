"""Cost of solid things: of loading a large seabed, of rays on it, of contact geometry near it and far from it, of ticks with contacts, of one
solution of contacts, and of snapshots.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from uwserver.environment.water import Water
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.dynamics.params import BodyParams, rigid_body_inertia
from uwserver.physics.geometry.shapes import ConvexHull, Placed, Solid, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q
from uwserver.scenario.solids.bathymetry import Grid, triangulate
from uwserver.simulation.clock import SystemTime
from uwserver.units import STANDARD_ATMOSPHERE_PA
from uwserver.world.state import snapshot
from uwserver.world.world import World
from uwserver_bench.engine.physics import COMMAND_EVERY, DEPTH_M, RATE_HZ, OpenWater
from uwserver_bench.report import Row

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
RESTING_BARS = {10: 5.0, 100: 0.5}
FAR_BAR = 1.10
SOLVE_BAR_US = 60.0
SNAPSHOT_BAR_MS = 1.0
SETTLE_TICKS = 1200
"""After 5 s the hulls are at rest, except for those on slopes that are too steep for their friction."""


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


def bench_contact(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on contacts.

    Args:
        quick: short repeats, before the hulls are at rest.
        say: gets a line of progress.
    """
    try:
        from uwserver.physics.collision.solids import Solids
    except ImportError as error:
        return [Row("contact", "hulls on a seabed", "x realtime", (), note=f'pip install "uwserver[solid]" ({error})')]
    repeats, budget_s, settle = (2, 0.02, 20) if quick else (7, 0.4, SETTLE_TICKS)
    bed = Solid("seabed", (Placed(seabed_mesh()),))
    rows = []
    for count, bar in RESTING_BARS.items():
        say(f"contact: {count} hulls come to rest")
        with Solids() as solids:
            solids.add_static(bed)
            world = _hulls(solids, count)
            world.step(settle)
            times = tuple(_timed(world.advance, budget_s) for _ in range(repeats))
            held = len(world.hydro.touched.impulse)
        rows.append(
            Row(
                "contact",
                f"{count} hulls at rest on a seabed of 99 458 triangles, 240 Hz",
                "x realtime",
                tuple(1.0 / RATE_HZ / s for s in times),
                bar,
                note=f"{held} contacts",
            )
        )
    say("contact: vehicles far above the seabed")
    with Solids() as solids:
        solids.add_static(bed)
        rows.append(_far_row(solids, repeats, budget_s))
    say("contact: one solve, snapshots")
    rows.append(_solve_row(repeats))
    rows += _snapshot_rows(repeats)
    return rows


def _hull(heavy: float) -> BodyParams:
    """Return a body of the size of a small ROV, which weighs `heavy` newtons in water, with off-diagonal added mass."""
    M_A = np.diag([6.4, 7.1, 18.7, 0.19, 0.14, 0.22])
    M_A[0, 4] = M_A[4, 0] = 0.5
    D, Q = np.diag([20.0, 20.0, 30.0, 1.0, 1.0, 1.0]), np.diag([140.0, 210.0, 190.0, 1.2, 0.5, 1.5])
    return BodyParams(
        rigid_body_inertia(13.5, np.diag([0.26, 0.23, 0.37]), (0.0, 0.0, 0.0)), M_A, D, Q, np.zeros((6, 6)), 132.0 + heavy, 132.0,
        (0.0, 0.0, 0.0), (0.0, 0.0, -0.01),
    )  # fmt: skip


def _hulls(solids: Solids, count: int) -> World:
    """Return a world that contains only hulls of 32 corners, a little above the seabed and 20 m apart."""
    hydro = Hydrodynamics([_hull(20.0)] * count, 1.0 / RATE_HZ)
    shape = Solid("hull", (Placed(ConvexHull(pebble())),))
    hydro.state[:] = states_above(0.35)[:count]
    hydro.state[:, NU:] = 0.0
    for row in range(count):
        solids.add_moving(shape, row)
    hydro.collider = solids
    water = Water(1025.0, 9.81, 10.0, STANDARD_ATMOSPHERE_PA, (0.0, 0.0, 0.0))
    return World("bench", Fraction(round(RATE_HZ)), 1, "2026-01-01T00:00:00Z", hydro, water)


def _far_row(solids: Solids, repeats: int, budget_s: float) -> Row:
    """Measure a hundred vehicles in open water above the seabed, alternately with and without the search for contacts."""
    vehicles = OpenWater(100)
    shape = Solid("hull", (Placed(ConvexHull(pebble())),))
    for row in range(vehicles.vehicles):
        solids.add_moving(shape, row)
    hydro, ratios = vehicles.hydro, []
    for _ in range(repeats):
        seconds = []
        for collider in (None, solids):
            vehicles.prepare()
            hydro.collider = collider
            seconds.append(_timed(lambda: vehicles.run(COMMAND_EVERY), budget_s))
            hydro.collider = None
        ratios.append(seconds[1] / seconds[0])
    name = f"100 vehicles {DEPTH_M:g} m deep, far above a seabed / without one"
    return Row("contact", name, "ratio", tuple(ratios), at_most=FAR_BAR)


class _Same:
    """Returns the same contacts at each call."""

    def __init__(self, contacts: Contacts) -> None:
        self._contacts = contacts

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        """Return the given contacts."""
        return self._contacts


def _solve_row(repeats: int) -> Row:
    """Measure what four contacts add to the tick of a body that slides on them, without the search for contacts."""
    hydro = Hydrodynamics([_hull(20.0)], 1.0 / RATE_HZ)
    start = np.zeros((1, 13))
    start[0, Q], start[0, NU], start[0, NU + 5] = 1.0, 0.4, 0.1
    points = np.array([[x, y, 0.15] for x in (-0.2, 0.2) for y in (-0.15, 0.15)])
    feet = _Same(
        Contacts(
            np.zeros(4, np.int64), np.full(4, -1), points, np.tile([0.0, 0.0, -1.0], (4, 1)), np.zeros(4), np.arange(4), np.full(4, 0.5),
            np.zeros(4),
        )
    )  # fmt: skip

    def tick() -> None:
        hydro.state[:] = start
        hydro.advance(0.0)

    values = []
    for _ in range(repeats + 1):
        seconds = []
        for collider in (None, feet):
            hydro.collider = collider
            tick()
            seconds.append(_timed(tick, 0.05))
        values.append(1e6 * (seconds[1] - seconds[0]))
    name = "4 contacts of one body: trial step, solve with the 6x6 mass, friction, settle"
    return Row("contact", name, "us", tuple(values[1:]), at_most=SOLVE_BAR_US)


def _snapshot_rows(repeats: int) -> list[Row]:
    world = OpenWater(10, sensors=True).world
    world.step(20)
    kept = snapshot.take(world)
    taken = tuple(1e3 * _timed(lambda: snapshot.take(world), 0.02) for _ in range(repeats))
    restored = tuple(1e3 * _timed(lambda: snapshot.restore(world, kept), 0.02) for _ in range(repeats))
    return [
        Row("contact", "snapshot of 10 vehicles with their sensors", "ms", taken, at_most=SNAPSHOT_BAR_MS),
        Row("contact", "restore of 10 vehicles with their sensors", "ms", restored, at_most=SNAPSHOT_BAR_MS),
    ]


def _timed(work: Callable[[], object], budget_s: float) -> float:
    """Return the time of one call, s: the mean over as many calls as fill the budget."""
    clock = SystemTime()
    times, start = 0, clock.now_ns()
    while (clock.now_ns() - start) * 1e-9 < budget_s or times < 3:
        work()
        times += 1
    return (clock.now_ns() - start) * 1e-9 / times
