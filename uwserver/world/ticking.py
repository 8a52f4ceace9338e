"""Ticks that follow each other in compiled code: those in which nothing needs Python. Imports numba, so it is imported when a world has such ticks.

What a tick consists of, and in which order, `World.advance` tells. Here stand the same calls of the same kernels, so that the numbers are the same,
without the steps of the interpreter between them; and as the interpreter is free meanwhile, the loop of a server can have it.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.atomics import load_atomic
from uwserver.physics.kernel.calling import call, call_for_float, call_for_number
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.kernel.giving_way import GIVING, lend, take_back
from uwserver.physics.kernel.handles import array_at, lay
from uwserver.physics.kernel.places import ASKED, CALLED, LATE, WAITED
from uwserver.physics.kernel.right_of_way import NOBODY
from uwserver.physics.rays.hits import miss
from uwserver.physics.rays.raycast import Hits
from uwserver.sensors import surroundings
from uwserver.world import agenda, streams
from uwserver.world.agenda import AT_CONTACTS, AT_PILOTS, DIVERGED, ENDS, ROW, STAGE, STANDS, TICK, WORDY, WRITTEN
from uwserver.world.streams import LARGE

_course, _plans, _phases = (array_at(agenda.FORMS, name) for name in ("course", "plans", "phases"))
_readings, _reached, _ends = (array_at(agenda.FORMS, name) for name in ("readings", "reached", "ends"))
_world, _now, _pilots = (array_at(agenda.FORMS, name) for name in ("world", "now", "pilots"))
_rays, _writings, _solids = (array_at(agenda.FORMS, name) for name in ("rays", "writings", "solids"))
_origin, _direction, _first, _past = (array_at(agenda.FORMS, name) for name in ("origin", "direction", "first", "past"))
_distance, _normal, _body, _material = (array_at(agenda.FORMS, name) for name in Hits._fields)
_shapes, _pairs, _state = (array_at(agenda.FORMS, name) for name in ("shapes", "pairs", "state"))
_nu_dot, _tau = (array_at(agenda.FORMS, name) for name in ("nu_dot", "tau"))
_heads, _numbers, _told = (array_at(streams.FORMS, name) for name in ("heads", "numbers", "told"))
_counts, _streams, _pending = (array_at(streams.FORMS, name) for name in ("counts", "streams", "pending"))
_place = array_at(surroundings.FORMS, "place")


@compiled
def _time_of(course: Any, tick: int) -> int:
    """As `Ticks.time_of`."""
    return (tick * (2_000_000_000 * course.parts) + course.rate) // (2 * course.rate)  # type: ignore[no-any-return]


@compiled
def _move(table: Array, tick: int) -> int:
    """Carry the world from a tick on until its bodies stand at the next; returns the stage that was reached, STANDS if all went well."""
    course, world, reached = _course(table)[0], _world(table), _reached(table)
    waiting = count = 0
    if course.step_pilots != 0 and tick % course.pilots_every == 0:
        waiting = call_for_number(course.step_pilots, (_pilots(table), world, tick, _time_of(course, tick)))
    if waiting != 0:
        return AT_PILOTS
    if course.find_pairs != 0:
        given = _shapes(table), _state(table), course.dt, course.margin, True, _pairs(table)
        count = call_for_number(course.find_pairs, given)
    if count != 0:
        return AT_CONTACTS
    reached[ROW] = call_for_number(course.move, (world, tick * course.parts / course.rate, course.dt))
    return STANDS if reached[ROW] < 0 else DIVERGED


@compiled
def _read_by_rays(table: Array, sensors: Array, reading: Any, t: float) -> None:
    """As `sensors.bank.reader` does where rays are cast at what is intersected one by one."""
    course, now, heads, numbers = _course(table)[0], _now(table), _heads(sensors), _numbers(sensors)
    rows, due = lay(reading.rows, reading.row_count), lay(reading.due, reading.due_count)
    rays, first = _rays(table)[reading.rays], _first(table)[: len(due) + 1]
    origin, direction, past = _origin(table)[: rays.count], _direction(table)[: rays.count], _past(table)
    distance, normal, body, material = _distance(table), _normal(table), _body(table), _material(table)
    hits = Hits(distance[:0], normal[:0], body[:0], material[:0])
    for aim in (rays.aim, rays.aim_again):
        if aim == 0:
            continue
        reach = call_for_float(aim, (heads, rows, numbers, due, now, t, origin, direction, first, hits))
        n = first[len(due)]
        hits = Hits(distance[:n], normal[:n], body[:n], material[:n])
        for k in range(len(due)):
            past[first[k] : first[k + 1]] = heads[due[k]].body
        if course.cast == 0:
            miss(hits)
        elif n > 0:
            given = _solids(table), origin[:n], direction[:n], reach, _state(table), past[:n]
            call(course.cast, given + (hits.distance, hits.normal, hits.body, hits.material))  # noqa: RUF005  # as numba joins tuples
    call(reading.code, (heads, rows, numbers, due, now, t, direction, first, hits))


@compiled
def _write(table: Array, sensors: Array, plan: Any, t_ns: int) -> None:
    """Let sensors write that do, as `due.writer` does."""
    writings, heads, streams, numbers = _writings(table), _heads(sensors), _streams(sensors), _numbers(sensors)
    for k in range(plan.writing_first, plan.writing_first + plan.writing_count):
        writing = writings[k]
        head = heads[writing.head]
        head.ready, head.valid = 1 - head.silent, 1
        if head.silent != 0:
            continue
        reading = numbers[writing.first : writing.first + writing.width]
        texts = call_for_number(_course(table)[0].tell, (_pilots(table), writing.row, t_ns, reading))
        for s in range(writing.stream_first, writing.stream_first + writing.stream_count):
            streams[s].texts = texts + 1
        _reached(table)[WRITTEN] += 1


@compiled
def _is_frozen(table: Array, sensors: Array, plan: Any) -> bool:
    """Whether a sensor that writes has to repeat itself, and its texts with it, which stand in Python."""
    writings, streams = _writings(table), _streams(sensors)
    frozen = 0
    for k in range(plan.writing_first, plan.writing_first + plan.writing_count):
        frozen += streams[writings[k].stream_first].frozen
    return bool(frozen != 0)


@compiled
def _brings_large(sensors: Array, t_ns: int) -> bool:
    """Whether something large arrives by a time, as a picture: that comes in a tick by itself."""
    pending, streams, counts, found = _pending(sensors), _streams(sensors), _counts(sensors)[0], False
    if t_ns >= counts.next_ns:
        for k in range(counts.pending):
            found = found or (pending[k].t_sent_ns <= t_ns and streams[pending[k].stream].wordy == LARGE)
    return found


@compiled
def _measure(table: Array, sensors: Array, plan: Any, values: Array, told_values: Array, tick: int, t_ns: int) -> None:
    """Let the sensors read that are due, and deliver: as `Sensing.after` does where all of it is compiled."""
    course, now, t = _course(table)[0], _now(table), tick * _course(table)[0].parts / _course(table)[0].rate
    _place(now)[0].t_ns = t_ns
    if plan.needs_rates != 0:
        call(course.look, (_world(table), t, _nu_dot(table), _tau(table)))
    readings = _readings(table)
    for k in range(plan.first, plan.first + plan.count):
        reading = readings[k]
        if reading.rays >= 0:
            _read_by_rays(table, sensors, reading, t)
            continue
        rows, due = lay(reading.rows, reading.row_count), lay(reading.due, reading.due_count)
        call(reading.code, (_heads(sensors), rows, _numbers(sensors), due, now, t))
    _write(table, sensors, plan, t_ns)
    heads = lay(plan.heads, plan.head_count)
    told = call_for_number(course.deliver, (sensors, heads, t_ns, True, values, told_values))
    if told != 0 and course.hear != 0:
        call(course.hear, (_pilots(table), _told(sensors), told_values, told, t_ns))


@entry
def go_on(
    table: Array, sensors: Array, values: Array, told_values: Array, way: Array,
    first: int, usual: int, most: int, room: int, log_room: int,
) -> None:  # fmt: skip
    """Make ticks until one needs Python.

    Where the loop asks for the interpreter meanwhile it has it at once. The world goes on while it does, and waits then as between two ticks. Once
    somebody has called, and the loop does not have the interpreter which is needed to hear him, no further one is made.

    Args:
        table: made by `agenda.FORMS`; its `reached` and `ends` receive what was reached.
        sensors, values, told_values: see `delivery.deliver`.
        way: of a `RightOfWay`; zeros for none.
        first: the tick at which the world stands.
        usual, most: ticks where the loop does not have the interpreter, and where it does; `ends` has room for these.
        room, log_room: for samples on their way or delivered, and in the log.
    """
    course, plans, phases = _course(table)[0], _plans(table), _phases(table)
    reached, ends, counts = _reached(table), _ends(table), _counts(sensors)[0]
    tick, stage, count = first, STANDS, 0
    reached[TICK], reached[ENDS], reached[ROW], reached[WORDY], reached[WRITTEN] = first, 0, -1, 0, 0
    called, lent = load_atomic(way, CALLED), 0
    while stage == STANDS:
        asked = load_atomic(way, ASKED)
        is_asked = asked % 2 == 1 and asked != way[LATE]
        if is_asked and lent != asked:
            lent = asked
            lend(way, asked)
        done = tick - first
        is_called = load_atomic(way, CALLED) != called
        if done >= most or (not is_asked and (done >= usual or (done > 0 and is_called))):
            break
        if done > 0 and _brings_large(sensors, _time_of(course, tick + 1)):
            break
        plan = plans[phases[(tick + 1) % len(phases)]]
        needed = counts.pending + plan.most
        if plan.compiled == 0 or needed > room or counts.logged + needed > log_room or _is_frozen(table, sensors, plan):
            break
        stage = _move(table, tick)
        if stage in (AT_PILOTS, AT_CONTACTS):
            break
        tick += 1
        reached[TICK], reached[ENDS] = tick, count  # also where a kernel raises
        t_ns = _time_of(course, tick)
        if stage == STANDS and (plan.head_count > 0 or t_ns >= counts.next_ns):
            logged = counts.logged
            _measure(table, sensors, plan, values, told_values, tick, t_ns)
            if counts.logged > logged:
                ends[count] = counts.logged
                count += 1
            if counts.wordy > 0:
                reached[WORDY] = 1
                break
    reached[TICK], reached[STAGE], reached[ENDS] = tick, stage, count
    if lent != 0:
        turns = take_back(way, lent)
        way[WAITED] += turns
        if turns == GIVING:
            way[LATE] = lent


def load() -> None:
    """Have it ready, compiled or from the cache."""
    table, values = np.zeros((0, 2), np.int64), np.empty((0, 1))
    cast("Any", go_on).load(table, table, values, values, NOBODY, 0, 0, 0, 0, 0)
