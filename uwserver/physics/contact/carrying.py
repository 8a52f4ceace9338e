"""One tick of all bodies after contacts were found, and the accelerations of bodies (compiled). Imports numba.

    1. strike: the contacts at the start of the tick, and the forces that hold over it (`contact.step`); only if something touches.
    2. advance: each body moves by its own equations of motion (`dynamics.integrator`).
    3. finish_contacts: the rest of the contacts at the end of the tick.

The stages are called by the addresses of their code, as each is compiled for worlds with or without appendages.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from uwserver.physics.collision.contacts import NO_CONTACTS, NO_IMPULSES, Contacts
from uwserver.physics.contact import step
from uwserver.physics.contact.forces import Struck
from uwserver.physics.contact.solver import Constraints
from uwserver.physics.contact.touching import COLUMNS, FORMS, FOUND, KEPT
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call, call_for_number, caller
from uwserver.physics.kernel.compiled import compiled, entry, inlined
from uwserver.physics.kernel.handles import array_at, arrays_at
from uwserver.physics.kernel.layout import Codes

_whole, _flags = np.zeros(0, np.int64), np.zeros(0, np.bool_)


def _floats(dimensions: int) -> Any:
    return np.zeros((0,) * dimensions)


_NOTHING = Struck(
    _whole, _floats(3), Constraints(_whole, _whole, _whole, _whole, _floats(3), _floats(4), _floats(2)),
    _floats(2), _floats(2), _floats(2), _flags, _floats(2),
)  # fmt: skip
STRUCK = numba.typeof(_NOTHING)
"""The type of the result of `step.strike`."""

_for_struck = caller(STRUCK)


@inlined
def call_for_struck(code: int, args: Any) -> Any:
    """Call `step.strike` with a tuple of its arguments."""
    return _for_struck(code, args)


def load_stages(fitted: bool) -> tuple[Any, Any]:
    """Return `step.strike`, for a world with or without appendages, and `step.finish_contacts`, compiled or loaded from the cache."""
    strike: Any = step.strike_fitted if fitted else step.strike
    finish_contacts: Any = step.finish_contacts
    table, old = np.zeros((0, 2), np.int64), NO_IMPULSES
    strike.load(table, NO_CONTACTS, old.contacts.key, old.contacts.point, old.hold, 0.0, 0.0)
    finish_contacts.load(table, _NOTHING, NO_CONTACTS, 0.0, old.impulse, old.hold, _floats(2))
    return strike, finish_contacts


found_at, kept_at = (
    arrays_at(Contacts, COLUMNS),
    arrays_at(Contacts, FORMS),
)  # the contacts that were found come first in the table
counts_at = array_at(FORMS, "counts")
_impulse, _hold = array_at(FORMS, "impulse"), array_at(FORMS, "hold")


@compiled
def _first_of(contacts: Any, n: int) -> Any:
    """Return the first n contacts."""
    return Contacts(
        contacts.body_a[:n], contacts.body_b[:n], contacts.point[:n], contacts.normal[:n], contacts.gap[:n], contacts.key[:n],
        contacts.friction[:n], contacts.restitution[:n],
    )  # fmt: skip


@compiled
def _keep(touching: Array, n: int) -> None:
    """Make the contacts that were found those of the tick."""
    found, kept = found_at(touching), kept_at(touching)
    for k in range(n):
        kept.body_a[k], kept.body_b[k], kept.gap[k], kept.key[k] = (
            found.body_a[k], found.body_b[k], found.gap[k], found.key[k]
        )  # fmt: skip
        for i in range(3):
            kept.point[k, i], kept.normal[k, i] = found.point[k, i], found.normal[k, i]
        kept.friction[k], kept.restitution[k] = found.friction[k], found.restitution[k]
    counts_at(touching)[KEPT] = n


@compiled
def _advance(codes: Codes, world: Array, t: float, dt: float) -> int:
    return call_for_number(codes.advance, (world, t, dt))


@compiled
def _touch(codes: Codes, world: Array, touching: Array, contact_nu_dot: Array, t: float, dt: float) -> int:
    counts, old, hold = counts_at(touching), kept_at(touching), _hold(touching)
    n, m = counts[FOUND], counts[KEPT]
    contacts = _first_of(found_at(touching), n)
    struck = call_for_struck(codes.strike, (world, contacts, old.key[:m], old.point[:m], hold[:m], t, dt))
    lost = _advance(codes, world, t, dt)
    if lost < 0:
        _keep(touching, n)
        call(codes.finish_contacts, (world, struck, contacts, dt, _impulse(touching)[:n], hold[:n], contact_nu_dot))
    counts[FOUND] = 0
    return lost


@compiled
def carry(codes: Codes, world: Array, touching: Array, contact_nu_dot: Array, t: float, dt: float) -> int:
    """Move all bodies from t to t + dt, in place.

    Args:
        codes: codes of the world.
        world: table of its rows (`layout.WORLD`).
        touching: table of its contacts (`touching.FORMS`): those that were found for this tick become those of the last one, with their
            impulses.
        contact_nu_dot: (n, 6) in and out, mean acceleration in B by the contacts of the tick.
        t, dt: start and length of the tick, s.

    Returns:
        -1, or the row of the first body whose state is not finite or absurdly fast.
    """
    counts = counts_at(touching)
    if counts[FOUND] > 0:
        return _touch(codes, world, touching, contact_nu_dot, t, dt)
    if counts[KEPT] > 0:
        counts[KEPT] = 0
        contact_nu_dot[:] = 0.0
    return _advance(codes, world, t, dt)


@compiled
def find_rates(
    codes: Codes, world: Array, touching: Array, contact_nu_dot: Array, t: float, nu_dot: Array, tau: Array
) -> None:
    """Find the accelerations of bodies at one instant, by all forces (`integrator.rates_of_change`) and by the contacts of the last tick.

    Args:
        codes, world, touching, contact_nu_dot, t: as for `carry`.
        nu_dot: (n, 6) out, derivative of nu in B, as an accelerometer feels it, m/s2 and rad/s2.
        tau: (n, 6) out, applied wrench about the origin in B, N and N m.
    """
    call(codes.rates, (world, t, nu_dot, tau))
    if counts_at(touching)[KEPT] > 0:
        for k in range(len(contact_nu_dot)):
            for i in range(6):
                nu_dot[k, i] += contact_nu_dot[k, i]


@entry
def carry_alone(codes: Codes, world: Array, touching: Array, contact_nu_dot: Array, t: float, dt: float) -> int:
    """Call `carry` from Python, for bodies without the other parts of a world."""
    return carry(codes, world, touching, contact_nu_dot, t, dt)


@entry
def find_rates_alone(
    codes: Codes, world: Array, touching: Array, contact_nu_dot: Array, t: float, nu_dot: Array, tau: Array
) -> None:
    """Call `find_rates` from Python, likewise."""
    find_rates(codes, world, touching, contact_nu_dot, t, nu_dot, tau)
