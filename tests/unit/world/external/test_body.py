"""Bodies that follow poses, without a world: where they stand, and where they are when nobody knows."""

from __future__ import annotations

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import NOWHERE_M
from uwserver.world.external.body import External, is_nowhere, led_params
from uwserver.world.external.track import TrackPose


class Told:
    """A source that says what the test says."""

    pose: TrackPose | None = None

    def at(self, t_ns: int) -> TrackPose | None:
        return self.pose

    def age_s(self, t_ns: int) -> float | None:
        return None

    def count(self, t_ns: int) -> int:
        return 0


POSE = TrackPose((1.0, 2.0, 3.0), (0.0, 1.0, 0.0, 0.0), (1.0, 0, 0, 0, 0, 0.5), 0.0)


def external(ghost: bool) -> tuple[External, Hydrodynamics, Told]:
    hydro, told = Hydrodynamics((led_params(), led_params()), 0.01), Told()
    return External("x", hydro, 1, told, ghost), hydro, told


def test_it_stands_where_its_source_says():
    part, hydro, told = external(ghost=False)
    told.pose = POSE
    part.after(1, 10, [])
    assert hydro.state[1].tolist() == [1, 2, 3, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0.5]
    assert hydro.bodies["retired"].tolist() == [0, 0]
    assert (hydro.state[0, :3] == 0.0).all()


def test_nobody_meets_it_where_it_is_when_nobody_knows():
    part, hydro, told = external(ghost=False)
    told.pose = POSE
    part.follow_source(0)
    told.pose = None
    part.follow_source(10)
    assert is_nowhere(tuple(hydro.state[1, :3]))
    assert hydro.state[1, 2] < -NOWHERE_M
    assert (hydro.state[1, 7:] == 0.0).all()
    other = External("y", hydro, 0, told, False)
    other.follow_source(10)
    assert np.linalg.norm(hydro.state[1, :3] - hydro.state[0, :3]) >= 1e3
    told.pose = POSE
    part.follow_source(20)
    assert not is_nowhere(tuple(hydro.state[1, :3]))
    assert hydro.bodies["retired"][1] == 0


def test_the_kernel_moves_no_ghost():
    part, hydro, told = external(ghost=True)
    told.pose = POSE
    part.follow_source(0)
    before = hydro.state[1].copy()
    hydro.advance(0.0)
    assert (hydro.state[1] == before).all()


def test_within_a_tick_a_solid_one_goes_on_at_its_velocity():
    part, hydro, told = external(ghost=False)
    told.pose = POSE._replace(q_NB=(1.0, 0.0, 0.0, 0.0), nu=(1.0, 0, 0, 0, 0, 0))
    part.follow_source(0)
    hydro.advance(0.0)
    assert np.allclose(hydro.state[1, :3], [1.01, 2.0, 3.0], atol=1e-12)
