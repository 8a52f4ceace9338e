"""The rows on which the step works (`uwserver.step.tick`): kinds of sensors, when each sensor is due, and how far a tick has come."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.layout import STATE_SIZE, Codes, Forms, columns

(
    BEGIN, PILOTS, FORCES, FIND, MOVE, DRAW, FLOW, ARRIVALS, ROUND, RATES, EXACT, READ, REPEAT, PYTHON, WRITE, DELIVER, KEEP, LISTEN, END,
) = range(19)  # fmt: skip
"""Stages of a tick, in their order. Those from ROUND to KEEP come again in each round of readings. A step that stops for Python returns the stage."""

DONE, ROOM, DIVERGED, CALLED, UNIT = range(100, 105)
"""Other reasons to stop: all ticks are made; there is no room for the samples of the next tick; the state of a body is not finite; an event may have
come for sensors that wait for one; a unit of work is done, which a profile measures."""

WHEN_CALLED, WHEN_DUE, AS_REPEATED = range(3)
"""Rounds of a tick: sensors that have waited for an event; sensors that are due; from there on compounds, those with a shorter interval first."""

NEEDS_RATES, NEEDS_EXACT, NEEDS_PYTHON, NEEDS_KEEPING, NEEDS_TEXTS, NEEDS_REPEATING = 1, 2, 4, 8, 16, 32
"""What a round needs, as bits: accelerations; readings without errors; readings or errors in Python; values that are no numbers and wait in Python;
status sensors, whose texts compiled code chooses (`sensors.others.Writing`); compounds."""

NOTHING_POSTED = np.zeros(1, np.int64)
"""For a step that no other thread ends (`tick.step`). Never changed."""

_WHOLE = "i8"

COURSE = np.dtype(
    [
        ("dt", "f8"),  # of a tick, s
        ("margin", "f8"),  # of the search for contacts, m
        ("rate", _WHOLE),  # rate / parts is that of the ticks, Hz
        ("parts", _WHOLE),
        (
            "given",
            _WHOLE,
        ),  # 1: Python gives the times of one tick and the next, where 64-bit numbers cannot hold them exactly
        ("given_tick", _WHOLE),
        ("t_ns", _WHOLE),
        ("next_t_ns", _WHOLE),
        ("t", "f8"),  # s
        ("next_t", "f8"),
        ("step_pilots", _WHOLE),  # address of the code that steps autopilots; here and below 0: nothing to do
        ("pilots_every", _WHOLE),  # ticks
        ("listen", _WHOLE),  # lets autopilots take in samples
        ("tell", _WHOLE),  # writes the status of autopilots
        ("fill_flows", _WHOLE),  # finds the water at the bodies
        ("find_pairs", _WHOLE),  # finds pairs of shapes that may touch; then the lines between them, and the contacts
        ("find_lines", _WHOLE),
        ("find_contacts", _WHOLE),
        ("cast", _WHOLE),  # casts rays; 0: in open water rays meet nothing
        ("codes", np.dtype([(name, _WHOLE) for name in Codes._fields])),  # move the bodies
        ("deliver", _WHOLE),
        ("last_round", _WHOLE),
    ]
)
"""What stays the same in all ticks. An address of code is 0 where there is nothing to do."""

RUN = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "tick",  # ticks done
            "t_ns",  # time of the present tick, set once the water has moved
            "stage",  # of the present tick
            "round",
            "active",  # number of groups that are due
            "needs",  # bits of the present round
            "due",  # number of sensors in the round
            "kinds",  # number of their kinds
            "turn",  # number of the kind that reads next
            "begun",  # 1: samples of this tick were delivered
            "logged",  # entries in the log before this tick
            "ends",  # number of ticks with samples that somebody reads
            "written",  # number of readings by status sensors
            "which",  # row of a body, or number of samples that need room, with the reason to stop
            "unit",  # stage of the unit of work that is done; for readings `which` is the turn
            # Python sets the following before each call:
            "first",  # tick at which the call begins
            "until",  # tick at which it ends
            "forces_tick",  # next tick in which a part gives forces
            "finds",  # 1: Python looks for contacts
            "follow_ns",  # time from which parts act in Python, behind bodies and water
            "call_ns",  # time of the next event for sensors that wait for one
            "callable",  # number of samples that these sensors can give
            "slow",  # 1: some readings are computed in other threads
            "looks_back",  # 1: stop after each tick with samples that somebody reads; 2: after every tick
            "measured",  # 1: a profile measures each unit of work
        )
    ]
)
"""How far the tick of a world has come."""

COPY = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "table",  # addresses: of the table of the step,
            "sensors",  # of the tables of its sensors and bodies,
            "world",
            "values",  # of the numbers of samples in flight,
            "delivered_values",  # and of the delivered samples
            "width",  # numbers of a sample
            "room",  # samples for which there is room
            "log_room",
            "tick",  # ticks done
            "why",  # reason of the last stop
        )
    ]
)
"""One of many worlds that one call steps."""

GROUP = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "divisor",  # interval, ticks
            "next",  # the next tick in which the group is due
            "round",
            "first",  # place of its first head in `scheduled`
            "count",
            "samples",  # number that the group can give
            "needs",
            "share_first",
            "share_count",
            "writing_first",
            "writing_count",
            "repeating_first",
            "repeating_count",
        )
    ]
)
"""Sensors that are due in the same ticks. Groups of an earlier round come first."""

SHARE = np.dtype([(name, _WHOLE) for name in ("kind", "first", "count")])
"""The sensors of one kind in a group: their heads in `members`. In a whole round: their heads in `turns`."""

KIND = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "code",  # address of the loop
            "rows",  # address of the records
            "row_count",
            "row_size",  # bytes of a record
            "by_rays",  # 1: they cast rays
            "aim",  # address of the code that aims the rays; 0 for none
            "aim_again",
        )
    ]
)
"""A kind of sensor. Sensors of one kind read together."""

WRITING = np.dtype([(name, _WHOLE) for name in ("head", "row", "stream_first", "stream_count", "first", "width")])
"""A status sensor: its head, its number, its streams, and the place of its reading."""

REPEATING = np.dtype([(name, _WHOLE) for name in ("head", "first", "count")])
"""A compound: its head, and the streams (in `repeated`) whose last readings it gives."""

FORMS: Forms = {
    "course": COURSE,
    "run": RUN,
    "groups": GROUP,
    "active": columns(np.int64),  # groups that are due in the tick
    "world": columns(np.int64, 2),  # tables
    "surroundings": columns(np.int64, 2),
    "intervals": columns(np.int64),  # of drifting currents: ticks from draw to draw
    "touching": columns(np.int64, 2),
    "pilots": columns(np.int64, 2),
    "kinds": KIND,
    "writings": WRITING,
    "repeatings": REPEATING,
    "repeated": columns(np.int64),
    "shares": SHARE,
    "scheduled": columns(np.int64),  # heads of all groups, group by group
    "members": columns(np.int64),  # the same heads, kind by kind within a group
    "due": columns(np.int64),  # heads of the round
    "turns": columns(np.int64),  # the same heads, kind by kind
    "turn": SHARE,  # of the round, in the order in which the kinds read
    "place": columns(np.int64),  # number of the turn of each kind, -1 for none
    "ends": columns(np.int64),  # end of the log after each tick with samples
    "shapes": columns(np.int64, 2),
    "pairs": columns(
        np.int64, 2
    ),  # shapes that may touch; this and the next seven are those of `collision.solids.Finding`
    "line_first": columns(np.int64),
    "lines": columns(np.float64, 7),
    "overlapping": columns(np.bool_),
    "bodies": columns(np.int64, 2),
    "numbers": columns(np.float64, 7),
    "keys": columns(np.int64),
    "coefficients": columns(np.float64, 2),
    "led": columns(np.int64),
    "contact_nu_dot": columns(np.float64, 6),
    "solids": columns(np.int64, 2),
    "drifts": columns(np.float64, 2, 3),  # of drifting currents: velocity in N at both ends of the interval, m/s
    "origin": columns(np.float64, 3),  # of rays (`sensors.compiled.ray_loop`), reading by reading
    "direction": columns(np.float64, 3),
    "first": columns(np.int64),
    "distance": columns(np.float64),  # of the hits of these rays
    "normal": columns(np.float64, 3),
    "body": columns(np.int64),
    "material": columns(np.int64),
    "past": columns(np.int64),  # row of the body that carries the sensor of a ray, which does not hit it; -1: it may
    "state": columns(np.float64, STATE_SIZE),
    "nu_dot": columns(np.float64, 6),
    "tau": columns(np.float64, 6),
}
"""The arrays in the table of a step. Those that every tick uses stand first, side by side."""
