"""A sensor in a world: when it is due, how it reads, its streams and their errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from msgspec import structs

from uwserver.modifiers import Measurement
from uwserver.ports import Field, Json, Port
from uwserver.ports.checks import check_values
from uwserver.sensors import Scope, Sensor
from uwserver.sensors.base import blank
from uwserver.sensors.compiled import CompiledSensor
from uwserver.sensors.job import PendingMeasurement
from uwserver.sensors.wiring import Wiring
from uwserver.step.streams import HELD
from uwserver.world.parts.part import Part, read_record, record
from uwserver.world.sensing.computing import Loose, Work
from uwserver.world.sensing.sensor_arrays import SensorArrays
from uwserver.world.sensing.sensor_rows import Held, SensorRows, SensorState, SensorStream

Fault = Literal["", "frozen", "silent"]


class SensorSlot(Part):
    """A sensor in the world.

    Attributes:
        row: row of the body that carries it.
        sensor: the device.
        streams: its own stream, then the further ones.
        rate_hz: ticks per second.
        divisor: it measures once every `divisor` ticks.
        latency_ns: latency of the device.
        wiring: the inside of its vehicle.
        twin: the same device without errors, for ideal streams of a sensor that is written in Python.
        has_loose: whether some of its values are no numbers.
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
        self._active = True
        self.wiring: Wiring | None = None
        self._fault: Fault = ""
        self._rows: SensorRows | None = None
        self._saved: SensorState | None = None
        # Whether settings and memory have fields never changes.
        self._has_settings, self.has_loose = bool(sensor.settings.__struct_fields__), bool(streams[0].columns.loose)
        self._settings = sensor.settings, record(sensor.settings) if self._has_settings else b""
        self._has_memory = not isinstance(sensor, CompiledSensor) and bool(sensor.memory.__struct_fields__)
        self._python_modifiers = [m for stream in streams if stream.is_ready_made for m in stream.modifiers]

    @property
    def port(self) -> Port:
        """Port of its own stream."""
        return self.streams[0].port

    @property
    def path(self) -> str:
        """Path of the port."""
        return self.port.path

    @property
    def fields(self) -> tuple[Field, ...]:
        """Fields of the port."""
        return self.port.fields

    @property
    def works(self) -> bool:
        """Whether it reads: it is active, and no fault silences it."""
        return self.active and self._fault != "silent"

    @property
    def needs_exact(self) -> bool:
        """Whether a stream needs the values that the device would read without errors."""
        return any(stream.ideal for stream in self.streams)

    @property
    def active(self) -> bool:
        """Whether it measures at all."""
        return self._active

    @active.setter
    def active(self, active: bool) -> None:
        self._active = active
        self._speak()

    # -- its place ------------------------------------------------------------------------------------------------------------------

    def enter(self, sensor_arrays: SensorArrays) -> None:
        """Take places in these arrays, with the state from before."""
        self._rows = SensorRows(sensor_arrays, self.sensor, self.streams, self.row, self.latency_ns)
        self._set_time()
        self._rows.set_fault(self._fault)
        if self.sensor.rouses:
            self.sensor.rouse = lambda: sensor_arrays.roused.update({self: None})
        if self._saved is not None:
            self.load(self._saved)

    def move_out(self) -> None:
        """Give the places back, and keep the state."""
        rows, self._saved = self._here, self.save()
        rows.sensor_arrays.roused.pop(self, None)
        rows.give_back()
        self._rows = None

    @property
    def _here(self) -> SensorRows:
        if self._rows is None:
            raise RuntimeError(f'"{self.path}" is in no world')
        return self._rows

    @property
    def head(self) -> int:
        """Number of its head."""
        return self._here.head

    @property
    def stream_numbers(self) -> range:
        """Numbers of its streams."""
        return self._here.streams

    # -- settings -------------------------------------------------------------------------------------------------------------------

    def set_divisor(self, divisor: int) -> None:
        """Measure every `divisor` ticks from now on. The sensor and its errors get the new time between readings."""
        self.divisor = divisor
        for stream in self.streams:
            stream.port = structs.replace(stream.port, rate_hz=float(self.rate_hz / divisor))
        self._set_time()

    def _set_time(self) -> None:
        dt = float(self.divisor / self.rate_hz)
        self.sensor.dt = dt
        if self.twin is not None:
            self.twin.dt = dt
        for stream in self.streams:
            for modifier in stream.modifiers:
                modifier.stream.dt = dt
        if self._rows is not None:
            self._rows.set_time(dt)
            self._speak()

    @property
    def fault(self) -> Fault:
        """Its fault; "" for none."""
        return self._fault

    @fault.setter
    def fault(self, fault: Fault) -> None:
        if fault == self._fault:
            return
        self._fault = fault
        if self._rows is not None:
            self._rows.set_fault(fault)
            self._speak()

    def change(self, args: Mapping[str, Json]) -> None:
        """Change settings, as `Sensor.change`."""
        self.sensor.change(args)
        self._speak()

    def _speak(self) -> None:
        """Tell other sonars how it sounds now."""
        if self._rows is not None:
            self._rows.speak(self.works)

    # -- readings -------------------------------------------------------------------------------------------------------------------

    @property
    def writes(self) -> bool:
        """Whether it can `write` its reading instead of being `read`."""
        return self.sensor.writes and not self.needs_exact

    @property
    def is_compiled(self) -> bool:
        """Whether compiled code can do everything for it, from the reading to the samples."""
        if any(stream.is_ready_made for stream in self.streams):
            return False
        if isinstance(self.sensor, CompiledSensor):
            return not self.has_loose
        if self.needs_exact:
            return False
        at_once = not self.latency_ns and not any(stream.operations for stream in self.streams)
        return self.sensor.writing is not None and at_once

    def write(self) -> None:
        """Let a sensor that writes do so, into the arrays. `python_readings._writer` marks whether it is ready."""
        if self._fault == "silent":
            return
        rows = self._here
        loose = self.sensor.write(rows.numbers(rows.reading, self.streams[0].columns.width))
        for stream in self.streams:
            stream.fresh = loose

    def read(self, scope: Scope) -> None:
        """Read in Python, into the arrays."""
        rows = self._here
        head = rows.row
        if self._fault == "silent":
            head["ready"] = 0
            return
        exact = None if self.twin is None else self._twin_reading(self.twin, scope)
        self.sensor.begin(int(head["number"]))
        reading = self.sensor.sense(scope)
        head["ready"] = reading is not None
        if reading is None:
            return
        self._speak()
        head["valid"], head["delay_ns"], head["since_ns"] = reading.valid, reading.delay_ns, reading.since_ns
        if self.sensor.takes_time:  # A picture is delivered in the next tick at the earliest.
            head["delay_ns"] = max(reading.delay_ns, reading.since_ns + 1)
        columns = self.streams[0].columns
        columns.pack(reading.values, rows.numbers(head["first"], columns.width))
        loose = exact_loose = self._loose_of(reading)
        if self.needs_exact:
            exactly = reading if exact is None else exact
            head["exact_valid"] = exactly.valid
            columns.pack(exactly.values, rows.numbers(head["exact_first"], columns.width))
            exact_loose = loose if exactly is reading else self._loose_of(exactly)
        for stream in self.streams:
            stream.fresh = exact_loose if stream.ideal else loose

    def take_loose(self) -> None:
        """Take the values that are no numbers from a sensor that compiled code has read."""
        sensor = self.sensor
        assert isinstance(sensor, CompiledSensor)
        if not self._here.row["ready"]:
            return
        for stream in self.streams:
            stream.fresh = sensor.loose(exactly=stream.ideal)

    def _loose_of(self, reading: Measurement) -> Loose:
        columns = self.streams[0].columns
        if isinstance(reading, PendingMeasurement):
            return self._here.sensor_arrays.computing.work(reading.job, columns.loose_of(blank(self.fields)))
        return columns.loose_of(reading.values)

    @property
    def delay_ns(self) -> int:
        """Time from now until the present reading is delivered, without the delays of its streams."""
        head = self._here.row
        return int(head["delay_ns"]) - int(head["since_ns"]) + self.latency_ns

    def disturb(self, t_ns: int) -> None:
        """Make the readings of streams whose errors are written in Python."""
        rows = self._here
        head = rows.row
        if not head["ready"]:
            return
        for k, stream in zip(rows.streams, self.streams, strict=True):
            if not stream.is_ready_made:
                continue
            row, columns = rows.sensor_arrays.streams.rows[k], stream.columns
            source = head["exact_first"] if stream.ideal else head["first"]
            # Modifiers cannot change values that are still under computation.
            unknown = isinstance(stream.fresh, Work)
            loose = (None,) * len(columns.loose) if isinstance(stream.fresh, Work) else stream.fresh
            values = columns.unpack(rows.numbers(source, row["width"]), loose)
            reading = Measurement(list(values), bool(head["exact_valid"] if stream.ideal else head["valid"]))
            reading.t_ns, reading.number = t_ns - int(head["since_ns"]), int(head["number"])
            reading.delay_ns = int(head["delay_ns"]) + self.latency_ns
            for modifier in stream.modifiers:
                modifier.stream.draws.seek(reading.number)
                modifier.apply(reading)
            columns.pack(reading.values, rows.numbers(row["source"], row["width"]))
            stream.fresh = stream.fresh if unknown else columns.loose_of(reading.values)
            for name in row["reading"].dtype.names:
                row["reading"][name] = getattr(reading, name)

    def keep_loose(self, number: int, dropped: Iterable[int]) -> None:
        """Keep the values that are no numbers for the sample of the present reading. A lost reading changes nothing, and a frozen sensor
        repeats its values.

        Args:
            number: number of the reading.
            dropped: for each stream, whether its sample is lost.
        """
        for stream, is_lost in zip(self.streams, dropped, strict=True):
            if is_lost:
                continue
            if not self._fault or not stream.loose:
                stream.loose = stream.fresh
            stream.coming[number] = stream.loose

    def _twin_reading(self, twin: Sensor, scope: Scope) -> Measurement:
        """Return what the twin reads at this instant. It reads before the device itself, which may change what both see."""
        twin.settings = self.sensor.settings
        if twin.paces:
            twin.memory = copy(self.sensor.memory)
        reading = twin.sense(scope)
        return Measurement(blank(twin.fields), False) if reading is None else reading

    # -- the last reading -----------------------------------------------------------------------------------------------------------

    @property
    def number(self) -> int:
        """Number of readings made."""
        return int(self._here.row["number"])

    @property
    def is_ready(self) -> bool:
        """Whether the last attempt to read gave a reading."""
        return bool(self._here.row["ready"])

    @property
    def held(self) -> Held:
        """Its last reading, with errors."""
        return self._here.held(0)

    @property
    def held_ns(self) -> int:
        """Time at which the last reading was true."""
        return self._here.held_ns()

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def save(self) -> SensorState:
        """Return its state."""
        sensor = self.sensor
        if self._has_settings and sensor.settings is not self._settings[0]:
            self._settings = sensor.settings, record(sensor.settings)
        settings = self._settings[1]
        number, memory, held, numbers = self._here.save()
        if self._has_memory:
            memory = record(sensor.memory)
        loose: tuple[Any, ...] = tuple([stream.loose for stream in self.streams]) if self.has_loose else ()
        loose, pictures = ((), loose) if sensor.takes_time else (loose, ())
        modifiers = tuple([record(m.memory) for m in self._python_modifiers]) if self._python_modifiers else ()
        return SensorState(
            number, self.active, self.divisor, settings, memory, held, numbers, loose, modifiers, pictures
        )

    def check(self, state: Any) -> None:
        """Raise ValueError if settings or memories are of another kind, or a reading does not fit its fields."""
        sensor = self.sensor
        if state.settings or self._has_settings:
            sensor.valid(read_record(state.settings, sensor.settings))
        if self._has_memory:
            sensor.valid(read_record(state.memory, sensor.memory))
        elif state.memory and not isinstance(sensor, CompiledSensor):
            raise ValueError("it has a memory, and this sensor has none")
        self._here.check(state.memory, state.held, state.numbers)
        loose, others = state.loose, state.pictures
        if sensor.takes_time:
            loose, others = others, loose
        if others or len(loose) != (len(self.streams) if self.has_loose else 0):
            raise ValueError("readings of other streams than this sensor has")
        loose_fields = [self.fields[k] for k in self.streams[0].columns.loose]
        for held, values in zip(np.frombuffer(state.held, HELD), loose, strict=False):
            if held["there"] or values:
                check_values(loose_fields, values)
        if len(state.modifiers) != len(self._python_modifiers):
            raise ValueError("other modifiers than this sensor has")
        for modifier, data in zip(self._python_modifiers, state.modifiers, strict=True):
            modifier.valid(read_record(data, modifier.memory))

    def load(self, state: SensorState) -> None:
        """Take over a checked state. The twin needs none."""
        sensor = self.sensor
        self.active = state.active
        if state.divisor != self.divisor:
            self.set_divisor(state.divisor)
        if self._has_settings and state.settings != record(sensor.settings):
            sensor.settings = read_record(state.settings, sensor.settings)
            if isinstance(sensor, CompiledSensor):
                sensor.fill(sensor.rows.rows[sensor.row])
        if self._has_memory:
            sensor.memory = read_record(state.memory, sensor.memory)
        if sensor.wake is not None:
            sensor.rouse()
        self._here.load(state.number, state.memory, state.held, state.numbers)
        self._speak()
        for stream, loose in zip(self.streams, state.loose or state.pictures, strict=False):
            stream.loose = loose
        for modifier, data in zip(self._python_modifiers, state.modifiers, strict=True):
            modifier.memory = read_record(data, modifier.memory)
