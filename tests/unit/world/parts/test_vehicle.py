"""A vehicle as its reader sees it: live, from the arrays."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from uwserver.world.world import World


def test_every_property_is_read_from_its_own_row_at_the_time_of_asking(make_world: Callable[..., World]) -> None:
    world = make_world(vehicles=2)
    other, vehicle = world.vehicles["rov"], world.vehicles["rov1"]
    before = (other.p_NB, other.q_NB, other.nu)
    half = math.sqrt(0.5)
    world.hydro.state[1] = [1, 2, 3, half, 0, 0, half, 4, 5, 6, 7, 8, 9]
    assert vehicle.p_NB == (1, 2, 3)
    assert vehicle.q_NB == (half, 0, 0, half)
    assert vehicle.nu == (4, 5, 6, 7, 8, 9)
    assert vehicle.pose.rpy == pytest.approx((0.0, 0.0, math.pi / 2))
    assert (other.p_NB, other.q_NB, other.nu) == before
    assert all(type(part) is float for part in (*vehicle.p_NB, *vehicle.q_NB, *vehicle.nu))


def test_the_wrench_is_that_of_its_actuators(make_world: Callable[..., World]) -> None:
    world = make_world(vehicles=2)
    assert np.allclose(world.vehicles["rov1"].wrench, 0.0)
    world.command("rov1/thrusters", u=[0.5] + [0.0] * 7)
    world.step(60)
    assert np.linalg.norm(world.vehicles["rov1"].wrench) > 1.0
    assert np.allclose(world.vehicles["rov"].wrench, 0.0)
