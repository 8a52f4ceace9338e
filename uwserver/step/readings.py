"""The sensors in a tick, in compiled code: which are due, how they read, and the delivery of samples. Imports numba."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.calling import call, call_for_float, call_for_number
from uwserver.physics.kernel.compiled import compiled
from uwserver.physics.kernel.handles import array_at, view_at
from uwserver.physics.rays.hits import miss
from uwserver.physics.rays.raycast import NOTHING, Hits
from uwserver.sensors.surroundings import FORMS as SURROUNDINGS
from uwserver.step import bodies, rows, streams
from uwserver.step.bodies import seconds_of, time_of
from uwserver.step.rows import (
    ARRIVALS,
    CALLED,
    DELIVER,
    DONE,
    EXACT,
    KEEP,
    LISTEN,
    NEEDS_EXACT,
    NEEDS_KEEPING,
    NEEDS_PYTHON,
    NEEDS_RATES,
    NEEDS_REPEATING,
    NEEDS_TEXTS,
    PYTHON,
    RATES,
    READ,
    REPEAT,
    ROUND,
    UNIT,
    WHEN_CALLED,
    WHEN_DUE,
    WRITE,
)
from uwserver.step.streams import LARGE, NEVER
from uwserver.units import NANOSECONDS

_course, _run, _groups, _kinds, _writings = (
    array_at(rows.FORMS, name) for name in ("course", "run", "groups", "kinds", "writings")
)
_repeatings, _repeated = array_at(rows.FORMS, "repeatings"), array_at(rows.FORMS, "repeated")
_shares, _scheduled, _members, _active = (
    array_at(rows.FORMS, name) for name in ("shares", "scheduled", "members", "active")
)
_due, _turns, _turn, _place_of = (array_at(rows.FORMS, name) for name in ("due", "turns", "turn", "place"))
_world, _surroundings, _pilots, _solids = (
    array_at(rows.FORMS, name) for name in ("world", "surroundings", "pilots", "solids")
)
_origin, _direction, _first, _past = (array_at(rows.FORMS, name) for name in ("origin", "direction", "first", "past"))
_distance, _normal, _body, _material = (array_at(rows.FORMS, name) for name in Hits._fields)
_state, _nu_dot, _tau = (array_at(rows.FORMS, name) for name in ("state", "nu_dot", "tau"))
_heads, _numbers, _pending = (array_at(streams.FORMS, name) for name in ("heads", "numbers", "pending"))
_counts, _streams = (array_at(streams.FORMS, name) for name in ("counts", "streams"))
_log_numbers = array_at(streams.FORMS, "log_numbers")
_uniform, _profiles, _waves, _place = (
    array_at(SURROUNDINGS, name) for name in ("uniform", "profiles", "waves", "place")
)


@compiled
def is_measured(run: Any, unit: int, which: int) -> bool:
    """Note that a unit of work is done. Returns whether a profile measures it, so that the step stops here."""
    run.unit, run.which = unit, which
    return bool(run.measured != 0)


@compiled
def _activate(table: Array, tick: int) -> int:
    """Find the groups of sensors that are due in a tick. Returns how many samples they can give."""
    run, groups, active, samples = _run(table)[0], _groups(table), _active(table), 0
    n = 0
    for g in range(len(groups)):
        group = groups[g]
        if not tick <= group.next < tick + group.divisor:  # it was due before, or the time was set
            group.next = -(-tick // group.divisor) * group.divisor
        if group.next == tick:
            active[n] = g
            n += 1
            samples += group.samples
    run.active = n
    return samples


@compiled
def needs_room(table: Array, sensors: Array, wide: int, room: int, log_room: int) -> bool:
    """Return whether the next tick may give more samples, of up to `wide` numbers each, than there is room for; `run.which` says how many."""
    run, counts = _run(table)[0], _counts(sensors)[0]
    run.which = run.callable + _activate(table, run.tick + 1)
    needed = counts.pending + run.which
    is_full = counts.logged + needed > log_room
    if log_room < NEVER:
        is_full = is_full or counts.log_width + needed * wide > len(_log_numbers(sensors))
    return bool(needed > room or is_full)


@compiled
def brings_large(table: Array, sensors: Array) -> bool:
    """Return whether something large, such as a picture, arrives in the next tick. Such a tick is made alone."""
    pending, all_streams, counts, found = _pending(sensors), _streams(sensors), _counts(sensors)[0], False
    if counts.pending > 0:
        t_ns = time_of(_course(table)[0], _run(table)[0].tick + 1)
        for k in range(counts.pending):
            found = found or (pending[k].t_sent_ns <= t_ns and all_streams[pending[k].stream].loose == LARGE)
    return found


@compiled
def _gather(table: Array) -> None:
    """List the sensors that are due in a round: all of them in `due`, and by kinds in `turns`, in the order of the first sensor of each kind."""
    run, groups, shares, active = _run(table)[0], _groups(table), _shares(table), _active(table)
    scheduled, members, due, turns = _scheduled(table), _members(table), _due(table), _turns(table)
    turn, place = _turn(table), _place_of(table)
    run.needs = run.due = run.kinds = 0
    for a in range(run.active):
        group = groups[active[a]]
        if group.round != run.round:
            continue
        run.needs |= group.needs
        for k in range(group.first, group.first + group.count):
            due[run.due] = scheduled[k]
            run.due += 1
        for s in range(group.share_first, group.share_first + group.share_count):
            kind = shares[s].kind
            if place[kind] < 0:
                place[kind] = run.kinds
                turn[run.kinds].kind, turn[run.kinds].count = kind, 0
                run.kinds += 1
            turn[place[kind]].count += shares[s].count
    n = 0
    for k in range(run.kinds):
        turn[k].first, n = n, n + turn[k].count
        turn[k].count = 0
    for a in range(run.active):
        group = groups[active[a]]
        if group.round != run.round:
            continue
        for s in range(group.share_first, group.share_first + group.share_count):
            share, mine = shares[s], turn[place[shares[s].kind]]
            for k in range(share.first, share.first + share.count):
                turns[mine.first + mine.count] = members[k]
                mine.count += 1
    for k in range(run.kinds):
        place[turn[k].kind] = -1


@compiled
def _aim(table: Array, sensors: Array, kind: Any, due: Array, records: Array, t: float) -> Hits:
    """Cast the rays of the sensors of one kind, once for each time that the kind aims (`SensorKernel.aims`). Returns what the last rays hit."""
    course, surroundings, heads, numbers = _course(table)[0], _surroundings(table), _heads(sensors), _numbers(sensors)
    first, past = _first(table)[: len(due) + 1], _past(table)
    origin, direction = _origin(table), _direction(table)
    distance, normal, body, material = _distance(table), _normal(table), _body(table), _material(table)
    hits = Hits(distance[:0], normal[:0], body[:0], material[:0])
    for aim in (kind.aim, kind.aim_again):
        if aim == 0:
            continue
        reach = call_for_float(aim, (heads, records, numbers, due, surroundings, t, origin, direction, first, hits))
        n = first[len(due)]
        hits = Hits(distance[:n], normal[:n], body[:n], material[:n])
        for k in range(len(due)):
            head = heads[due[k]]
            past[first[k] : first[k + 1]] = head.body if head.sees_own == 0 else NOTHING
        if course.cast == 0:
            miss(hits)
        elif n > 0:
            given = _solids(table), origin[:n], direction[:n], reach, _state(table), past[:n]
            call(course.cast, given + (hits.distance, hits.normal, hits.body, hits.material))  # noqa: RUF005  # as numba joins tuples
    return hits


@compiled
def _read(table: Array, sensors: Array, kind: Any, due: Array) -> None:
    """Make the sensors of one kind read."""
    t = seconds_of(_course(table)[0], _run(table)[0].tick)
    records = view_at(kind.rows, kind.row_count)
    given = _heads(sensors), records, _numbers(sensors), due, _surroundings(table), t
    if kind.by_rays != 0:
        hits = _aim(table, sensors, kind, due, records, t)
        call(kind.code, given + (_direction(table), _first(table)[: len(due) + 1], hits))  # noqa: RUF005  # as numba joins tuples
    else:
        call(kind.code, given)


@compiled
def _read_exactly(table: Array, sensors: Array, kind: Any, due: Array) -> None:
    """Find what these sensors of one kind would read without errors, where somebody asks for it. This comes before they read, and leaves no trace in
    their memory."""
    heads, numbers = _heads(sensors), _numbers(sensors)
    for k in range(len(due)):
        head = heads[due[k]]
        if head.exact_first < 0:
            continue
        words = kind.row_size // 8
        record = view_at(kind.rows + head.row * kind.row_size, words)
        kept, remembered = heads[due[k] : due[k] + 1].copy(), record.copy()
        head.exact = head.shadow = 1
        head.first = head.exact_first
        _read(table, sensors, kind, due[k : k + 1])
        valid = head.ready * head.valid
        if head.ready == 0:
            numbers[head.first : head.first + head.width] = np.nan
        record[:] = remembered
        heads[due[k]] = kept[0]
        heads[due[k]].exact_valid = valid


@compiled
def _repeat_one(sensors: Array, repeating: Any, members: Array, t_ns: int) -> None:
    """Read a compound: the age (s) of the oldest of its members' last readings, then the validity and the numbers of each. It is valid when all
    members are, and gives nothing before each of them has read once."""
    head, all_streams, numbers = _heads(sensors)[repeating.head], _streams(sensors), _numbers(sensors)
    head.ready, head.valid, head.delay_ns, head.since_ns = 1 - head.silent, 1, 0, 0
    oldest = t_ns
    for k in members:
        held = all_streams[k].held
        head.ready, head.valid, oldest = head.ready & held.there, head.valid & held.valid, min(oldest, held.t_ns)
    if head.ready == 0:
        return
    n = head.first
    numbers[n] = (t_ns - oldest) / NANOSECONDS
    n += 1
    for k in members:
        member = all_streams[k]
        numbers[n] = member.held.valid
        for i in range(member.width):
            numbers[n + 1 + i] = numbers[member.first + i]
        n += 1 + member.width
    if head.exact_first >= 0:  # it has no errors of its own
        head.exact_valid = head.valid
        numbers[head.exact_first : head.exact_first + head.width] = numbers[head.first : head.first + head.width]


@compiled
def _repeat(table: Array, sensors: Array) -> None:
    """Make the compounds of this round read what their members have read."""
    run, groups, active = _run(table)[0], _groups(table), _active(table)
    repeatings, repeated = _repeatings(table), _repeated(table)
    for a in range(run.active):
        group = groups[active[a]]
        if group.round == run.round:
            for k in range(group.repeating_first, group.repeating_first + group.repeating_count):
                mine = repeatings[k]
                _repeat_one(sensors, mine, repeated[mine.first : mine.first + mine.count], run.t_ns)


@compiled
def _is_frozen(table: Array, sensors: Array) -> bool:
    """Return whether a fault freezes a status sensor of this round. Python must then repeat its texts, which it holds."""
    run, groups, active, writings = _run(table)[0], _groups(table), _active(table), _writings(table)
    all_streams, found = _streams(sensors), False
    for a in range(run.active):
        group = groups[active[a]]
        if group.round == run.round:
            for k in range(group.writing_first, group.writing_first + group.writing_count):
                found = found or all_streams[writings[k].stream_first].frozen != 0
    return found


@compiled
def _write_one(table: Array, sensors: Array, writing: Any, t_ns: int) -> None:
    run, head, numbers, all_streams = (
        _run(table)[0],
        _heads(sensors)[writing.head],
        _numbers(sensors),
        _streams(sensors),
    )
    head.ready, head.valid = 1 - head.silent, 1
    if head.silent != 0:
        return
    reading = numbers[writing.first : writing.first + writing.width]
    texts = call_for_number(_course(table)[0].tell, (_pilots(table), writing.row, t_ns, reading))
    for s in range(writing.stream_first, writing.stream_first + writing.stream_count):
        all_streams[s].texts = texts + 1
    run.written += 1


@compiled
def _write(table: Array, sensors: Array) -> None:
    """Make the status sensors of this round write their readings."""
    run, groups, active, writings = _run(table)[0], _groups(table), _active(table), _writings(table)
    for a in range(run.active):
        group = groups[active[a]]
        if group.round == run.round:
            for k in range(group.writing_first, group.writing_first + group.writing_count):
                _write_one(table, sensors, writings[k], run.t_ns)


@compiled
def _round(table: Array, sensors: Array, values: Array, delivered_values: Array) -> int:
    """Go on with a round of readings from its present stage. Returns why it stops, or DONE at its end."""
    course, run, kinds = _course(table)[0], _run(table)[0], _kinds(table)
    if run.stage == RATES:
        run.stage, run.turn = EXACT, 0
        _place(_surroundings(table))[0].t_ns = run.t_ns
        if run.needs & NEEDS_RATES:
            bodies.fill_flows(table, 0.0)
            bodies.find_rates(table)
            if is_measured(run, RATES, 0):
                return UNIT
    if run.stage == EXACT:
        while run.needs & NEEDS_EXACT and run.turn < run.kinds:
            mine = _turn(table)[run.turn]
            run.turn += 1
            _read_exactly(table, sensors, kinds[mine.kind], _turns(table)[mine.first : mine.first + mine.count])
            if is_measured(run, READ, run.turn - 1):
                return UNIT
        run.stage, run.turn = READ, 0
    if run.stage == READ:
        while run.turn < run.kinds:
            mine = _turn(table)[run.turn]
            run.turn += 1
            _read(table, sensors, kinds[mine.kind], _turns(table)[mine.first : mine.first + mine.count])
            if is_measured(run, READ, run.turn - 1):
                return UNIT
        run.stage = REPEAT
    if run.stage == REPEAT:
        run.stage = PYTHON
        if run.needs & NEEDS_REPEATING:
            _repeat(table, sensors)
            if is_measured(run, REPEAT, 0):
                return UNIT
    if run.stage == PYTHON:
        run.stage = WRITE
        if run.needs & NEEDS_PYTHON:
            return PYTHON
    if run.stage == WRITE:
        run.stage = DELIVER
        if run.needs & NEEDS_TEXTS:
            if _is_frozen(table, sensors):
                run.needs |= NEEDS_KEEPING
                return WRITE
            _write(table, sensors)
            if is_measured(run, WRITE, 0):
                return UNIT
    if run.stage == DELIVER:
        run.stage = KEEP
        given = sensors, _due(table)[: run.due], run.t_ns, run.begun == 0, values, delivered_values
        call_for_number(course.deliver, given)
        run.begun = 1
        if is_measured(run, DELIVER, 0):
            return UNIT
    run.stage, run.round = ROUND, run.round + 1
    return KEEP if run.needs & NEEDS_KEEPING else DONE


@compiled
def measure(table: Array, sensors: Array, values: Array, delivered_values: Array) -> int:
    """Read the sensors, and deliver the samples of a tick. The order is part of the contract:

    1. samples in flight whose time has come, oldest first: they are older than anything measured now;
    2. sensors that wait for an event which has happened, for instance the answer of a beacon;
    3. sensors that are due, those with a shorter interval first, from the new states, with their errors;
    4. compounds, which repeat what the others have read.

    Returns why it stops, or DONE.
    """
    run, counts, last_round = _run(table)[0], _counts(sensors)[0], _course(table)[0].last_round
    if run.stage == ARRIVALS:
        run.stage = ROUND
        arrives = run.t_ns >= counts.next_ns
        if run.active == 0 and run.t_ns < run.call_ns and not arrives:
            run.stage = LISTEN
        elif run.slow != 0 and arrives:
            return ARRIVALS
    while run.stage != LISTEN:
        if run.stage == ROUND:
            if run.round == WHEN_CALLED:
                if run.t_ns >= run.call_ns:
                    return CALLED  # Python goes on with that round, or the next
                run.round = WHEN_DUE
            if run.round > last_round:
                run.stage = LISTEN
                break
            _gather(table)
            arrives = run.round == WHEN_DUE and run.begun == 0 and run.t_ns >= counts.next_ns
            if run.due == 0 and not arrives:
                run.round += 1
                continue
            run.stage = RATES
        why = _round(table, sensors, values, delivered_values)
        if why != DONE:
            return why
    return DONE
