"""The stages of a tick in contact, on bodies whose answer is known: what a tick leaves in the rows, and what it hands on.

`tests/physics/test_contact.py` proves hits, rest and friction over whole motions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from uwserver_bench.proofs.colliders import Floor

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.contact.recovery import MAX_RECOVERY, RECOVERY, SLOP
from uwserver.physics.contact.step import BOUNCE_SPEED, finish_contacts, strike
from uwserver.physics.dynamics.appendage_params import Appendages, HullParams, ServoParams
from uwserver.physics.dynamics.params import BodyParams, ForceTable, Lag, ThrusterParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, WORLD, Q, addresses

DT = 0.01
ZERO = np.zeros((6, 6))


def ball(mass: float = 5.0, added: float = 3.0, heavy: float = 0.0, **changes: Any) -> BodyParams:
    plain = BodyParams(
        np.diag([mass] * 3 + [1.0] * 3), np.diag([added] * 3 + [0.0] * 3), ZERO, ZERO, ZERO, 50.0 + heavy, 50.0, (0.0,) * 3, (0.0,) * 3
    )  # fmt: skip
    return replace(plain, **changes)


def world(*bodies: BodyParams) -> Hydrodynamics:
    hydro = Hydrodynamics(bodies, DT)
    hydro.state[:, 0] = 10.0 * np.arange(len(bodies))
    hydro.state[:, 2] = 50.0
    return hydro


def below(
    hydro: Hydrodynamics, rows: Any = (0,), gap: float = 0.0, friction: float = 0.0, restitution: float = 0.0
) -> Contacts:
    """A contact of each row with the ground, straight below it."""
    n = len(rows)
    rows = np.array(rows, np.int64)
    normals = np.repeat([[0.0, 0.0, -1.0]], n, axis=0)
    return Contacts(
        rows, np.full(n, -1, np.int64), hydro.state[rows, :3] + [0.0, 0.0, 0.5], normals, np.full(n, gap), np.arange(n), np.full(n, friction),
        np.full(n, restitution),
    )  # fmt: skip


NONE = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))


def tick(hydro: Hydrodynamics, contacts: Contacts, old: Any = NONE) -> tuple[FloatArray, FloatArray]:
    """All stages; impulses in N, and mean accelerations."""
    table = addresses(WORLD, vars(hydro))
    struck = strike(table, contacts, *old, 0.0, DT)
    hydro.collider = None
    assert hydro.advance(0.0) < 0
    impulse, hold, nu_dot = *np.empty((2, len(contacts.gap), 3)), np.full((len(hydro), 6), np.nan)
    finish_contacts(table, struck, contacts, DT, impulse, hold, nu_dot)
    assert not (np.abs(hold) > np.abs(impulse) + 1e-12).any()
    return impulse, nu_dot


def test_a_resting_body_is_held_by_a_force_over_the_tick() -> None:
    hydro = world(ball(heavy=20.0))
    before = hydro.state.copy()
    struck = strike(addresses(WORLD, vars(hydro)), below(hydro), *NONE, 0.0, DT)
    assert hydro.bodies["in_contact"][0] == 1
    np.testing.assert_allclose(hydro.bodies["contact"][0], [0.0, 0.0, -20.0, *[0.0] * 7], rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(hydro.state, before)
    assert struck.bodies.tolist() == [0]
    assert not struck.final[0]
    assert not struck.hit.any()


def test_after_the_tick_no_contact_acts_any_more() -> None:
    hydro = world(ball(heavy=20.0))
    impulse, nu_dot = tick(hydro, below(hydro))
    np.testing.assert_allclose(impulse, [[0.0, 0.0, -20.0 * DT]], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(nu_dot[0], [0.0, 0.0, -20.0 / 8.0, 0.0, 0.0, 0.0], rtol=0.0, atol=1e-9)
    assert hydro.bodies["in_contact"][0] == 0
    assert not hydro.bodies["contact"].any()
    np.testing.assert_allclose(hydro.state[0, NU:], 0.0, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_a_hit_reverses_the_velocity_by_its_restitution(e: float) -> None:
    hydro = world(ball())
    hydro.state[0, NU + 2] = 0.8
    impulse, _ = tick(hydro, below(hydro, restitution=e))
    assert hydro.state[0, NU + 2] == pytest.approx(-0.8 * e, abs=1e-12)
    assert impulse[0, 2] == pytest.approx(-8.0 * 0.8 * (1.0 + e))


@pytest.mark.parametrize("speed", [0.5 * BOUNCE_SPEED, 2.0 * BOUNCE_SPEED])
def test_slow_hits_do_not_bounce(speed: float) -> None:
    hydro = world(ball())
    hydro.state[0, NU + 2] = speed
    tick(hydro, below(hydro, restitution=1.0))
    assert (hydro.state[0, NU + 2] < -0.9 * speed) == (speed > BOUNCE_SPEED)


@pytest.mark.parametrize("gap", [0.002, 0.02])
def test_an_open_gap_may_close_within_the_tick_and_no_further(gap: float) -> None:
    hydro = world(ball())
    hydro.state[0, NU + 2] = 1.0
    z = hydro.state[0, 2]
    tick(hydro, below(hydro, gap=gap))
    assert hydro.state[0, 2] - z == pytest.approx(min(gap, 1.0 * DT), rel=1e-9)


def test_friction_holds_up_to_its_cone_and_slides_beyond() -> None:
    for push, slides in ((9.0, False), (11.0, True)):
        hydro = world(ball(heavy=20.0))
        hydro.bodies["M_inv"][0, 3:, 3:] = 0.0  # a body that cannot roll
        hydro.external[0, 0] = push
        impulse, _ = tick(hydro, below(hydro, friction=0.5))
        assert impulse[0, 0] == pytest.approx(-min(push, 10.0) * DT, rel=1e-6)
        assert hydro.state[0, NU] == pytest.approx((push - 10.0) * DT / 8.0 if slides else 0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("gap", "rise"), [(-0.5 * SLOP, 0.0), (-0.001, RECOVERY * (0.001 - SLOP)), (-1.0, MAX_RECOVERY * DT)]
)
def test_penetration_is_recovered_a_part_at_a_time_without_velocity(gap: float, rise: float) -> None:
    hydro = world(ball(heavy=20.0))
    z = hydro.state[0, 2]
    tick(hydro, below(hydro, gap=gap))
    assert z - hydro.state[0, 2] == pytest.approx(rise, abs=1e-9)
    np.testing.assert_allclose(hydro.state[0, NU:], 0.0, rtol=0.0, atol=1e-12)


def test_bodies_that_go_apart_keep_their_free_step_bit_for_bit() -> None:
    hydro, free = world(ball()), world(ball())
    for h in (hydro, free):
        h.state[0, NU : NU + 6] = 0.3, 0.1, -0.2, 0.1, 0.2, 0.3
    impulse, nu_dot = tick(hydro, below(hydro, gap=0.001, friction=0.5))
    free.advance(0.0)
    np.testing.assert_array_equal(hydro.state, free.state)
    assert not impulse.any()
    assert not nu_dot.any()


def test_a_body_without_contact_has_no_contact_acceleration() -> None:
    hydro = world(ball(), ball(heavy=20.0), ball())
    _, nu_dot = tick(hydro, below(hydro, rows=(1,)))
    assert nu_dot[1, 2] < 0.0
    assert not nu_dot[[0, 2]].any()


def test_bodies_in_contact_with_each_other_get_opposite_impulses() -> None:
    hydro = world(ball(), ball(mass=9.0, added=7.0))
    hydro.state[1, 0], hydro.state[0, NU] = 1.0, 2.0
    zero, one = np.zeros(1, np.int64), np.ones(1)
    contacts = Contacts(
        zero, zero + 1, np.array([[0.5, 0.0, 50.0]]), np.array([[-1.0, 0.0, 0.0]]), 0.0 * one, zero, 0.0 * one, one
    )
    impulse, _ = tick(hydro, contacts)
    # Elastic, 8 kg on 16 kg: v1 = (8 - 16) / 24 v, v2 = 2 * 8 / 24 v.
    assert hydro.state[:, NU].tolist() == pytest.approx([-2.0 / 3.0, 4.0 / 3.0])
    assert impulse[0].tolist() == pytest.approx([-8.0 * (2.0 + 2.0 / 3.0), 0.0, 0.0])


def test_the_trial_moves_neither_lags_nor_servos() -> None:
    """The real step does, once."""
    table = ForceTable((12.0,), (((-1.0, -40.0), (1.0, 40.0)),))
    thruster = ThrusterParams("t", (0.0,) * 3, (1.0, 0.0, 0.0), table, 12.0, Lag.first_order(0.1))
    fins = Appendages(servos=(ServoParams("fin", -1.0, 1.0, rate=1.0, tau=0.1),), hulls=(HullParams((1.0,) * 6),))
    hydro = world(ball(heavy=20.0, thrusters=(thruster,), appendages=fins))
    hydro.thrusters["command"], hydro.thrusters["fresh"], hydro.servos["command"] = 1.0, 1, 0.5
    hydro.external[0] = 1.0
    before = {name: getattr(hydro, name).tobytes() for name in ("thrusters", "servos")}
    strike(addresses(WORLD, vars(hydro)), below(hydro), *NONE, 0.0, DT)
    assert {name: getattr(hydro, name).tobytes() for name in before} == before
    assert hydro.external.all()


@pytest.mark.parametrize("fitted", [False, True])
def test_appendages_that_do_nothing_change_nothing(fitted: bool) -> None:
    """Worlds with and without appendages have contact kernels of their own."""
    given = Appendages(servos=(ServoParams("fin", -1.0, 1.0),)) if fitted else Appendages()
    hydro, plain = world(ball(heavy=20.0, appendages=given)), world(ball(heavy=20.0))
    for h in (hydro, plain):
        h.state[0, NU : NU + 6] = 0.3, 0.1, 0.4, 0.1, 0.2, 0.3
        tick(h, below(h, friction=0.4, restitution=0.3))
    np.testing.assert_array_equal(hydro.state, plain.state)


def test_a_warm_start_is_found_by_its_key_in_any_order() -> None:
    """The solution does not depend on it beyond the tolerance, whatever is remembered."""
    hydro, feet = world(ball(heavy=20.0)), ((0.3, 0.3, 0.5), (0.3, -0.3, 0.5), (-0.3, 0.3, 0.5), (-0.3, -0.3, 0.5))
    hydro.state[0, Q : Q + 4] = quat_from_rpy(0.0, 0.0, 0.7)
    floor = Floor({0: feet}, friction=0.5, origin=(0.0, 0.0, 50.5))
    contacts = floor.find_contacts(hydro.state, DT)
    key, old = contacts.key[::-1].copy(), np.full((4, 3), (0.0, 0.0, -5.0 * DT))
    point = contacts.point[::-1].copy()
    for memory in ((key, point, old), (key + 100, point, old), NONE):
        other = world(ball(heavy=20.0))
        other.state[:] = hydro.state
        impulse, _ = tick(other, contacts, memory)
        np.testing.assert_allclose(impulse.sum(axis=0), [0.0, 0.0, -20.0 * DT], rtol=0.0, atol=1e-9)


def test_a_spinning_body_that_is_held_keeps_its_attitude_a_unit_quaternion() -> None:
    hydro = world(ball(heavy=20.0))
    hydro.state[0, NU + 5] = 3.0
    for _ in range(100):
        tick(hydro, below(hydro))
    assert np.linalg.norm(hydro.state[0, Q : Q + 4]) == pytest.approx(1.0, abs=1e-15)
    R = np.array(matrix(hydro.state[0, Q : Q + 4]))
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(3.0 * 100 * DT)


def test_a_hit_acts_at_the_start_and_what_holds_over_the_tick() -> None:
    """Falling at 0.8 m/s on to the ground, and 20 N heavy: the next tick starts from what holds alone."""
    hydro = world(ball(heavy=20.0))
    hydro.state[0, NU + 2] = 0.8
    contacts, table = below(hydro), addresses(WORLD, vars(hydro))
    struck = strike(table, contacts, *NONE, 0.0, DT)
    assert struck.hit[0, 0] == pytest.approx(8.0 * 0.8, rel=1e-12)
    assert hydro.state[0, NU + 2] == pytest.approx(0.0, abs=1e-12)
    assert struck.hold[0, 0] == pytest.approx(20.0 * DT, rel=1e-9)
    hydro.advance(0.0)
    impulse, hold = np.empty((2, 1, 3))
    finish_contacts(table, struck, contacts, DT, impulse, hold, np.empty((1, 6)))
    np.testing.assert_allclose(hold, [[0.0, 0.0, -20.0 * DT]], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(impulse, [[0.0, 0.0, -20.0 * DT - 6.4]], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("part", [0.25, 0.75, 0.999])
def test_until_a_hit_within_the_tick_the_ground_does_not_hold(part: float) -> None:
    """It touches after a part of the tick, and bears the weight for the rest of it."""
    hydro = world(ball(heavy=20.0))
    hydro.state[0, NU + 2] = 0.8
    contacts = below(hydro, gap=part * DT * 0.8)
    struck = strike(addresses(WORLD, vars(hydro)), contacts, *NONE, 0.0, DT)
    assert struck.hit[0, 0] == pytest.approx((1.0 - part) * 8.0 * 0.8, rel=1e-9)
    assert struck.hold[0, 0] == pytest.approx((1.0 - part) * 20.0 * DT, rel=1e-6)
    assert struck.final[0]


def test_a_contact_that_rolls_along_takes_the_force_with_it() -> None:
    """The next tick's contact is where this one went, so a ball that rolls is not braked."""
    hydro = world(ball(heavy=20.0))
    hydro.state[0, NU], hydro.state[0, NU + 4] = 2.0, -4.0
    contacts = below(hydro, friction=0.5)
    memory = contacts.key, contacts.point - [2.0 * DT, 0.0, 0.0], np.array([[0.0, 0.0, -20.0 * DT]])
    impulse, _ = tick(hydro, contacts, memory)
    np.testing.assert_allclose(impulse, [[0.0, 0.0, -20.0 * DT]], rtol=0.0, atol=1e-7)
    R = np.array(matrix(hydro.state[0, Q : Q + 4]))
    np.testing.assert_allclose(R @ hydro.state[0, NU : NU + 3], [2.0, 0.0, 0.0], rtol=0.0, atol=1e-6)
    assert hydro.state[0, NU + 4] == pytest.approx(-4.0, abs=1e-6)
