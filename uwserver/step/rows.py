"""What a tick is made of, as rows for compiled code (`uwserver.step.tick`): the kinds of sensors, who is due when, and where a tick stands."""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.layout import STATE_SIZE, Codes, Forms, columns

(
    BEGIN, PILOTS, FORCES, FIND, MOVE, DRAW, FLOW, ARRIVALS, ROUND, RATES, EXACT, READ, REPEAT, PYTHON, WRITE, DELIVER, KEEP, HEAR, END,
) = range(19)  # fmt: skip
"""Stages of a tick, in their order; those from ROUND to KEEP follow each other again in each round of readings. A stage is also the name of what
Python is needed for, when a step stops there."""

DONE, ROOM, DIVERGED, CALLED, UNIT = range(100, 105)
"""Why a step stops otherwise: all ticks are made; there is no room for the samples of another; the state of a body is not finite; sensors may be
called in this tick; a unit of work is done, which somebody measures."""

WHEN_CALLED, WHEN_DUE, AS_REPEATED = range(3)
"""Rounds of a tick: sensors to which something has come that they wait for; those that are due; from there on those that repeat what the others have
read, those of a shorter interval first."""

NEEDS_RATES, NEEDS_EXACT, NEEDS_PYTHON, NEEDS_KEEPING, NEEDS_TEXTS, NEEDS_REPEATING = 1, 2, 4, 8, 16, 32
"""Of a round: accelerations; what a device would read without errors; readings or errors in Python; values that are no numbers wait there; sensors
that compiled code writes, and whose texts it tells (`sensors.writing.Writing`); sensors that repeat the numbers that others have read."""

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
        ),  # 1: times of one tick and the next are given, as they are no quotients of whole numbers of 64 bits, or no exact ones
        ("given_tick", _WHOLE),
        ("t_ns", _WHOLE),
        ("next_t_ns", _WHOLE),
        ("t", "f8"),  # s
        ("next_t", "f8"),
        ("step_pilots", _WHOLE),  # where code lies, 0 where there is nothing to be done: autopilots that step
        ("pilots_every", _WHOLE),  # ticks
        ("hear", _WHOLE),  # and listen
        ("tell", _WHOLE),  # and tell what they believe
        ("fill_flows", _WHOLE),  # at the bodies; 0 without a sea
        ("find_pairs", _WHOLE),  # that may touch, 0 where nothing can; then the lines between them, and contacts
        ("find_lines", _WHOLE),
        ("find_contacts", _WHOLE),
        ("cast", _WHOLE),  # rays; 0 in open water, where they meet nothing
        ("codes", np.dtype([(name, _WHOLE) for name in Codes._fields])),  # that carry bodies on
        ("deliver", _WHOLE),
        ("last_round", _WHOLE),
    ]
)
"""What is the same in all ticks."""

RUN = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "tick",  # ticks done
            "t_ns",  # time of the present one, from where the water has moved on
            "stage",  # of the one under way
            "round",
            "active",  # groups that are due in it
            "needs",  # of the round
            "due",  # sensors in the round
            "kinds",  # and kinds of them
            "turn",  # of these, the one that is to read next
            "begun",  # 1: samples of this tick were delivered
            "logged",  # entries of the log before it
            "ends",  # ticks in which somebody reads samples
            "written",  # how often sensors wrote
            "which",  # the row of a body, or how many samples need room
            "unit",  # stage of the unit that is done; of readings, `which` is its turn
            # What Python says before each call:
            "first",  # the tick at which this began
            "until",  # where it ends
            "forces_tick",  # when a part gives forces next
            "finds",  # 1: contacts are looked for by Python
            "follow_ns",  # when parts act next behind bodies and water, in Python
            "call_ns",  # when something comes to sensors that they wait for
            "callable",  # so many samples can come of these
            "slow",  # 1: some readings take time
            "looks_back",  # 1: Python looks at each tick in which somebody reads samples; 2: at all
            "measured",  # 1: each unit of work is measured
        )
    ]
)
"""Where a world stands in a tick."""

COPY = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "table",  # addresses: of the table that a step gets,
            "sensors",  # of those of its sensors and bodies,
            "world",
            "values",  # of the numbers of samples on their way,
            "told_values",  # and of those delivered
            "width",  # numbers of each
            "room",  # for so many samples
            "log_room",
            "tick",  # ticks done
            "why",  # it stopped
        )
    ]
)
"""One of many worlds that are stepped in one call."""

GROUP = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "divisor",  # they are due every so many ticks
            "next",  # and in this one
            "round",
            "first",  # of their heads in `scheduled`
            "count",
            "samples",  # that can come of them
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
"""Sensors that are due in the same ticks; those of an earlier round first."""

SHARE = np.dtype([(name, _WHOLE) for name in ("kind", "first", "count")])
"""Those of a group that are of one kind: their heads in `members`. The same of a whole round: in `turns`."""

KIND = np.dtype(
    [
        (name, _WHOLE)
        for name in (
            "code",  # where that of its loop lies
            "rows",  # their records
            "row_count",
            "row_size",  # bytes of one
            "by_rays",  # 1: they cast rays
            "aim",  # code that does so, 0 for none
            "aim_again",
        )
    ]
)
"""Sensors of a kind, which read together."""

WRITING = np.dtype([(name, _WHOLE) for name in ("head", "row", "stream_first", "stream_count", "first", "width")])
"""A sensor that writes: its head, its number, its streams, and where its reading stands."""

REPEATING = np.dtype([(name, _WHOLE) for name in ("head", "first", "count")])
"""A sensor that repeats: its head, and those streams in `repeated` whose last readings it tells."""

FORMS: Forms = {
    "course": COURSE,
    "run": RUN,
    "groups": GROUP,
    "active": columns(np.int64),  # groups that are due in the tick
    "world": columns(np.int64, 2),  # tables
    "now": columns(np.int64, 2),
    "intervals": columns(np.int64),  # from draw to draw of drifting currents, ticks
    "touching": columns(np.int64, 2),
    "pilots": columns(np.int64, 2),
    "kinds": KIND,
    "writings": WRITING,
    "repeatings": REPEATING,
    "repeated": columns(np.int64),
    "shares": SHARE,
    "scheduled": columns(np.int64),  # heads of all groups, one after the other
    "members": columns(np.int64),  # the same, those of a kind beside each other
    "due": columns(np.int64),  # heads of the round
    "turns": columns(np.int64),  # the same, those of a kind beside each other
    "turn": SHARE,  # of the round, in the order in which the kinds read
    "place": columns(np.int64),  # of each kind the number of its turn, -1 for none
    "ends": columns(np.int64),  # of the log, of each tick that had samples
    "shapes": columns(np.int64, 2),
    "pairs": columns(np.int64, 2),  # that may touch, and the rest of `collision.solids.Finding`
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
    "drifts": columns(np.float64, 2, 3),  # of these: velocity in N at both ends of an interval, m/s
    "origin": columns(np.float64, 3),  # of rays (`sensors.bank.reader`), for one reading after the other
    "direction": columns(np.float64, 3),
    "first": columns(np.int64),
    "distance": columns(np.float64),  # of their hits
    "normal": columns(np.float64, 3),
    "body": columns(np.int64),
    "material": columns(np.int64),
    "past": columns(np.int64),  # and of each the row of the body that carries its sensor, -1 where that is seen too
    "state": columns(np.float64, STATE_SIZE),
    "nu_dot": columns(np.float64, 6),
    "tau": columns(np.float64, 6),
}
"""Of the table that a step gets; what each tick looks at stands first, side by side."""
