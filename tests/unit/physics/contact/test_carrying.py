"""The tick of all bodies in one call: what contacts do before it, the bodies' own motion, and what contacts leave behind it."""

from __future__ import annotations

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.contact.step import finish_contacts, strike
from uwserver.physics.contact.touching import FOUND, KEPT
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import WORLD, addresses

DT = 0.01
ZERO = np.zeros((6, 6))
NONE = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))


class Ground:
    """Under each body, for as long as it `is_there`."""

    is_there = True

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        n = len(state) if self.is_there else 0
        rows = np.arange(n)
        points, up = state[:n, :3] + np.array([0.0, 0.0, 0.5]), np.repeat([[0.0, 0.0, -1.0]], n, axis=0)
        return Contacts(rows, np.full(n, -1), points, up, np.zeros(n), rows.copy(), np.zeros(n), np.zeros(n))


def heavy() -> Hydrodynamics:
    """Two bodies that press on what is below them by 20 N, the second one falling on it."""
    body = BodyParams(
        np.diag([5.0] * 3 + [1.0] * 3),
        np.diag([3.0] * 3 + [0.0] * 3),
        ZERO,
        ZERO,
        ZERO,
        70.0,
        50.0,
        (0.0,) * 3,
        (0.0,) * 3,
    )
    hydro = Hydrodynamics([body, body], DT)
    hydro.state[:, 0], hydro.state[:, 2], hydro.state[1, 9] = (0.0, 10.0), 50.0, 0.3
    return hydro


def counts(hydro: Hydrodynamics) -> tuple[int, int]:
    """Contacts that were found for the coming tick, and those of the last one."""
    found = hydro.touching._counts
    return int(found[FOUND]), int(found[KEPT])


def test_it_is_the_three_stages_in_their_order_to_the_last_bit() -> None:
    one, other = heavy(), heavy()
    one.collider = Ground()
    assert one.advance(0.0) == -1
    contacts, table = Ground().find_contacts(other.state, DT), addresses(WORLD, vars(other))
    struck = strike(table, contacts, *NONE, 0.0, DT)
    assert other.advance(0.0) == -1
    impulse, hold, nu_dot = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 6))
    finish_contacts(table, struck, contacts, DT, impulse, hold, nu_dot)
    np.testing.assert_array_equal(one.state, other.state)
    np.testing.assert_array_equal(one.contact_nu_dot, nu_dot)
    np.testing.assert_array_equal(one.touched.impulse, impulse)
    np.testing.assert_array_equal(one.touched.hold, hold)
    assert impulse[1, 2] < impulse[0, 2] < 0.0
    assert counts(one) == (0, 2)


def test_who_touches_nothing_any_more_has_no_contacts_and_is_accelerated_by_none() -> None:
    hydro, ground = heavy(), Ground()
    hydro.collider = ground
    hydro.advance(0.0)
    felt, tau = hydro.rates_of_change(DT)
    ground.is_there = False
    hydro.advance(DT)
    assert counts(hydro) == (0, 0)
    assert not hydro.contact_nu_dot.any()
    free, also = hydro.rates_of_change(DT)
    assert free[0, 2] - felt[0, 2] > 1.0, "what carried it is gone"
    np.testing.assert_array_equal(tau, also)


def test_a_body_that_is_lost_ends_the_tick_before_contacts_settle() -> None:
    hydro = heavy()
    hydro.collider = Ground()
    hydro.advance(0.0)
    before = hydro.touched.impulse.copy()
    hydro.state[1, 9] = np.nan
    assert hydro.advance(DT) == 1
    np.testing.assert_array_equal(hydro.touched.impulse, before)
    assert counts(hydro) == (0, 2)
