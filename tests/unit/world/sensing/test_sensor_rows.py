"""Rows of a sensor: what is kept of it as bytes, wherever it lies."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec import structs
from sensing_rig import FIELDS, WORDS, Adds, Counter, Rig, side, slot_of, stream

from uwserver.modifiers import Bias, GaussMarkov
from uwserver.ports import Port
from uwserver.sensors import ImuConfig, Pose
from uwserver.world.sensing.sensor_arrays import SensorArrays
from uwserver.world.sensing.sensor_rows import SensorRows, SensorStream


def rows_in(sensor_arrays: SensorArrays) -> tuple[SensorRows, tuple[SensorStream, ...]]:
    bias, drift = (
        Bias(field="x", value=7.0).build(stream()),
        GaussMarkov(field="x", sigma=1.0, tau_s=1.0).build(stream()),
    )
    streams = SensorStream(slot_of().port, (bias, drift)), side("rov/x", "raw"), side("rov/x", "own", Adds(stream()))
    return SensorRows(sensor_arrays, Counter(), streams, 0, 5), streams


def test_last_readings_and_memories_are_kept_and_nothing_else() -> None:
    rows, streams = rows_in(Rig().sensor_arrays)
    remembered = sum(len(operation.numbers) for operation in streams[0].operations)
    number, memory, held, numbers = rows.save()
    assert (number, memory, len(held)) == (0, b"", 3 * 24)
    assert len(numbers) == 8 * (3 + remembered)
    assert 7.0 in np.frombuffer(numbers), "the bias that the first operation remembers"


def test_what_was_saved_in_one_place_can_be_loaded_in_another() -> None:
    arrays, others = Rig().sensor_arrays, Rig(slot_of(path="before")).sensor_arrays
    rows, other = rows_in(arrays)[0], rows_in(others)[0]
    rng = np.random.default_rng(1)
    held = np.array([[1, 0, 30], [0, 0, 0], [1, 1, 20]]).tobytes()
    numbers = rng.standard_normal(len(rows.save()[3]) // 8).tobytes()
    rows.load(12, b"", held, numbers)
    other.load(*rows.save())
    assert other.save() == (12, b"", held, numbers)
    assert other.held(0) == rows.held(0) == (False, (np.frombuffer(numbers)[0],))
    assert (other.held(1), other.held_ns()) == (None, 30)
    assert others.heads.rows["number"][other.head] == 12


def test_no_number_belongs_to_two() -> None:
    """Each stream and each operation writes its own, and all stand within what was taken."""
    arrays = Rig().sensor_arrays
    rows, streams = rows_in(arrays)
    head, used = rows.row, list[int]()
    used += range(head["first"], head["first"] + 1)
    for k, each in zip(rows.streams, streams, strict=True):
        row = arrays.streams.rows[k]
        used += [row["first"], row["newest_first"]] + [row["source"]] * each.is_ready_made
        first = row["operation_first"]
        operations = arrays.operations.rows[first : first + row["operation_count"]]
        for operation, placed in zip(each.operations, operations, strict=True):
            used += range(placed["memory"], placed["memory"] + len(operation.numbers))
    assert sorted(used) == list(range(min(used), min(used) + len(used)))


def test_a_compiled_sensor_brings_its_memory() -> None:
    sensor = ImuConfig(rate_hz=100.0).build(Pose())
    sensor.start(5)
    arrays = Rig().sensor_arrays
    rows = SensorRows(arrays, sensor, (SensorStream(slot_of().port),), 0, 0)
    _, memory, held, numbers = rows.save()
    assert len(memory) == sensor.kernel.record["m"].itemsize  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="bytes of memory"):
        rows.check(memory[1:], held, numbers)
    rows.give_back()
    assert sensor.heads is not arrays.heads  # type: ignore[attr-defined]


def test_no_dictionary_is_kept_of_each_sensor() -> None:
    """A hundred vehicles have a thousand sensors: that was 2 kB a vehicle."""
    assert not hasattr(rows_in(Rig().sensor_arrays)[0], "__dict__")


PORT = Port("rov/x", "sensor", "x", FIELDS, "", 24.0)


def test_a_stream_is_made_in_python_where_one_of_its_errors_is() -> None:
    bias = Bias(field="x", value=1.0).build(stream())
    assert SensorStream(PORT, (bias,)).operations == (bias,)
    mixed = SensorStream(PORT, (bias, Adds(stream())))
    assert (mixed.operations, mixed.is_ready_made) == ((), True)


def test_what_is_no_number_is_not_kept_as_one() -> None:
    words = SensorStream(structs.replace(PORT, fields=WORDS))
    assert (words.kept, words.columns.loose) == (1, (1,))
