"""The contact sensor: impulses and places in the frame of the body; a landing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_rig import (
    world_with,
)
from uwserver_bench.proofs.colliders import Floor

from uwserver.frames import conjugate, quat_from_rpy, rotate
from uwserver.physics.collision.contacts import Contacts, Impulses
from uwserver.physics.contact.touching import ROOM
from uwserver.sensors import (
    ContactConfig,
    Pose,
)
from uwserver.sensors.wiring import Wiring


def kept(*touches):
    """Contacts of the last tick: of each the rows of a and b, the point (m) and the impulse on a (N s), both in N."""
    n = len(touches)
    rows, at = np.array([t[:2] for t in touches], np.int64), np.array([t[2:] for t in touches], float)
    a, b, point, impulse = rows[:, 0].copy(), rows[:, 1].copy(), at[:, 0].copy(), at[:, 1].copy()
    return Impulses(Contacts(a, b, point, np.zeros((n, 3)), np.zeros(n), a, np.zeros(n), np.zeros(n)), impulse, impulse)


def told(impulses, row, p, q, config):
    """In plain Python what the body in a row feels, at its place (m) and attitude."""
    to_B, found = conjugate(q), []
    for a, b, point, impulse in zip(*impulses.contacts[:3], impulses.impulse, strict=True):
        if row in (a, b) and math.hypot(*impulse) > config.threshold_Ns:
            mine = 1.0 if a == row else -1.0
            place, push = rotate(to_B, tuple(point - p)), rotate(to_B, tuple(mine * impulse))
            found.append((int(b if a == row else a), place, push, sum(x * x for x in impulse.tolist())))
    found.sort(key=lambda touch: -touch[3])  # by what is not rotated, so that equal ones are equal
    shown, total = found[: config.points], np.sum([touch[2] for touch in found], axis=0) if found else (0.0, 0.0, 0.0)
    missing = (None,) * (3 * (config.points - len(shown)))
    points, pushes = (tuple(x for touch in shown for x in touch[k]) + missing for k in (1, 2))
    return [bool(found), len(found), tuple(total), found[0][0] if found else None, points, pushes]


def check(found, expected):
    assert found[:2] == expected[:2]
    assert found[3] == expected[3]
    for k in (2, 4, 5):
        assert [x is None for x in found[k]] == [x is None for x in expected[k]]
        assert [x for x in found[k] if x is not None] == pytest.approx(
            [x for x in expected[k] if x is not None], rel=1e-12, abs=1e-12
        )


FEW = kept(
    (0, -1, (1.5, 2.0, 5.0), (-1.0, 0.0, 0.0)),
    (2, 0, (1.0, 2.0, 6.0), (0.0, 0.0, 4.0)),
    (1, 2, (7.0, 7.0, 7.0), (9.0, 0.0, 0.0)),  # of others
    (0, 1, (1.0, 1.0, 5.0), (0.0, 0.0, 0.0)),  # too far to push
)


def random_contacts(seed=3, n=60):
    """Of three bodies and what does not move; some are as strong as others, some push nothing."""
    rng = np.random.default_rng(seed)
    a, b = rng.integers(0, 3, n), rng.integers(-1, 3, n)
    impulse = rng.normal(size=(n, 3)) * rng.choice([0.0, 0.1, 3.0], n)[:, None]
    impulse[10:20] = -impulse[:10]
    at = zip(a.tolist(), b.tolist(), rng.normal(0.0, 4.0, (n, 3)), impulse, strict=True)
    return kept(*[touch for touch in at if touch[0] != touch[1]])


@pytest.fixture(scope="module")
def hydro():
    """Of one vehicle in row 0."""
    return world_with().hydro


def alone(hydro, config, scope, impulses, **where):
    """What a sensor on row 0 tells that stands alone, but for these contacts."""
    hydro.touching = hydro.touching.with_room(len(impulses.impulse))
    hydro.touching.keep(impulses)
    return config.build(Pose()).measure(scope(**where, wiring=Wiring(hydro, 0, {}, {})))


def test_contacts_in_the_frame_of_the_body(hydro, scope):
    config, q = ContactConfig(rate_hz=10, points=3), quat_from_rpy(0, 0, math.pi / 2)
    valid, (touching, count, impulse, body, points, impulses) = alone(hydro, config, scope, FEW, q_NB=q)
    assert (valid, touching, count, body) == (True, True, 2, 2)
    assert impulse == pytest.approx((0.0, 1.0, -4.0), abs=1e-12)
    assert points[:6] == pytest.approx((0.0, 0.0, 1.0, 0.0, -0.5, 0.0), abs=1e-12)
    assert impulses[:6] == pytest.approx((0.0, 0.0, -4.0, 0.0, 1.0, 0.0), abs=1e-12)
    assert points[6:] == (None,) * 3


@pytest.mark.parametrize("points", [1, 4, 16])
@pytest.mark.parametrize("threshold_Ns", [0.0, 1.0, 100.0])
def test_the_strongest_are_told_in_their_order(hydro, scope, points, threshold_Ns):
    config, q = ContactConfig(rate_hz=10, points=points, threshold_Ns=threshold_Ns), quat_from_rpy(0.3, -0.2, 2.0)
    impulses = random_contacts()
    valid, found = alone(hydro, config, scope, impulses, q_NB=q)
    expected = told(impulses, 0, np.array(scope().p_NB), q, config)
    assert valid
    assert expected[1] == 0 if threshold_Ns == 100.0 else expected[1] > points or points == 16
    check(found, expected)


def test_nothing_touched(scope):
    valid, values = ContactConfig(rate_hz=10, points=1).build(Pose()).measure(scope())
    assert valid
    assert values == [False, 0, (0.0, 0.0, 0.0), None, (None,) * 3, (None,) * 3]


def test_a_landing_is_felt():
    """At rest on the seabed the contacts carry the weight in water, once a tick."""
    feet = tuple((x, y, 0.12) for x in (-0.2, 0.2) for y in (-0.25, 0.25))
    world = world_with(bump=ContactConfig(rate_hz=240, points=4), depth=-0.5)
    world.hydro.collider = Floor({0: feet})
    world.hydro.bodies["weight"] = 18.0 * 9.81
    world.hydro.state[0, 2] = -0.5  # the floor of the collider is z = 0
    values = [s.value for s in world.step(2400) if s.port == "rov/bump"]
    assert values[0][:2] == (False, 0)
    assert (values[-1][0], values[-1][3]) == (True, -1)
    body = world.hydro.bodies[0]
    total = np.mean([v[2] for v in values[-240:]], axis=0)
    assert total[2] == pytest.approx(-18.0 * 9.81 / 240.0, rel=0.05)
    assert float(body["weight"]) == 18.0 * 9.81
    assert values[-1][4][2] == pytest.approx(0.12, abs=0.02)


def test_it_feels_contacts_wherever_they_lie():
    """There is no room for so many at first, and later another body's are forgotten: then they lie elsewhere."""
    feet = tuple((x, y, 0.12) for x in np.linspace(-0.2, 0.2, 10) for y in np.linspace(-0.25, 0.25, 9))
    config = ContactConfig(rate_hz=240, points=4)
    world = world_with(bump=config, depth=-0.119)
    world.hydro.collider = Floor({0: feet})
    world.hydro.bodies["weight"] = 18.0 * 9.81
    first, most = world.hydro.touching, 0
    for tick in range(240):
        if tick == 120:
            world.hydro.touching = world.hydro.touching.without(5)
        (found,) = (sample.value for sample in world.step() if sample.port == "rov/bump")
        state, touched = world.hydro.state[0], world.hydro.touched
        check(list(found), told(touched, 0, state[:3], tuple(state[3:7]), config))
        most = max(most, found[1])
    assert len(feet) >= most > ROOM
    assert world.hydro.touching is not first
