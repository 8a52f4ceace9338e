"""A sensor in a world: when it is due, its streams and their errors, and where in the world's arrays all that lies."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from msgspec import msgpack, structs

from uwserver.modifiers import Measurement
from uwserver.modifiers.base import Memory
from uwserver.modifiers.operations import Operation
from uwserver.ports import Field, Port, Value
from uwserver.ports.checks import check_values
from uwserver.sensors import Scope, Sensor
from uwserver.sensors.bank import BankSensor
from uwserver.sensors.base import blank
from uwserver.sensors.wiring import Wiring
from uwserver.world.components import Held, SensorState, SensorStream, StreamState
from uwserver.world.instruments import Instruments
from uwserver.world.part import Part, read_record, record

Fault = Literal["", "frozen", "silent"]


class SensorSlot(Part):
    """A sensor in the world.

    Attributes:
        row: of the body that carries it.
        sensor: what reads.
        streams: its own, then those beside it.
        rate_hz: of the physics.
        divisor: it measures every so many ticks.
        latency_ns: of the device.
        active: it measures at all.
        wiring: the inside of its vehicle.
        twin: the instrument without errors that ideal streams read, where the sensor is written in Python.
        head: its number among the heads of the world.
    """

    state_type = SensorState

    def __init__(
        self,
        sensor: Sensor,
        streams: tuple[SensorStream, ...],
        row: int,
        rate_hz: Fraction,
        divisor: int,
        latency_ns: int = 0,
        twin: Sensor | None = None,
    ) -> None:
        self.sensor, self.streams, self.row, self.rate_hz, self.divisor = sensor, streams, row, rate_hz, divisor
        self.latency_ns, self.twin = latency_ns, twin
        self.active = True
        self.wiring: Wiring | None = None
        self.head = -1
        self._fault: Fault = ""
        self._in: Instruments | None = None
        self._rest: SensorState | None = None

    @property
    def port(self) -> Port:
        """Of its own stream."""
        return self.streams[0].port

    @property
    def path(self) -> str:
        """Of the port."""
        return self.port.path

    @property
    def fields(self) -> tuple[Field, ...]:
        """Of the port."""
        return self.port.fields

    @property
    def wants_exact(self) -> bool:
        """Whether a stream is of what the device would read without errors."""
        return any(stream.ideal for stream in self.streams)

    # -- its place ------------------------------------------------------------------------------------------------------------------

    def enter(self, instruments: Instruments) -> None:
        """Lie in these arrays, and remember what it did before."""
        self._in = instruments
        sensor, width = self.sensor, self.streams[0].columns.width
        if isinstance(sensor, BankSensor):
            sensor.enter(instruments.heads, instruments.rows_of(sensor.bank))
            self.head = sensor.head
        else:
            self.head = instruments.heads.take(1)
        self._first, self._count = -1, self._needed(width)
        self._first = first = instruments.numbers.take(self._count)
        self._stream_first = instruments.streams.take(len(self.streams))
        head = instruments.heads.rows[self.head]
        head["body"], head["first"], head["width"] = self.row, first, width
        head["stream_first"], head["stream_count"] = self._stream_first, len(self.streams)
        head["latency_ns"] = self.latency_ns
        first += width
        head["exact_first"] = first if self.wants_exact else -1
        first += width if self.wants_exact else 0
        self._memories: list[list[tuple[Operation, int]]] = []
        self._ranges: list[tuple[int, int]] = []
        for k, stream in enumerate(self.streams):
            first = self._enter_stream(instruments, stream, self._stream_first + k, first)
        self._time()
        self.fault = self._fault
        if self._rest is not None:
            self.load(self._rest)

    def _needed(self, width: int) -> int:
        """How many numbers: readings, then of each stream the last and the newest, and what its operations remember."""
        needed = width * (2 if self.wants_exact else 1)
        for stream in self.streams:
            needed += (3 if stream.is_ready_made else 2) * width + sum(len(m.numbers) for m in stream.operations)
        return needed

    def _enter_stream(self, instruments: Instruments, stream: SensorStream, k: int, first: int) -> int:
        rows, head, width = instruments.streams.rows, instruments.heads.rows[self.head], stream.columns.width
        row = rows[k]
        row["width"], row["exact"], row["ready_made"] = width, stream.ideal, stream.is_ready_made
        row["source"] = head["exact_first"] if stream.ideal else head["first"]
        if stream.is_ready_made:
            row["source"], first = first, first + width
        row["first"], row["newest_first"], first = first, first + width, first + 2 * width
        operations = stream.operations
        count = sum(len(m.rows) for m in operations)
        place = row["operation_first"] = instruments.operations.take(count)
        row["operation_count"] = count
        self._ranges.append((int(place), count))
        memories = []
        for operation in operations:
            at = instruments.operations.rows[place : place + len(operation.rows)]
            at[:] = operation.rows
            at["memory"] = first
            memories.append((operation, first))
            instruments.numbers.rows[first : first + len(operation.numbers)] = operation.numbers
            place, first = place + len(operation.rows), first + len(operation.numbers)
        self._memories.append(memories)
        return first

    def move_out(self) -> None:
        """Give the places back; what it remembers stays with it."""
        instruments, self._rest = self._here, self.save()
        for memories in self._memories:
            for operation, first in memories:
                operation.numbers[:] = instruments.numbers.rows[first : first + len(operation.numbers)]
        for first, count in self._ranges:
            instruments.operations.give_back(first, count)
        instruments.streams.give_back(self._stream_first, len(self.streams))
        instruments.numbers.give_back(self._first, self._count)
        if isinstance(self.sensor, BankSensor):
            self.sensor.leave()
        else:
            instruments.heads.give_back(self.head, 1)
        self._in = None

    @property
    def _here(self) -> Instruments:
        if self._in is None:
            raise RuntimeError(f'"{self.path}" is in no world')
        return self._in

    @property
    def stream_numbers(self) -> range:
        """Numbers of its streams among those of the world."""
        return range(self._stream_first, self._stream_first + len(self.streams))

    # -- settings -------------------------------------------------------------------------------------------------------------------

    def set_divisor(self, divisor: int) -> None:
        """Measure every `divisor` ticks from now on; the sensor and its errors learn the time from one reading to the next."""
        self.divisor = divisor
        for stream in self.streams:
            stream.port = structs.replace(stream.port, rate_hz=float(self.rate_hz / divisor))
        self._time()

    def _time(self) -> None:
        dt = float(self.divisor / self.rate_hz)
        self.sensor.dt = dt
        if self.twin is not None:
            self.twin.dt = dt
        for stream in self.streams:
            for modifier in stream.modifiers:
                modifier.stream.dt = dt
        if self._in is not None:
            self._in.heads.rows["dt"][self.head] = dt
            for k in self.stream_numbers:
                self._in.streams.rows["dt"][k] = dt

    @property
    def fault(self) -> Fault:
        """What is broken of it."""
        return self._fault

    @fault.setter
    def fault(self, fault: Fault) -> None:
        self._fault = fault
        if self._in is not None:
            self._in.heads.rows["silent"][self.head] = fault == "silent"
            for k in self.stream_numbers:
                self._in.streams.rows["frozen"][k] = fault != ""

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def is_called(self, now: float) -> bool:
        """Whether it has to measure now (s), whatever its rate."""
        wake = self.sensor.wake
        return wake is not None and wake <= now + 1e-9

    def read(self, scope: Scope) -> None:
        """Read in Python, into the arrays."""
        instruments = self._here
        head = instruments.heads.rows[self.head]
        if self._fault == "silent":
            head["ready"] = 0
            return
        exact = None if self.twin is None else self._exact(self.twin, scope)
        self.sensor.begin(int(head["number"]))
        reading = self.sensor.sense(scope)
        head["ready"] = reading is not None
        if reading is None:
            return
        head["valid"], head["delay_ns"], head["since_ns"] = reading.valid, reading.delay_ns, reading.since_ns
        numbers, columns = instruments.numbers.rows, self.streams[0].columns
        columns.pack(reading.values, numbers[head["first"] : head["first"] + columns.width])
        exactly = (reading.valid, reading.values) if exact is None else exact
        if self.wants_exact:
            head["exact_valid"] = exactly[0]
            columns.pack(exactly[1], numbers[head["exact_first"] : head["exact_first"] + columns.width])
        if columns.loose:
            for stream in self.streams:
                values = exactly[1] if stream.ideal else reading.values
                if not self._fault or stream.loose[0] is None:
                    stream.loose = tuple([values[k] for k in columns.loose])
                stream.coming[int(head["number"])] = stream.loose

    def read_exactly(self, t: float) -> None:
        """What a sensor of a bank would read now without errors, into the arrays; before it reads itself."""
        sensor, instruments = self.sensor, self._here
        assert isinstance(sensor, BankSensor)
        rows, heads = instruments.rows_of(sensor.bank).rows, instruments.heads.rows
        head, kept, mine = heads[self.head], heads[self.head].copy(), rows[sensor.row].copy()
        head["exact"], head["shadow"], head["first"] = 1, 1, kept["exact_first"]
        instruments.read(sensor.bank, np.array([self.head]), t)
        read = bool(head["ready"] and head["valid"])
        if not head["ready"]:
            instruments.numbers.rows[kept["exact_first"] : kept["exact_first"] + kept["width"]] = np.nan
        rows[sensor.row], heads[self.head] = mine, kept
        heads["exact_valid"][self.head] = read

    def disturb(self, t_ns: int) -> None:
        """Make the readings of streams whose errors are written in Python."""
        instruments = self._here
        head = instruments.heads.rows[self.head]
        if not head["ready"]:
            return
        for k, stream in zip(self.stream_numbers, self.streams, strict=True):
            if not stream.is_ready_made:
                continue
            row = instruments.streams.rows[k]
            source = head["exact_first"] if stream.ideal else head["first"]
            values = stream.columns.unpack(instruments.numbers.rows[source : source + row["width"]], stream.loose)
            reading = Measurement(list(values), bool(head["exact_valid"] if stream.ideal else head["valid"]))
            reading.t_ns, reading.number = t_ns - int(head["since_ns"]), int(head["number"])
            reading.delay_ns = int(head["delay_ns"]) + self.latency_ns
            for modifier in stream.modifiers:
                modifier.stream.draws.seek(reading.number)
                modifier.apply(reading)
            stream.columns.pack(reading.values, instruments.numbers.rows[row["source"] : row["source"] + row["width"]])
            for name in row["reading"].dtype.names:
                row["reading"][name] = getattr(reading, name)

    def _exact(self, twin: Sensor, scope: Scope) -> tuple[bool, list[Value]]:
        """What the twin makes of this instant; before the device itself reads, which may change what both look at."""
        twin.settings = self.sensor.settings
        if twin.paces:
            twin.memory = copy(self.sensor.memory)
        reading = twin.sense(scope if scope.wiring is None else replace(scope, wiring=scope.wiring.unfed()))
        return (False, blank(twin.fields)) if reading is None else (reading.valid, reading.values)

    # -- what is told of it ---------------------------------------------------------------------------------------------------------

    @property
    def held(self) -> Held:
        """Its last reading, errors included."""
        return self._held(0)

    @property
    def held_ns(self) -> int:
        """When that was true."""
        return int(self._here.streams.rows["held_ns"][self._stream_first])

    def _held(self, k: int) -> Held:
        rows, stream = self._here.streams.rows, self.streams[k]
        row = rows[self._stream_first + k]
        if not row["held"]:
            return None
        numbers = self._here.numbers.rows[row["first"] : row["first"] + row["width"]]
        return bool(row["held_valid"]), stream.columns.unpack(numbers, stream.loose)

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def save(self) -> SensorState:
        """All that it remembers."""
        sensor, heads = self.sensor, self._here.heads.rows
        settings = record(sensor.settings) if sensor.settings.__struct_fields__ else b""
        return SensorState(
            int(heads["number"][self.head]), self.active, self.divisor, settings, self._memory(), tuple(self._streams())
        )  # fmt: skip

    def _memory(self) -> bytes:
        sensor = self.sensor
        if isinstance(sensor, BankSensor):
            data: bytes = sensor.rows.rows["m"][sensor.row].tobytes()
            return data
        return record(sensor.memory) if sensor.memory.__struct_fields__ else b""

    def _streams(self) -> Iterator[StreamState]:
        for k, stream in enumerate(self.streams):
            held_ns = int(self._here.streams.rows["held_ns"][self._stream_first + k])
            yield StreamState(self._held(k), held_ns, tuple([self._kept(m, k) for m in stream.modifiers]))

    def _kept(self, modifier: Any, k: int) -> bytes:
        for operation, first in self._memories[k]:
            if operation is modifier:
                data: bytes = self._here.numbers.rows[first : first + len(operation.numbers)].tobytes()
                return data
        if isinstance(modifier, Operation):
            return modifier.numbers.tobytes()
        return record(modifier.memory) if modifier.memory.__struct_fields__ else b""

    def check(self, state: Any) -> None:
        """Settings and memories are of its kinds, and readings fit their fields."""
        sensor = self.sensor
        if len(state.streams) != len(self.streams):
            raise ValueError("other streams than this sensor has")
        if state.settings or sensor.settings.__struct_fields__:
            sensor.valid(read_record(state.settings, sensor.settings))
        if isinstance(sensor, BankSensor):
            form = sensor.bank.record["m"]
            if len(state.memory) != form.itemsize:
                raise ValueError(f"{len(state.memory)} bytes of memory, not {form.itemsize}")
            sensor.valid(sensor.memory_of(np.frombuffer(state.memory, form)[0]))
        elif state.memory or sensor.memory.__struct_fields__:
            sensor.valid(read_record(state.memory, sensor.memory))
        for stream, kept in zip(self.streams, state.streams, strict=True):
            if kept.held is not None:
                check_values(stream.port.fields, kept.held[1])
            if len(kept.memories) != len(stream.modifiers):
                raise ValueError("other modifiers than this stream has")
            for modifier, data in zip(stream.modifiers, kept.memories, strict=True):
                modifier.valid(_memory_of(modifier, data))

    def load(self, state: SensorState) -> None:
        """Go on from there; the twin follows by itself."""
        instruments, sensor = self._here, self.sensor
        instruments.heads.rows["number"][self.head] = state.number
        self.active = state.active
        if state.divisor != self.divisor:
            self.set_divisor(state.divisor)
        if state.settings:
            sensor.settings = read_record(state.settings, sensor.settings)
        if isinstance(sensor, BankSensor):
            row = sensor.rows.rows[sensor.row : sensor.row + 1]
            sensor.fill(row[0])
            row["m"] = np.frombuffer(state.memory, row["m"].dtype)
        elif state.memory:
            sensor.memory = msgpack.decode(state.memory, type=type(sensor.memory))
        for k, kept in enumerate(state.streams):
            self._load_stream(k, kept)

    def _load_stream(self, k: int, kept: StreamState) -> None:
        instruments, stream = self._here, self.streams[k]
        row = instruments.streams.rows[self._stream_first + k]
        row["held"], row["held_ns"], row["newest"] = kept.held is not None, kept.held_ns, 0
        if kept.held is not None:
            row["held_valid"], values = kept.held
            stream.columns.pack(values, instruments.numbers.rows[row["first"] : row["first"] + row["width"]])
            stream.loose = tuple([values[i] for i in stream.columns.loose])
        places = {id(operation): first for operation, first in self._memories[k]}
        for modifier, data in zip(stream.modifiers, kept.memories, strict=True):
            first = places.get(id(modifier))
            if first is not None:
                instruments.numbers.rows[first : first + len(data) // 8] = np.frombuffer(data)
            elif isinstance(modifier, Operation):
                modifier.numbers[:] = np.frombuffer(data)
            elif data:
                modifier.memory = read_record(data, modifier.memory)


def _memory_of(modifier: Any, data: bytes) -> Memory:
    """The memory of a modifier as a record; ValueError where it is none of this kind."""
    if isinstance(modifier, Operation):
        if len(data) != 8 * len(modifier.numbers):
            raise ValueError(f"{len(data)} bytes of memory, not {8 * len(modifier.numbers)}")
        return modifier.record(np.frombuffer(data))
    memory: Memory = read_record(data, modifier.memory) if data else modifier.memory
    return memory
