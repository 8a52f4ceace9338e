"""Compiles every kernel of physics for the record types that worlds use, so that no server has to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from uwserver.physics import entries
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.dynamics.appendage_params import Appendages, PropellerParams, ServoParams
from uwserver.physics.dynamics.params import (
    BodyParams,
    BuoyancyShape,
    ForceTable,
    Lag,
    ThrusterParams,
    rigid_body_inertia,
)
from uwserver.physics.geometry.shapes import Box, HalfSpace, Placed, Solid, Sphere, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import PROFILE_SIZE, SHAPE_BOX, SHAPE_SPHERE, WAVE_SIZE, SeaRows
from uwserver.physics.kernel.team import ALONE
from uwserver.physics.rays.raycast import SURFACE, no_hits

_DT = 0.01
_APPENDAGES = Appendages(
    servos=(ServoParams("shaft", -100.0, 100.0),),
    propellers=(
        PropellerParams("shaft", (-0.5, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1, 1025.0, ((0.0, 0.4, 0.05), (1.0, 0.0, 0.0))),
    ),
)


def check(say: Callable[[str], None] = lambda line: None) -> None:
    """Run each path of the kernels once.

    Args:
        say: is called with a line of progress before each part.

    Raises:
        RuntimeError: a state was not finite: the installation is broken.
    """
    gentle, stiff = Hydrodynamics([_body(1.0)], _DT), Hydrodynamics([_body(1e7)], _DT)
    fitted = Hydrodynamics([_body(1.0), replace(_body(1.0), appendages=_APPENDAGES)], _DT)
    for name, world, depth in (
        ("immersed", gentle, 10.0),
        ("at the surface", gentle, 0.0),
        ("stiff damping", stiff, 10.0),
        ("with appendages", fitted, 10.0),
    ):
        say(f"kernels: {name}")
        world.state[:, 2] = depth
        world.state[:, 7] = 1.0
        failed = world.advance(0.0)
        nu_dot, _ = world.rates_of_change(_DT)
        if failed >= 0 or not np.isfinite(nu_dot).all():
            raise RuntimeError(f"the kernels gave a state that is not finite ({name}): reinstall numpy and numba")
    say("kernels: in contact")
    for world in (gentle, fitted):
        world.collider = _Underfoot()
        if world.advance(0.0) >= 0 or not len(world.touched.impulse):
            raise RuntimeError("the contact kernels gave a state that is not finite: reinstall numpy and numba")
        world.collider = None
    say("kernels: waves")
    gentle.sea, point = _still_sea()
    if gentle.advance(0.0) >= 0 or point.any():
        raise RuntimeError("the kernels gave a sea that moves without waves: reinstall numpy and numba")
    say("kernels: solid things and echoes")
    solid_kernels()
    echo_kernels()


def _still_sea() -> tuple[SeaRows, FloatArray]:
    """Return a sea in which nothing moves, and the water at a point of it."""
    from uwserver.physics.dynamics import flow

    sea, point = SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), np.zeros((0, WAVE_SIZE))), np.empty(flow.POINT_SIZE)
    flow.water_at(sea, 0.0, 0.0, 0.0, 0.0, point)
    return sea, point


def _free(fitted: bool) -> None:
    from uwserver.physics.kernel import sharing

    entries.codes(fitted, False)
    entries.carry()
    entries.find_rates()
    sharing.load(ALONE)


def _sea() -> None:
    world = Hydrodynamics((), _DT)
    world.sea, _ = _still_sea()
    world.fill_flows(0.0)


class _Underfoot:
    """Gives one contact, below the first body."""

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        point = state[:1, :3] + [0.0, 0.0, 0.1]
        row, one = np.zeros(1, np.int64), np.ones(1)
        return Contacts(row, row - 1, point, np.array([[0.0, 0.0, -1.0]]), 0.0 * one, row, 0.5 * one, 0.5 * one)


@cache
def solid_kernels() -> None:
    """Run the kernels of contacts and rays once, so that no tick waits for them. Do nothing without the extra `solid`.

    Raises:
        RuntimeError: they did not find a ball on the ground.
    """
    try:
        from uwserver.physics.collision.solids import Solids
        from uwserver.physics.rays import meeting
        from uwserver.physics.rays.casting import Rays

        solids = Solids()
    except ImportError:
        return

    sheet = TriangleMesh(np.array([[-1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]), np.array([[0, 1, 2]]))
    # The ball overlaps the block, so that the collision engine is used too.
    block = Placed(Box((0.1, 0.1, 0.1)), (-0.5, -0.41, -0.1))
    ground, ball = Solid("ground", (Placed(sheet), Placed(HalfSpace()), block)), Solid("ball", (Placed(Sphere(0.12)),))
    state = np.array([[-0.5, -0.5, -0.1, 1.0, *[0.0] * 9]])
    rays = Rays()
    rays.add_static(0, ground)
    rays.add_moving(1, ball, 0)
    start, down, ray_targets = np.array([[-0.5, -0.5, -1.0]]), np.array([[0.0, 0.0, 1.0]]), no_hits(1)
    hit = rays.at(state).raycast(start, down, 10.0)
    meeting.meet(rays.ray_targets().table, start, down, 10.0, state, np.zeros(0, np.int64), *ray_targets)
    with solids:
        solids.add_static(ground)
        solids.add_moving(ball, 0)
        if len(solids.find_contacts(state, _DT).gap) != 3 or hit.body[0] != 1 or ray_targets.body[0] != 1:
            raise RuntimeError(f"a ball on the ground was not found: reinstall numba and the engine {solids.ways.name}")


@cache
def echo_kernels() -> None:
    """Run the kernels of echo sounders once, so that no reading waits for them.

    Raises:
        RuntimeError: they did not find the surface.
    """
    from uwserver.physics.rays import hits

    down, answer = np.array([[0.0, 0.0, 1.0]]), no_hits(1)
    hits.intersect_level(5.5, -down, 10.0, SURFACE, *answer)
    if answer.distance[0] != 5.5:
        raise RuntimeError("the kernels heard no echo of the surface: reinstall numpy and numba")


def _body(drag: float) -> BodyParams:
    """Return a body with a box, a sphere and a thruster; `drag` scales its damping."""
    table = ForceTable((16.0,), (((-1.0, -30.0), (0.0, 0.0), (1.0, 40.0)),))
    thruster = ThrusterParams("t", (0.1, 0.0, 0.0), (1.0, 0.0, 0.0), table, 16.0, Lag.first_order(0.1), 0.01, 0.1)
    return BodyParams(
        M_RB=rigid_body_inertia(10.0, np.diag([0.2, 0.3, 0.4]), (0.0, 0.0, 0.02)),
        M_A=np.diag([5.0, 8.0, 9.0, 0.1, 0.2, 0.2]),
        D_L=drag * np.eye(6),
        D_Q=drag * np.eye(6),
        D_S=drag * np.eye(6),
        weight=98.1,
        buoyancy=100.0,
        r_g=(0.0, 0.0, 0.02),
        r_b=(0.0, 0.0, 0.0),
        shapes=(
            BuoyancyShape(SHAPE_BOX, (0.0, 0.0, 0.0), (0.2, 0.15, 0.1), 0.008),
            BuoyancyShape(SHAPE_SPHERE, (0.1, 0.0, -0.05), (0.08, 0.08, 0.08), 0.002),
        ),
        thrusters=(thruster,),
    )


COMPILE: dict[str, Callable[[], object]] = {
    "free": lambda: _free(False),
    "fins": lambda: _free(True),
    "contact": lambda: entries.contact_codes(False),
    "fins in contact": lambda: entries.contact_codes(True),
    "sea": _sea,
    "solids": solid_kernels,
    "echoes": echo_kernels,
}
"""Compiles the kernels of each stage, and no others."""
