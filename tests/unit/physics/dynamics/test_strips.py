"""The water along a hull as its strips see it."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.environment.water import Sea
from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.dynamics.scratch import DU_DT, NU, STATE, STREAM, STREAM_RATE, WATER
from uwserver.physics.dynamics.strips import along_hull, mount_velocity
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import PROFILE_SIZE, SeaRows

ZERO = np.zeros((6, 6))
R_B = (0.3, -0.1, 0.2)
BODY = BodyParams(np.eye(6), ZERO, ZERO, ZERO, ZERO, 10.0, 10.0, (0.0,) * 3, R_B, length=4.0)
K = 0.7
WAVE = SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), np.array([[K, 0.0, K, 2.6, 0.3, 0.4, np.inf]]))
STILL = SeaRows(np.zeros(7), np.zeros((0, PROFILE_SIZE)), np.zeros((0, 7)))


def seen(hydro: Hydrodynamics, x: FloatArray, t: float) -> FloatArray:
    """The work rows of body 0 in a state, from the water of its strips as it stands."""
    w = hydro.scratch[0]
    w["s"][STATE], w["work"][NU], w["R"] = x, x[7:], matrix(tuple(x[3:7]))
    along_hull(hydro.bodies[0], hydro.strips, w["s"], STATE, t, hydro.flows[0], w["R"], w["work"])
    return w["work"].copy()


def state(*nu: float) -> FloatArray:
    return np.array([1.0, 2.0, 3.0, *quat_from_rpy(0.3, -0.2, 0.5), *nu])


def afloat(x: FloatArray, sea: SeaRows = WAVE, t: float = 0.0) -> Hydrodynamics:
    hydro = Hydrodynamics([BODY], 0.01)
    hydro.sea = sea
    hydro.state[0] = x
    hydro.fill_flows(t)
    return hydro


def test_there_are_strips_only_where_there_are_waves() -> None:
    """In whichever order bodies and sea come."""
    hydro = Hydrodynamics([BODY], 0.01)
    assert (len(hydro.strips), hydro.bodies["strip_count"][0]) == (0, 0)
    hydro.sea = STILL
    assert len(hydro.strips) == 0
    hydro.sea = WAVE
    n = len(hydro.strips)
    assert n > 2
    hydro.add(BODY)
    assert hydro.bodies["strip_first"].tolist() == [0, n]
    assert hydro.bodies["strip_count"].tolist() == [n, n]
    np.testing.assert_array_equal(hydro.strips["r"][n:], hydro.strips["r"][:n])
    hydro.sea = None
    assert (len(hydro.strips), hydro.bodies["strip_count"].tolist()) == (0, [0, 0])


def test_water_that_moves_as_one_is_no_turning() -> None:
    sea = WAVE._replace(uniform=np.array([0.4, -0.3, 0.2, 0.05, 0.0, -0.02, 0.0]))
    flat = sea._replace(waves=WAVE.waves * np.array([1, 1, 1, 1, 0, 1, 1]))
    x = state(0.5, 0.1, -0.2, 0.3, -0.4, 0.2)
    work = seen(afloat(x, flat), x, 0.0)
    R = np.array(matrix(tuple(x[3:7])))
    u = R.T @ [0.4, -0.3, 0.2]
    np.testing.assert_allclose(work[STREAM], [*u, 0.0, 0.0, 0.0], atol=1e-12)
    expected = R.T @ [0.05, 0.0, -0.02] - np.cross(x[10:], u)
    np.testing.assert_allclose(work[STREAM_RATE], [*expected, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(work[DU_DT, :3], [0.05, 0.0, -0.02], atol=1e-12)


def test_the_motion_of_the_water_is_the_best_rigid_one() -> None:
    """Against sums over a fine division of the hull; about the origin, though the middle of the hull is elsewhere."""
    x = state(0.5, 0.1, -0.2, 0.3, -0.4, 0.2)
    work, water, R = seen(afloat(x), x, 0.0), Sea(WAVE), np.array(matrix(tuple(x[3:7])))
    xi = (np.arange(2000) + 0.5) / 1000.0 - 1.0
    r = np.array(R_B) + np.outer(2.0 * xi, [1.0, 0.0, 0.0])
    u = np.array([R.T @ water.velocity(tuple(x[:3] + R @ each), 0.0) for each in r])
    mean, offset = u.mean(axis=0), r - R_B
    turn = np.cross(offset, u).mean(axis=0) / (16.0 / 12.0)
    # the rule is right within 2e-3 of the velocity
    np.testing.assert_allclose(work[STREAM, 3:], turn, atol=2e-3)
    np.testing.assert_allclose(work[STREAM, :3], mean - np.cross(turn, R_B), atol=2e-3)
    np.testing.assert_allclose(work[WATER, :3], R @ mean, atol=2e-3)
    assert np.abs(turn).max() > 0.02


def test_the_rate_is_the_derivative_of_the_motion_in_the_turning_frame() -> None:
    """Against differences along the path; the water stands as it was found, linear in place and time about there."""
    nu, h = (0.5, 0.1, -0.2, 0.3, -0.4, 0.2), 1e-4
    x = state(*nu)
    hydro = afloat(x)
    ends = []
    for sign in (-1.0, 1.0):
        moved, R = x.copy(), np.array(matrix(tuple(x[3:7])))
        moved[:3] += sign * h * R @ nu[:3]
        w, a, b, c = x[3:7]
        T = 0.5 * np.array([[-a, -b, -c], [w, -c, b], [c, w, -a], [-b, a, w]])
        moved[3:7] += sign * h * T @ nu[3:]
        moved[3:7] /= np.linalg.norm(moved[3:7])
        ends.append(seen(hydro, moved, sign * h)[STREAM])
    np.testing.assert_allclose(seen(hydro, x, 0.0)[STREAM_RATE], (ends[1] - ends[0]) / (2 * h), atol=1e-6)


@pytest.mark.parametrize(
    ("r", "error"),
    [((0.3, -0.1, 0.2), 1e-12), ((-1.7, -0.1, 0.2), 5e-3), ((1.9, -0.1, 0.2), 5e-3), ((2.6, -0.1, 0.2), 0.03),
     ((-1.5, 0.1, 0.4), 0.04)],
    ids=["strip", "stern", "within", "beyond the bow", "off the axis"],
)  # fmt: skip
def test_a_mount_takes_the_water_of_its_place(r: tuple[float, float, float], error: float) -> None:
    x = state(0.5, 0.1, -0.2, 0.3, -0.4, 0.2)
    hydro = afloat(x)
    seen(hydro, x, 0.0)
    w, R = hydro.scratch[0], np.array(matrix(tuple(x[3:7])))
    u = np.array(Sea(WAVE).velocity(tuple(x[:3] + R @ r), 0.0))
    expected = x[7:10] + np.cross(x[10:], r) - R.T @ u
    found = mount_velocity(hydro.bodies[0], hydro.strips, *r, w["R"], w["work"])
    np.testing.assert_allclose(found, expected, atol=error * np.linalg.norm(u) + 1e-9)
