"""The bodies in a tick, in compiled code: the time, the water at the bodies, where they may touch, and their motion. Imports numba."""

from __future__ import annotations

from typing import Any

from uwserver.physics.contact import carrying
from uwserver.physics.contact.touching import FOUND
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call, call_for_number
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.handles import array_at
from uwserver.physics.kernel.layout import Codes, SeaRows
from uwserver.sensors.surroundings import FORMS as SURROUNDINGS
from uwserver.step import rows

_course, _run, _world, _surroundings, _state = (
    array_at(rows.FORMS, name) for name in ("course", "run", "world", "surroundings", "state")
)
_touching, _contact_nu_dot, _nu_dot, _tau = (
    array_at(rows.FORMS, name) for name in ("touching", "contact_nu_dot", "nu_dot", "tau")
)
_shapes, _pairs, _line_first, _lines, _overlapping = (
    array_at(rows.FORMS, name) for name in ("shapes", "pairs", "line_first", "lines", "overlapping")
)
_bodies, _numbers, _keys, _coefficients, _led = (
    array_at(rows.FORMS, name) for name in ("bodies", "numbers", "keys", "coefficients", "led")
)
_uniform, _profiles, _waves = (array_at(SURROUNDINGS, name) for name in ("uniform", "profiles", "waves"))


@compiled
def time_of(course: Any, tick: int) -> int:
    """Return the time of a tick, ns, as `Ticks.time_of` does."""
    if course.given != 0:
        return course.t_ns if tick == course.given_tick else course.next_t_ns  # type: ignore[no-any-return]
    return (tick * (2_000_000_000 * course.parts) + course.rate) // (2 * course.rate)  # type: ignore[no-any-return]


@compiled
def seconds_of(course: Any, tick: int) -> float:
    """Return the time of a tick, s."""
    if course.given != 0:
        return course.t if tick == course.given_tick else course.next_t  # type: ignore[no-any-return]
    return tick * course.parts / course.rate  # type: ignore[no-any-return]


@compiled
def fill_flows(table: Array, ahead: float) -> None:
    """Find the water velocity at the bodies, where they are `ahead` s after the present tick. Does nothing without a sea."""
    course, surroundings = _course(table)[0], _surroundings(table)
    if course.fill_flows != 0:
        sea = SeaRows(_uniform(surroundings), _profiles(surroundings), _waves(surroundings))
        call(course.fill_flows, (_world(table), sea, seconds_of(course, _run(table)[0].tick), ahead))


@compiled
def _is_unyielding(table: Array, row: int) -> bool:
    """Return whether nothing can push the body of a row: the body does not move (row < 0), or it follows poses from outside."""
    found = row < 0
    for led in _led(table):
        found = found or led == row
    return bool(found)


@compiled
def _keep(table: Array, count: int) -> bool:
    """Keep the first `count` contacts for the tick, except those between two bodies that nothing can push. Returns False where there is no room."""
    bodies, numbers, keys, coefficients = _bodies(table), _numbers(table), _keys(table), _coefficients(table)
    found, counts = carrying.found_at(_touching(table)), carrying.counts_at(_touching(table))
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
def can_touch(table: Array) -> bool:
    """Return whether anything in the world is solid."""
    return bool(_course(table)[0].find_pairs != 0 or _run(table)[0].finds != 0)


@compiled
def find_contacts(table: Array) -> bool:
    """Find contacts as `collision.solids.Solids.find_contacts` does. Returns False where Python must do it: to ask an engine, or to make room."""
    course, shapes, pairs, lines = _course(table)[0], _shapes(table), _pairs(table), _lines(table)
    overlapping, keys, counts = _overlapping(table), _keys(table), carrying.counts_at(_touching(table))
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
    return bool(found < len(keys) and _keep(table, found))


@compiled
def may_touch(table: Array) -> bool:
    """Return whether bodies may touch something in the coming tick."""
    return bool(carrying.counts_at(_touching(table))[FOUND] > 0)


@compiled
def _codes(table: Array) -> Codes:
    codes = _course(table)[0].codes
    return Codes(codes.advance, codes.rates, codes.strike, codes.finish_contacts)


@compiled
def move(table: Array) -> int:
    """Move all bodies through the tick. Returns the row of the first body whose state is not finite, or -1."""
    course, felt = _course(table)[0], _contact_nu_dot(table)
    t = seconds_of(course, _run(table)[0].tick)
    return carrying.carry(_codes(table), _world(table), _touching(table), felt, t, course.dt)


@compiled
def find_rates(table: Array) -> None:
    """Find the accelerations of the bodies at the present tick, and the forces that cause them."""
    course, felt = _course(table)[0], _contact_nu_dot(table)
    t = seconds_of(course, _run(table)[0].tick)
    carrying.find_rates(_codes(table), _world(table), _touching(table), felt, t, _nu_dot(table), _tau(table))
