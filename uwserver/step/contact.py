"""Contacts in a tick, in compiled code: where bodies touch, and what that does to them. Imports numba."""

from __future__ import annotations

from typing import Any

from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.contact import touching
from uwserver.physics.contact.calling import call_for_struck
from uwserver.physics.contact.touching import COLUMNS, FOUND, KEPT
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call, call_for_number
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.handles import array_at, arrays_at
from uwserver.step import rows

_course, _run, _world, _state, _shapes = (
    array_at(rows.FORMS, name) for name in ("course", "run", "world", "state", "shapes")
)
_touching, _pairs, _line_first = (array_at(rows.FORMS, name) for name in ("touching", "pairs", "line_first"))
_lines, _overlapping, _bodies = (array_at(rows.FORMS, name) for name in ("lines", "overlapping", "bodies"))
_numbers, _keys, _coefficients = (array_at(rows.FORMS, name) for name in ("numbers", "keys", "coefficients"))
_led, _contact_nu_dot = (array_at(rows.FORMS, name) for name in ("led", "contact_nu_dot"))
_found_at = arrays_at(Contacts, COLUMNS)  # which stand first in the table
_kept_at = arrays_at(Contacts, touching.FORMS)
_counts, _impulse, _hold = (array_at(touching.FORMS, name) for name in ("counts", "impulse", "hold"))


@compiled
def _is_unyielding(table: Array, row: int) -> bool:
    """Whether nothing pushes what stands in a row: it does not move, or follows somebody's poses."""
    found = row < 0
    for led in _led(table):
        found = found or led == row
    return bool(found)


@compiled
def _take(table: Array, count: int) -> bool:
    """Keep so many contacts as those of the coming tick, but for those that nobody feels; False where there is no room."""
    bodies, numbers, keys, coefficients = _bodies(table), _numbers(table), _keys(table), _coefficients(table)
    found, counts = _found_at(_touching(table)), _counts(_touching(table))
    n, fits = 0, True
    for k in range(count):
        a, b = bodies[k, 0], bodies[k, 1]
        if _is_unyielding(table, a) and _is_unyielding(table, b):
            continue
        if n >= len(found.gap):
            fits = False
            break
        found.body_a[n], found.body_b[n], found.gap[n], found.key[n] = a, b, numbers[k, 6], keys[k]
        for i in range(3):
            found.point[n, i], found.normal[n, i] = numbers[k, i], numbers[k, 3 + i]
        found.friction[n], found.restitution[n] = coefficients[k, 0], coefficients[k, 1]
        n += 1
    counts[FOUND] = n
    return fits


@compiled
def is_possible(table: Array) -> bool:
    """Whether something is solid."""
    return bool(_course(table)[0].find_pairs != 0 or _run(table)[0].finds != 0)


@compiled
def find(table: Array) -> bool:
    """Look for contacts as `collision.solids.Solids.find_contacts` does; False where Python has to: an engine is to be asked, or room is needed."""
    course, shapes, pairs, lines = _course(table)[0], _shapes(table), _pairs(table), _lines(table)
    overlapping, keys, counts = _overlapping(table), _keys(table), _counts(_touching(table))
    counts[FOUND] = 0
    near = call_for_number(course.find_pairs, (shapes, _state(table), course.dt, course.margin, True, pairs))
    if near == 0:
        return True
    if near > len(pairs):
        return False
    pairs, first = pairs[:near], _line_first(table)[: near + 1]
    count = call_for_number(course.find_lines, (shapes, pairs, first, lines, overlapping))
    if count > len(lines):
        return False
    for k in range(count):
        if overlapping[k]:
            return False
    given = shapes, pairs, first, lines[:count], _bodies(table), _numbers(table), keys, _coefficients(table)
    found = call_for_number(course.find_contacts, given)
    return bool(found < len(keys) and _take(table, found))


@compiled
def has_found(table: Array) -> bool:
    """Whether bodies may touch something in the coming tick."""
    return bool(_counts(_touching(table))[FOUND] > 0)


@compiled
def feel(table: Array, nu_dot: Array) -> None:
    """Add the mean acceleration by contacts in the last tick, as an accelerometer feels it."""
    if is_possible(table) and _counts(_touching(table))[KEPT] > 0:
        felt = _contact_nu_dot(table)
        for k in range(len(felt)):
            for i in range(6):
                nu_dot[k, i] += felt[k, i]


@compiled
def part(table: Array) -> None:
    """Nothing touches any more."""
    counts, felt = _counts(_touching(table)), _contact_nu_dot(table)
    if counts[KEPT] > 0:
        counts[KEPT] = 0
        felt[:] = 0.0


@compiled
def _first_of(contacts: Any, n: int) -> Any:
    """The first n contacts."""
    return Contacts(
        contacts.body_a[:n], contacts.body_b[:n], contacts.point[:n], contacts.normal[:n], contacts.gap[:n], contacts.key[:n],
        contacts.friction[:n], contacts.restitution[:n],
    )  # fmt: skip


@compiled
def _keep(table: Array, n: int) -> None:
    """What was found is what the tick had."""
    found, kept, counts = _found_at(_touching(table)), _kept_at(_touching(table)), _counts(_touching(table))
    for k in range(n):
        kept.body_a[k], kept.body_b[k], kept.gap[k], kept.key[k] = (
            found.body_a[k], found.body_b[k], found.gap[k], found.key[k]
        )  # fmt: skip
        for i in range(3):
            kept.point[k, i], kept.normal[k, i] = found.point[k, i], found.normal[k, i]
        kept.friction[k], kept.restitution[k] = found.friction[k], found.restitution[k]
    counts[KEPT] = n


@compiled
def touch(table: Array, t: float) -> int:
    """Carry all bodies from t (s) on, some of which touch. Returns -1, or the row of the first whose state is not finite.

    The stages are those of `physics.contact.step`.
    """
    course, world, counts = _course(table)[0], _world(table), _counts(_touching(table))
    n, m = counts[FOUND], counts[KEPT]
    contacts, old = _first_of(_found_at(_touching(table)), n), _kept_at(_touching(table))
    impulse, hold = _impulse(_touching(table)), _hold(_touching(table))
    given = world, contacts, old.key[:m], old.point[:m], hold[:m], t, course.dt
    struck = call_for_struck(course.strike, given)
    lost = call_for_number(course.move, (world, t, course.dt))
    if lost < 0:
        _keep(table, n)
        call(course.settle, (world, struck, contacts, course.dt, impulse[:n], hold[:n], _contact_nu_dot(table)))
    return lost
