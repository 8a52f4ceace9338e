"""The bodies in a tick, in compiled code: the time, the water at the bodies, and their motion. Imports numba."""

from __future__ import annotations

from typing import Any

from uwserver.physics.contact import carrying
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.handles import array_at
from uwserver.physics.kernel.layout import Codes, SeaRows
from uwserver.sensors.surroundings import FORMS as SURROUNDINGS
from uwserver.step import rows

_course, _run, _world, _surroundings = (
    array_at(rows.FORMS, name) for name in ("course", "run", "world", "surroundings")
)
_touching, _contact_nu_dot = (array_at(rows.FORMS, name) for name in ("touching", "contact_nu_dot"))
_nu_dot, _tau = (array_at(rows.FORMS, name) for name in ("nu_dot", "tau"))
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
