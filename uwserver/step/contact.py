"""The contacts of a tick, in compiled code: where bodies may touch. Imports numba."""

from __future__ import annotations

from uwserver.physics.contact.carrying import counts_at, found_at
from uwserver.physics.contact.touching import FOUND
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call_for_number
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.handles import array_at
from uwserver.step import rows

_course, _run, _state, _shapes = (array_at(rows.FORMS, name) for name in ("course", "run", "state", "shapes"))
_touching, _pairs, _line_first = (array_at(rows.FORMS, name) for name in ("touching", "pairs", "line_first"))
_lines, _overlapping, _bodies = (array_at(rows.FORMS, name) for name in ("lines", "overlapping", "bodies"))
_numbers, _keys, _coefficients = (array_at(rows.FORMS, name) for name in ("numbers", "keys", "coefficients"))
_led = array_at(rows.FORMS, "led")


@compiled
def _is_unyielding(table: Array, row: int) -> bool:
    """Return whether nothing can push the body of a row: the body does not move (row < 0), or it follows poses from outside."""
    found = row < 0
    for led in _led(table):
        found = found or led == row
    return bool(found)


@compiled
def _take(table: Array, count: int) -> bool:
    """Keep the first `count` contacts for the tick, but those between two bodies that nothing can push. Returns False where there is no room."""
    bodies, numbers, keys, coefficients = _bodies(table), _numbers(table), _keys(table), _coefficients(table)
    found, counts = found_at(_touching(table)), counts_at(_touching(table))
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
    """Return whether anything in the world is solid."""
    return bool(_course(table)[0].find_pairs != 0 or _run(table)[0].finds != 0)


@compiled
def find(table: Array) -> bool:
    """Find contacts as `collision.solids.Solids.find_contacts` does. Returns False where Python must do it: to ask an engine, or to make room."""
    course, shapes, pairs, lines = _course(table)[0], _shapes(table), _pairs(table), _lines(table)
    overlapping, keys, counts = _overlapping(table), _keys(table), counts_at(_touching(table))
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
    """Return whether bodies may touch something in the coming tick."""
    return bool(counts_at(_touching(table))[FOUND] > 0)
