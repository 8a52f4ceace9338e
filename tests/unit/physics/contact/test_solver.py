"""Islands of bodies that touch; Jacobians against differences; and the laws that impulses must satisfy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.contact.solver import (
    J_A,
    J_B,
    MAX_SWEEPS,
    R_A,
    Constraints,
    add_response,
    fill_slots,
    find_islands,
    relative_velocity,
    set_axes,
    set_gains,
    set_jacobians,
    set_responses,
    solve_island,
)
from uwserver.physics.kernel.arrays import FloatArray, IntArray

RNG = np.random.default_rng(11)
NORMALS = [*np.eye(3), *-np.eye(3), *(v / np.linalg.norm(v) for v in RNG.normal(size=(10, 3)))]


@pytest.mark.parametrize("normal", NORMALS)
def test_axes_are_a_right_handed_frame_of_the_normal(normal: FloatArray) -> None:
    axes = np.empty((3, 3))
    set_axes(normal, axes)
    np.testing.assert_array_equal(axes[0], normal)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), rtol=0.0, atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def rows_of(k: int, slot_a: list[int], slot_b: list[int]) -> Constraints:
    return Constraints(
        np.array(slot_a, np.int64), np.array(slot_b, np.int64), np.arange(k), np.array([0, k]),
        np.empty((k, 3, 3)), np.zeros((k, 4, 3, 6)), np.empty((k, 2)),
    )  # fmt: skip


def inertia(seed: int) -> FloatArray:
    """An inverse inertia (6, 6) with every coupling."""
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return np.linalg.inv(root @ root.T + 3.0 * np.eye(6))


def problem(
    seed: int, k: int = 3, mu: float = 0.5, two: bool = True
) -> tuple[Constraints, FloatArray, FloatArray, FloatArray]:
    """Contacts between two bodies (or one and the ground), their states, inverse inertias, and w before any impulse."""
    rng = np.random.default_rng(seed)
    constraints = rows_of(k, [0] * k, [1 if two else -1] * k)
    state = rng.normal(size=(2, 13))
    state[:, 3:7] = [quat_from_rpy(*angles) for angles in rng.uniform(-1.0, 1.0, (2, 3))]
    points = rng.normal(size=(k, 3))
    for c in range(k):
        normal = [0.0, 0.0, 1.0] + 0.2 * rng.normal(size=3)  # of one side, so that the bodies are not jammed
        set_axes(normal / np.linalg.norm(normal), constraints.axes[c])
    M_inv = np.array([inertia(seed), inertia(seed + 1)])
    set_jacobians(constraints, state, points, constraints.rows, np.empty((3, 3)))
    set_responses(constraints, M_inv)
    nu = state[:, 7:].copy()
    w = np.array(
        [[relative_velocity(constraints.rows, c, d, nu, 0, 1 if two else -1) for d in range(3)] for c in range(k)]
    )
    return constraints, state, M_inv, w


def test_a_jacobian_gives_the_velocity_of_the_point_along_the_axes() -> None:
    constraints, state, _, w = problem(1)
    rng = np.random.default_rng(1)  # the same draws again
    rng.normal(size=(2, 13))
    rng.uniform(-1.0, 1.0, (2, 3))
    points = rng.normal(size=(3, 3))
    for c in range(3):
        v = []
        for body in state:
            R = np.array(matrix(body[3:7]))
            v.append(R @ (body[7:10] + np.cross(body[10:], R.T @ (points[c] - body[:3]))))
        np.testing.assert_allclose(w[c], constraints.axes[c] @ (v[0] - v[1]), rtol=0.0, atol=1e-12)


def test_a_response_is_the_change_of_velocity_by_a_unit_impulse() -> None:
    constraints, _, M_inv, _ = problem(2)
    change, impulse = np.zeros((2, 6)), np.array([1.0, -2.0, 3.0])
    add_response(constraints.rows, 1, impulse, 0, 1, change)
    for body, block in ((0, J_A), (1, J_B)):
        np.testing.assert_allclose(
            change[body], M_inv[body] @ (impulse @ constraints.rows[1, block]), rtol=0.0, atol=1e-13
        )


def test_gains_are_the_inverse_of_what_a_unit_impulse_does() -> None:
    constraints, _, _, _ = problem(3, two=False)
    rows, gains = constraints.rows, np.empty(2)
    set_gains(rows, 0, False, gains)
    A = rows[0, J_A] @ rows[0, R_A].T
    assert gains[0] == pytest.approx(1.0 / A[0, 0])
    assert gains[1] == pytest.approx(1.0 / np.linalg.eigvalsh(A[1:, 1:])[-1])


@pytest.mark.parametrize("two", [False, True])
@pytest.mark.parametrize("mu", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("seed", range(6))
def test_the_solution_satisfies_signorini_and_coulomb(seed: int, mu: float, two: bool) -> None:
    constraints, _, _, w = problem(seed, two=two)
    w[0, 0] = -1.0  # at least one is hit
    impulse, change = np.zeros((3, 3)), np.zeros((2, 6))
    sweeps = solve_island(constraints, 0, w, np.full(3, mu), np.zeros(3, np.bool_), impulse, change)
    assert sweeps < MAX_SWEEPS
    assert impulse[:, 0].max() > 0.0
    b = 1 if two else -1
    for c in range(3):
        after = w[c] + [relative_velocity(constraints.rows, c, d, change, 0, b) for d in range(3)]
        assert impulse[c, 0] >= 0.0
        assert after[0] >= -1e-8
        assert abs(impulse[c, 0] * after[0]) < 1e-8
        size, speed = math.hypot(*impulse[c, 1:]), math.hypot(*after[1:])
        assert size <= mu * impulse[c, 0] + 1e-9
        if size < mu * impulse[c, 0] - 1e-6:
            assert speed < 1e-7  # it sticks
        elif mu > 0.0 and impulse[c, 0] > 1e-6 and speed > 1e-6:
            np.testing.assert_allclose(impulse[c, 1:] / size, -after[1:] / speed, rtol=0.0, atol=1e-4)  # it slides
    expected = np.zeros((2, 6))
    for c in range(3):
        add_response(constraints.rows, c, impulse[c], 0, b, expected)
    np.testing.assert_allclose(change, expected, rtol=0.0, atol=1e-9)


def test_separating_contacts_get_no_impulse() -> None:
    constraints, _, _, w = problem(4)
    w[:, 0] = 1.0
    impulse, change = np.zeros((3, 3)), np.zeros((2, 6))
    assert solve_island(constraints, 0, w, np.full(3, 0.5), np.zeros(3, np.bool_), impulse, change) == 1
    assert not impulse.any()
    assert not change.any()


def test_frozen_contacts_stay_as_they_are() -> None:
    constraints, _, _, w = problem(5)
    w[:, 0] = -1.0
    impulse, change = np.zeros((3, 3)), np.zeros((2, 6))
    impulse[1] = 0.5, 0.1, 0.0
    solve_island(constraints, 0, w, np.full(3, 0.5), np.array([False, True, False]), impulse, change)
    assert impulse[1].tolist() == [0.5, 0.1, 0.0]
    assert impulse[[0, 2], 0].max() > 0.0


def test_an_island_is_solved_and_others_are_left() -> None:
    constraints = problem(6)[0]._replace(bounds=np.array([0, 1, 3]))
    impulse, change, w = np.zeros((3, 3)), np.zeros((2, 6)), np.full((3, 3), -1.0)
    solve_island(constraints, 1, w, np.zeros(3), np.zeros(3, np.bool_), impulse, change)
    assert not impulse[0].any()
    assert impulse[1:, 0].max() > 0.0


def test_a_warm_start_with_the_solution_is_done_in_one_sweep() -> None:
    constraints, _, _, w = problem(1, two=False)
    w[:, 0] = -1.0
    impulse, change = np.zeros((3, 3)), np.zeros((2, 6))
    solve_island(constraints, 0, w, np.full(3, 0.4), np.zeros(3, np.bool_), impulse, change)
    again, solved = impulse.copy(), change.copy()
    assert solve_island(constraints, 0, w, np.full(3, 0.4), np.zeros(3, np.bool_), again, solved) <= 2
    np.testing.assert_allclose(again, impulse, rtol=0.0, atol=1e-8)


def slots_of(*columns: list[int], rows: int = 20) -> tuple[list[IntArray], IntArray]:
    """Places of the bodies that each column of contacts names, and the bodies in their places."""
    slot_of, bodies, count = np.full(rows, -1), np.empty(rows, np.int64), 0
    out = []
    for column in columns:
        slots = np.empty(len(column), np.int64)
        count = fill_slots(np.array(column, np.int64), slot_of, bodies, count, slots)
        out.append(slots)
    return out, bodies[:count]


def islands_of(a: list[int], b: list[int], m: int) -> list[list[int]]:
    order, bounds = np.empty(len(a), np.int64), np.empty(len(a) + 1, np.int64)
    count = find_islands(np.array(a, np.int64), np.array(b, np.int64), m, order, bounds)
    return [order[bounds[i] : bounds[i + 1]].tolist() for i in range(count)]


def test_bodies_get_places_in_the_order_of_their_contacts() -> None:
    (a, b), bodies = slots_of([7, 3, 7, 5], [-1, 7, 9, -1])
    assert bodies.tolist() == [7, 3, 5, 9]
    assert a.tolist() == [0, 1, 0, 2]
    assert b.tolist() == [-1, 0, 3, -1]


def test_no_contacts_have_no_bodies_and_no_islands() -> None:
    (a,), bodies = slots_of([])
    assert len(a) == len(bodies) == 0
    assert islands_of([], [], 0) == []


def test_what_does_not_move_joins_nobody() -> None:
    """Two bodies on one ground are two islands."""
    assert islands_of([0, 1, 0], [-1, -1, -1], 2) == [[0, 2], [1]]


def test_a_chain_is_one_island_whatever_the_order_of_its_links() -> None:
    assert islands_of([2, 0, 1], [3, 1, 2], 4) == [[0, 1, 2]]
    assert islands_of([0, 2, 1], [1, 3, 2], 4) == [[0, 1, 2]]


def test_islands_and_their_contacts_keep_the_order_of_the_contacts() -> None:
    assert islands_of([4, 0, 4, 2, 0], [5, 1, -1, 3, -1], 6) == [[0, 2], [1, 4], [3]]


@pytest.mark.parametrize("seed", range(10))
def test_random_contacts_against_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, k = 12, int(rng.integers(1, 15))
    a = rng.integers(0, m, k).tolist()
    b = [int(x) for x in rng.integers(-1, m, k)]
    b = [y if y != x else -1 for x, y in zip(a, b, strict=True)]
    label = list(range(m))
    for _ in range(m):  # labels spread along contacts until nothing changes
        for x, y in zip(a, b, strict=True):
            if y >= 0:
                label[x] = label[y] = min(label[x], label[y])
    expected: dict[int, list[int]] = {}
    for c, x in enumerate(a):
        expected.setdefault(label[x], []).append(c)
    assert islands_of(a, b, m) == list(expected.values())
