"""The streams of a sensor, its places in the arrays of its world, and its state there as bytes."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, structs

from uwserver.modifiers import Modifier
from uwserver.modifiers.columns import Columns, columns_of
from uwserver.modifiers.operations import Operation
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Port, Value
from uwserver.sensors import Sensor
from uwserver.sensors.acoustic.cross_talk import Sonar
from uwserver.sensors.compiled import HEAD, CompiledSensor
from uwserver.step.streams import HELD, STREAM
from uwserver.world.parts.part import Count, State
from uwserver.world.sensing.computing import Loose, wait_for_values
from uwserver.world.sensing.sensor_arrays import SensorArrays

Held = tuple[bool, tuple[Value, ...]] | None
"""The last reading: whether it is valid, and its values. None before the first reading."""
_FLOAT = 8
"""Bytes of a number."""


@dataclass(slots=True, eq=False)
class SensorStream:
    """A stream of samples of one sensor, with its own errors.

    Values that are no numbers (texts, pictures) have no place in the arrays and are called loose.

    Attributes:
        port: the port at which the samples are delivered.
        modifiers: the errors of the stream, in their order.
        ideal: whether the stream starts from the values that the device would read without any errors.
        columns: which numbers of a row belong to which field.
        operations: the errors, if compiled code makes all of them; else empty.
        is_ready_made: whether Python makes the readings, because an error is written in Python.
        fresh: loose values of the present reading.
        loose: loose values of the last reading that was not lost; empty before the first.
        coming: loose values of samples that are not delivered yet, by sequence number.
        newest: loose values of the newest delivered sample.
    """

    port: Port
    modifiers: tuple[Modifier, ...] = ()
    ideal: bool = False
    columns: Columns = field(init=False)
    operations: tuple[Operation, ...] = field(init=False)
    is_ready_made: bool = field(init=False)
    fresh: Loose = ()
    loose: Loose = ()
    coming: dict[int, Loose] = field(default_factory=dict)
    newest: Loose = ()

    def __post_init__(self) -> None:
        self.columns = columns_of(self.port.fields)
        operations = tuple([m for m in self.modifiers if isinstance(m, Operation)])
        self.is_ready_made = len(operations) < len(self.modifiers)
        self.operations = () if self.is_ready_made else operations

    @property
    def kept(self) -> int:
        """How many numbers a state keeps of this stream: those of the last reading, and the memory of its operations."""
        return self.columns.width + sum([len(operation.numbers) for operation in self.operations])


class SensorState(State, frozen=True, omit_defaults=True):
    """The state of one sensor.

    Attributes:
        number: number of readings made; it also decides which random numbers come next.
        active, divisor: those of the slot.
        settings, memory: those of the sensor, as msgpack; empty if it has none.
        held: HELD of each stream (`uwserver.step.streams`), the sensor's own stream first.
        numbers: float64 of each stream: the last reading, then the memory of its operations.
        loose: values of the last reading of each stream that are no numbers; empty if it has none.
        modifiers: memories of the modifiers of streams whose readings are made in Python.
        pictures: takes the place of `loose` for a sensor that takes time.
    """

    number: Count
    active: bool
    divisor: Annotated[int, Meta(ge=1, le=2**32)]
    settings: bytes
    memory: bytes
    held: bytes
    numbers: bytes
    loose: tuple[tuple[Value, ...], ...]
    modifiers: tuple[bytes, ...]
    pictures: tuple[tuple[Value, ...], ...] = ()

    def deciding(self) -> SensorState:
        """Leave the pictures out: they follow from the other values, and may still be under computation."""
        return structs.replace(self, pictures=()) if self.pictures else self

    def completed(self) -> SensorState:
        """Wait for the pictures, and put them in."""
        return structs.replace(self, pictures=computed(self.pictures))


def computed(pictures: Iterable[Loose]) -> tuple[tuple[Value, ...], ...]:
    """Wait for pictures under computation. Returns the values of all pictures."""
    return tuple([wait_for_values(loose) for loose in pictures])


def _offset(form: np.dtype[Any], name: str) -> int:
    """Return the byte at which a field of a record begins."""
    assert form.fields is not None
    return int(form.fields[name][1])


def _bytes(first: int, count: int) -> slice:
    return slice(first, first + count)


_NUMBER, _HELD = _offset(HEAD, "number"), _offset(STREAM, "held")


class SensorRows:
    """The rows of one sensor: a head, a row for each stream, their operations, and numbers.

    The numbers that a state keeps stand first: for each stream the last reading with its errors, and the memory of its operations. The
    numbers behind them are made anew by each reading.

    Attributes:
        sensor_arrays: the arrays.
        head: number of the head.
        streams: numbers of the streams.
        reading: place at which the numbers of the present reading begin.
    """

    __slots__ = (
        "_compiled", "_count", "_first", "_held_at", "_kept", "_kept_at", "_memory_at", "_number_at", "_operations", "_pools", "_remembering",
        "_sensor", "_sonar", "_streams", "head", "reading", "sensor_arrays", "streams",
    )  # fmt: skip

    def __init__(
        self, sensor_arrays: SensorArrays, sensor: Sensor, streams: Sequence[SensorStream], body: int, latency_ns: int
    ) -> None:
        """Take rows for a sensor on this body, with errors that have no memory yet."""
        self.sensor_arrays, self._sensor, self._streams = sensor_arrays, sensor, streams
        self._compiled = sensor if isinstance(sensor, CompiledSensor) else None
        self._sonar = sensor if isinstance(sensor, Sonar) else None
        if self._compiled is not None:
            self._compiled.enter(sensor_arrays.heads, sensor_arrays.rows_of(self._compiled.kernel))
            self.head = self._compiled.head
        else:
            self.head = sensor_arrays.heads.take(1)
        width, ideal = streams[0].columns.width, any(stream.ideal for stream in streams)
        self._kept = sum(stream.kept for stream in streams)
        made = width * (1 + ideal + sum(2 if stream.is_ready_made else 1 for stream in streams))
        self._first, self._count = sensor_arrays.numbers.take(self._kept + made), self._kept + made
        first = sensor_arrays.streams.take(len(streams))
        self.streams = range(first, first + len(streams))
        self._operations: list[tuple[int, int]] = []
        self.reading = at = self._first + self._kept
        head = sensor_arrays.heads.rows[self.head]
        head["body"], head["first"], head["width"], head["latency_ns"] = body, at, width, latency_ns
        head["stream_first"], head["stream_count"] = first, len(streams)
        head["exact_first"] = at + width if ideal else -1
        head["voice"] = -1 if self._sonar is None else sensor_arrays.voices.take(1)
        self._fill_streams(at, at + width * (1 + ideal))
        self._find_state_bytes()

    def _find_state_bytes(self) -> None:
        """Find where the bytes of the state stand in the arrays. Done once, as a state is taken between two ticks and must be quick."""
        sensor_arrays, compiled = self.sensor_arrays, self._compiled
        memories = None if compiled is None else compiled.rows
        self._pools = sensor_arrays.heads, sensor_arrays.streams, sensor_arrays.numbers, memories
        self._number_at = _bytes(self.head * HEAD.itemsize + _NUMBER, 8)
        self._held_at = [_bytes(k * STREAM.itemsize + _HELD, HELD.itemsize) for k in self.streams]
        self._kept_at = _bytes(self._first * _FLOAT, self._kept * _FLOAT)
        if compiled is not None:
            record = compiled.kernel.record
            self._memory_at = _bytes(compiled.row * record.itemsize + _offset(record, "m"), record["m"].itemsize)

    def _fill_streams(self, reading: int, made: int) -> None:
        """Fill the rows of the streams. `reading` is the place of the present reading; `made` is the place behind it, and behind the
        reading without errors."""
        sensor_arrays, at = self.sensor_arrays, self._first
        self._remembering: list[tuple[Operation, int]] = []
        for k, stream in zip(self.streams, self._streams, strict=True):
            row, width = sensor_arrays.streams.rows[k], stream.columns.width
            row["width"], row["exact"], row["ready_made"] = width, stream.ideal, stream.is_ready_made
            row["first"], row["newest_first"] = at, made
            if stream.is_ready_made:
                row["source"], made = made + width, made + 2 * width
            else:
                row["source"], made = reading + width * stream.ideal, made + width
            count = sum(len(operation.rows) for operation in stream.operations)
            place = sensor_arrays.operations.take(count)
            row["operation_first"], row["operation_count"] = place, count
            self._operations.append((place, count))
            at += width
            for operation in stream.operations:
                end = place + len(operation.rows)
                rows = sensor_arrays.operations.rows[place:end]
                rows[:] = operation.rows
                rows["memory"] = at
                if len(operation.numbers):
                    self._remembering.append((operation, at - self._first))
                    sensor_arrays.numbers.rows[at : at + len(operation.numbers)] = operation.numbers
                place, at = end, at + len(operation.numbers)

    def give_back(self) -> None:
        """Give all rows back."""
        sensor_arrays = self.sensor_arrays
        for place, count in self._operations:
            sensor_arrays.operations.give_back(place, count)
        sensor_arrays.streams.give_back(self.streams.start, len(self.streams))
        sensor_arrays.numbers.give_back(self._first, self._count)
        if self._sonar is not None:
            voice = int(self.row["voice"])
            sensor_arrays.voices.rows["works"][voice] = 0
            sensor_arrays.voices.give_back(voice, 1)
        if self._compiled is not None:
            self._compiled.leave()
        else:
            sensor_arrays.heads.give_back(self.head, 1)

    # -- the present reading -------------------------------------------------------------------------------------------------------

    @property
    def row(self) -> Any:
        """The head."""
        return self.sensor_arrays.heads.rows[self.head]

    def numbers(self, first: int, width: int) -> FloatArray:
        """Return a view, which can be written, of `width` numbers from the place `first` on."""
        found: FloatArray = self.sensor_arrays.numbers.rows[first : first + width]
        return found

    def set_time(self, dt: float) -> None:
        """Set the time from one reading to the next, s."""
        self.sensor_arrays.heads.rows["dt"][self.head] = dt
        self.sensor_arrays.streams.rows["dt"][self.streams.start : self.streams.stop] = dt

    def speak(self, works: bool) -> None:
        """Tell the sonars in compiled code how this sensor sounds now, and whether it works."""
        if self._sonar is not None:
            row = self.row
            voice = self.sensor_arrays.voices.rows[row["voice"]]
            voice["body"], voice["works"] = row["body"], works
            self._sonar.speak(voice)

    def set_fault(self, fault: str) -> None:
        """Set the fault of the sensor."""
        self.sensor_arrays.heads.rows["silent"][self.head] = fault == "silent"
        self.sensor_arrays.streams.rows["frozen"][self.streams.start : self.streams.stop] = fault != ""

    def held(self, k: int) -> tuple[bool, tuple[Value, ...]] | None:
        """Return the last reading of its k-th stream: whether it is valid, and its values."""
        row, stream = self.sensor_arrays.streams.rows[self.streams[k]], self._streams[k]
        held = row["held"]
        if not held["there"]:
            return None
        return bool(held["valid"]), stream.columns.unpack(
            self.numbers(row["first"], row["width"]), wait_for_values(stream.loose)
        )

    def held_ns(self) -> int:
        """Return the time of the last reading of its own stream."""
        return int(self.sensor_arrays.streams.rows["held"]["t_ns"][self.streams.start])

    # -- the state ---------------------------------------------------------------------------------------------------------------

    def save(self) -> tuple[int, bytes, bytes, bytes]:
        """Return the number of readings, the memory of a compiled sensor, HELD of each stream, and the numbers that are kept."""
        heads, streams, numbers, memories = self._pools
        held = b"".join([streams.raw[at] for at in self._held_at])
        return (
            int.from_bytes(heads.raw[self._number_at], "little"),
            b"" if memories is None else bytes(memories.raw[self._memory_at]),
            held,
            bytes(numbers.raw[self._kept_at]),
        )

    def check(self, memory: bytes, held: bytes, numbers: bytes) -> None:
        """Raise ValueError if a state from outside is not possible for this sensor."""
        compiled = self._compiled
        if compiled is not None:
            form = compiled.kernel.record["m"]
            if len(memory) != form.itemsize:
                raise ValueError(f"{len(memory)} bytes of memory, not {form.itemsize}")
            if compiled.memory_type.__struct_fields__:
                compiled.valid(compiled.memory_of(np.frombuffer(memory, form)[0]))
        if len(held) != HELD.itemsize * len(self.streams):
            raise ValueError("other streams than this sensor has")
        for there, valid, t_ns in struct.iter_unpack("=3q", held):
            if there not in (0, 1) or valid not in (0, 1) or not 0 <= t_ns <= 2**62:
                raise ValueError("a last reading is not possible")
        if len(numbers) != _FLOAT * self._kept:
            raise ValueError(f"{len(numbers)} bytes of readings and modifiers, not {_FLOAT * self._kept}")
        for operation, at in self._remembering:
            operation.valid(operation.record(np.frombuffer(numbers, count=len(operation.numbers), offset=at * _FLOAT)))

    def load(self, number: int, memory: bytes, held: bytes, numbers: bytes) -> None:
        """Take over a checked state. No sample counts as delivered since."""
        heads, streams, kept, memories = self._pools
        heads.raw[self._number_at] = number.to_bytes(8, "little")
        if memories is not None:
            memories.raw[self._memory_at] = memory
        for k, at in enumerate(self._held_at):
            streams.raw[at] = held[k * HELD.itemsize : (k + 1) * HELD.itemsize]
        streams.rows["newest"][self.streams.start : self.streams.stop] = 0
        kept.raw[self._kept_at] = numbers
