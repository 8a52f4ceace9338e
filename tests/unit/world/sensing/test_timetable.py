"""When which sensors read, and what they need of Python."""

from __future__ import annotations

from sensing_rig import Adds, Counter, Repeater, Rig, Speaker, slot_of, stream

import uwserver
from uwserver.sensors.compiled import CompiledSensor
from uwserver.step.rows import (
    AS_REPEATED,
    NEEDS_EXACT,
    NEEDS_KEEPING,
    NEEDS_PYTHON,
    NEEDS_RATES,
    NEEDS_TEXTS,
    WHEN_DUE,
)
from uwserver.world.sensing.timetable import groups_of, needs_of, timetable_of


def test_those_of_a_shorter_interval_come_first_and_who_repeats_has_rounds_of_its_own() -> None:
    kinds = {"a": (4, Counter), "b": (2, Counter), "c": (2, Repeater), "d": (4, Counter), "e": (8, Repeater)}
    slots = [slot_of(path=path, divisor=divisor, kind=kind) for path, (divisor, kind) in kinds.items()]
    found = [(group.round, group.divisor, [slot.path for slot in group.slots]) for group in groups_of(slots)]
    assert found == [
        (WHEN_DUE, 2, ["b"]),
        (WHEN_DUE, 4, ["a", "d"]),
        (AS_REPEATED, 2, ["c"]),
        (AS_REPEATED + 1, 8, ["e"]),
    ]
    slots[0].active = False
    assert [slot.path for slot in groups_of(slots)[1].slots] == ["d"]


def test_what_is_written_in_python_needs_it_and_texts_wait_there() -> None:
    assert needs_of([slot_of()]) == NEEDS_PYTHON
    assert needs_of([slot_of(kind=Speaker)]) == NEEDS_PYTHON | NEEDS_KEEPING
    assert needs_of([slot_of(Adds(stream()))]) == NEEDS_PYTHON
    assert needs_of([]) == 0


def test_of_a_vehicle_compiled_code_does_everything_and_writes_what_its_autopilot_says() -> None:
    world = uwserver.load("bluerov2_qgc").core
    needs = {path.partition("/")[2]: needs_of([slot]) for path, slot in world.sensors.items()}
    assert needs.pop("autopilot/state") == NEEDS_TEXTS
    assert set(needs.values()) <= {0, NEEDS_RATES}
    assert not any(need & (NEEDS_EXACT | NEEDS_PYTHON | NEEDS_KEEPING) for need in needs.values())


def test_heads_of_a_group_stand_together_and_those_of_a_kind_beside_each_other() -> None:
    world = uwserver.load("bluerov2_qgc").core
    made = timetable_of(world.sensing.groups, world.sensor_arrays)
    for group, row in zip(world.sensing.groups, made.rows["groups"], strict=True):
        heads = made.rows["scheduled"][row["first"] : row["first"] + row["count"]].tolist()
        assert heads == [slot.head for slot in group.slots]
        assert row["samples"] == sum(len(slot.streams) for slot in group.slots)
        shares = made.rows["shares"][row["share_first"] : row["share_first"] + row["share_count"]]
        for kind, first, count in shares.tolist():
            members = made.rows["members"][first : first + count].tolist()
            kernel = made.kernels[kind]
            assert members == [
                s.head for s in group.slots if isinstance(s.sensor, CompiledSensor) and s.sensor.kernel is kernel
            ]
    kinds = made.rows["kinds"]
    assert kinds["by_rays"].tolist() == [bool(kernel.aims) for kernel in made.kernels]
    assert kinds["by_rays"].any()
    assert kinds["code"].all()
    assert kinds["row_size"].tolist() == [kernel.record.itemsize for kernel in made.kernels]


def test_a_rig_without_sensors_makes_its_ticks() -> None:
    assert Rig().samples(1) == []
