"""What is to be done in ticks to come, as rows: which kernels let which sensors read, for compiled code that makes several ticks (`ticking`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.layout import STATE_SIZE, Forms, columns
from uwserver.physics.rays.raycast import no_hits
from uwserver.sensors.bank import Bank, codes_of
from uwserver.world.due import Due
from uwserver.world.instruments import Instruments
from uwserver.world.sensor_slot import SensorSlot

USUAL, LONGEST = 64, 256
"""Ticks that are made in one go, some 0.2 ms of one vehicle; and while the loop has the interpreter, or where nobody waits for their end."""

READING = np.dtype([(name, "i8") for name in ("code", "rows", "row_count", "due", "due_count", "rays")])
"""Sensors of a kind that read together: where the code of the kind lies, their records, and the numbers of the heads that are due; and the number of
their RAYS, -1 for none."""

RAYS = np.dtype([(name, "i8") for name in ("aim", "aim_again", "count")])
"""What sensors need that read by rays: where code lies that aims, once or (else 0) twice, and so many rays at most."""
_AIMS = 2

WRITING = np.dtype([(name, "i8") for name in ("head", "row", "stream_first", "stream_count", "first", "width")])
"""A sensor that writes (`sensors.writing.Writing`): its head, its number, its streams, and where its reading stands."""

PLAN = np.dtype(
    [
        ("compiled", "i8"),  # 0: something of it needs Python
        ("first", "i8"),  # of its readings
        ("count", "i8"),
        ("writing_first", "i8"),
        ("writing_count", "i8"),
        ("needs_rates", "i8"),  # 1: a sensor needs accelerations
        ("heads", "i8"),  # numbers of the heads of all
        ("head_count", "i8"),
        ("most", "i8"),  # samples that can come of them
    ]
)
"""Sensors that are due in one tick (`Due`)."""

COURSE = np.dtype(
    [
        ("dt", "f8"),  # of a tick, s
        ("margin", "f8"),  # of the search for contacts, m
        ("rate", "i8"),  # rate / parts is that of the ticks, Hz
        ("parts", "i8"),
        ("step_pilots", "i8"),  # where code lies, 0 where there is nothing to be done: autopilots that step
        ("pilots_every", "i8"),  # ticks
        ("hear", "i8"),  # and listen
        ("tell", "i8"),  # and tell what they believe
        ("find_pairs", "i8"),
        ("cast", "i8"),  # rays; 0 in open water, where they meet nothing
        ("move", "i8"),  # bodies
        ("look", "i8"),  # at accelerations
        ("deliver", "i8"),
    ]
)
"""What is the same in all ticks."""

TICK, STAGE, ROW, ENDS, WORDY, WRITTEN, REACHED_SIZE = range(7)
"""Of what is reached: the tick; the stage of it; of a body whose state is not finite; how many ticks had samples that somebody reads; whether the
last one had some with values that are no numbers; and how often sensors wrote."""

STANDS, AT_PILOTS, AT_CONTACTS, DIVERGED = range(4)
"""Stages: between two ticks; autopilots have stepped, and some need Python; the bodies may touch something, and have not moved yet; they have, and
the state of one is not finite."""

FORMS: Forms = {
    "course": COURSE,
    "plans": PLAN,
    "phases": columns(np.int64),  # the plan of each tick of a period
    "readings": READING,
    "rays": RAYS,
    "writings": WRITING,
    "reached": columns(np.int64),
    "ends": columns(np.int64),  # of the log, of each tick that had samples
    "world": columns(np.int64, 2),  # tables
    "now": columns(np.int64, 2),
    "pilots": columns(np.int64, 2),
    "shapes": columns(np.int64, 2),
    "pairs": columns(np.int64, 2),
    "solids": columns(np.int64, 2),
    "origin": columns(np.float64, 3),  # of rays (`sensors.bank.reader`), for one reading after the other
    "direction": columns(np.float64, 3),
    "first": columns(np.int64),
    "distance": columns(np.float64),  # of their hits
    "normal": columns(np.float64, 3),
    "body": columns(np.int64),
    "material": columns(np.int64),
    "past": columns(np.int64),  # and of each the row of the body that carries its sensor
    "state": columns(np.float64, STATE_SIZE),
    "nu_dot": columns(np.float64, 6),
    "tau": columns(np.float64, 6),
}
"""Of the table that `ticking` gets."""


class Agenda(NamedTuple):
    """Who is due in each tick of a period.

    Attributes:
        rows: of `FORMS`, by name.
        ahead: by the number of a tick in its period, how many ticks from there on need no Python for their sensors, up to LONGEST.
        kept: arrays that the others name by their addresses.
    """

    rows: dict[str, Any]
    ahead: tuple[int, ...]
    kept: tuple[Any, ...]


class _Maker:
    """Makes rows of an agenda.

    Attributes:
        plans, readings, rays, writings: as they are to be.
        most_heads: of sensors that read together by rays.
        kept: what is named by its address.
    """

    def __init__(self, instruments: Instruments, casts: bool) -> None:
        """Of sensors that lie in these instruments; `casts`: compiled code can cast rays."""
        self._instruments, self._casts = instruments, casts
        self.most_heads = 0
        self.plans: list[tuple[int, ...]] = []
        self.readings: list[tuple[int, ...]] = []
        self.rays: list[tuple[int, ...]] = []
        self.writings: list[tuple[int, ...]] = []
        self.kept: list[Any] = []

    def _at(self, array: Any) -> int:
        self.kept.append(array)
        return int(array.ctypes.data)

    def add_plan(self, due: Due) -> None:
        """What is due in one tick."""
        first, writing_first, is_compiled = len(self.readings), len(self.writings), due.compiled is not None
        if due.compiled is not None:
            is_compiled = all(self._add_reading(bank, heads) for bank, heads in due.compiled.kinds)
            for slot in due.compiled.written:
                self._add_writing(slot)
        self.plans.append((
            is_compiled, first, len(self.readings) - first, writing_first, len(self.writings) - writing_first,
            due.needs_rates, self._at(due.heads), len(due.heads), due.most,
        ))  # fmt: skip

    def _add_reading(self, bank: Bank, heads: IntArray) -> bool:
        """Returns whether compiled code can call the kind's loops."""
        *aims, code = codes_of(bank)
        rows, rays = self._instruments.rows_of(bank).rows, -1
        if aims:
            rays = len(self.rays)
            count = int(self._instruments.heads.rows["rays"][heads].sum())
            self.rays.append((*(*aims, 0)[:_AIMS], count))
            self.most_heads = max(self.most_heads, len(heads))
        self.readings.append((code, self._at(rows), len(rows), self._at(heads), len(heads), rays))
        return (self._casts or not aims) and len(aims) <= _AIMS and all((*aims, code))

    def _add_writing(self, slot: SensorSlot) -> None:
        writing, numbers = slot.sensor.writing, slot.stream_numbers
        assert writing is not None
        head = self._instruments.heads.rows[slot.head]
        self.writings.append(
            (slot.head, writing.row, numbers.start, len(numbers), int(head["first"]), int(head["width"]))
        )


def agenda_of(masks: Sequence[int], plan_of: Callable[[int], Due], instruments: Instruments, *, casts: bool) -> Agenda:
    """The agenda of a world.

    Args:
        masks: for each tick of a period which sensors are due.
        plan_of: those of a mask.
        instruments: where they lie.
        casts: compiled code can cast rays.
    """
    numbers, made = {mask: k for k, mask in enumerate(dict.fromkeys(masks))}, _Maker(instruments, casts)
    for mask in numbers:
        made.add_plan(plan_of(mask))
    most = max([rays[-1] for rays in made.rays], default=0)
    instruments.rays.grow(most)
    rows = {
        "plans": np.array(made.plans, PLAN),
        "phases": np.array([numbers[mask] for mask in masks], np.int64),
        "readings": np.array(made.readings, READING),
        "rays": np.array(made.rays, RAYS),
        "writings": np.array(made.writings, WRITING),
        "origin": instruments.rays.origin,
        "direction": instruments.rays.direction,
        "first": np.zeros(made.most_heads + 1, np.int64),
        "past": np.zeros(most, np.int64),
        **no_hits(most)._asdict(),
    }
    return Agenda(rows, _ahead([bool(made.plans[numbers[mask]][0]) for mask in masks]), tuple(made.kept))


def _ahead(compiled: Sequence[bool]) -> tuple[int, ...]:
    """Of ticks that follow each other in a circle: how many behind each are so."""
    period, ahead = len(compiled), 0
    found = [0] * period
    for _ in range(1 + LONGEST // period):  # round the circle, so that those before its end know of those behind it
        for k in range(period - 1, -1, -1):
            found[k] = ahead
            ahead = min(LONGEST, ahead + 1) if compiled[k] else 0
    return tuple(found)
