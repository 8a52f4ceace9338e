"""All sensors of a world: which streams are read, the samples that are in flight or delivered, and the state of those in flight."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, structs

from uwserver.ports import Sample, Value
from uwserver.ports.checks import check_values
from uwserver.ports.decimation import EVERY_SAMPLE, Decimations
from uwserver.ports.sample_batch import Origin, SampleBatch
from uwserver.sensors.compiled import CompiledSensor
from uwserver.step.streams import ENTRY, KEPT, LARGE, LISTENED, NEVER, READ, SMALL
from uwserver.units import NANOSECONDS
from uwserver.world.parts.part import Count, Part, State
from uwserver.world.parts.profile import Timer, untimed
from uwserver.world.sensing.computing import DROP, wait_for_values
from uwserver.world.sensing.pending_jobs import PendingJobs
from uwserver.world.sensing.python_readings import PythonReadings
from uwserver.world.sensing.sensor_arrays import SensorArrays
from uwserver.world.sensing.sensor_rows import SensorStream, computed
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.sensing.timetable import Group, groups_of

_MOST = 65536
IN_FLIGHT = np.dtype([(name, "i8") for name in ("t_sent_ns", "order", "port", "seq", "t_ns", "valid")])
"""A sample in flight in a state; `port` is its place in the ports of that state."""
_EARLY_NS = 2
"""Times in seconds are rounded by less than this, up to a hundred days. A sensor that is called earlier by so much has nothing to do yet."""


class InFlightSamples(State, frozen=True, omit_defaults=True):
    """The samples in flight.

    Attributes:
        order: how many samples were ever in flight.
        ports: ports that have a sample in flight.
        entries: for each sample a record of int64, in the order of delivery: time of delivery (ns), order, place of the port in `ports`,
            seq, t_ns, valid.
        numbers: the numbers of one sample after the other, float64.
        loose: values that are no numbers, for samples of ports with such fields.
        pictures: the same for sensors that take time.
    """

    order: Count
    ports: Annotated[tuple[str, ...], Meta(max_length=_MOST)]
    entries: Annotated[bytes, Meta(max_length=_MOST * IN_FLIGHT.itemsize)]
    numbers: bytes
    loose: Annotated[tuple[tuple[Value, ...], ...], Meta(max_length=_MOST)]
    pictures: Annotated[tuple[tuple[Value, ...], ...], Meta(max_length=_MOST)] = ()

    def deciding(self) -> InFlightSamples:
        """Leave the pictures out: they follow from the other values, and may still be under computation."""
        return structs.replace(self, pictures=()) if self.pictures else self

    def completed(self) -> InFlightSamples:
        """Wait for the pictures, and put them in."""
        return structs.replace(self, pictures=computed(self.pictures))

    def checked_entries(self) -> Any:
        """Return the records (IN_FLIGHT) of the samples.

        Raises:
            ValueError: the records are not possible.
        """
        if len(self.entries) % IN_FLIGHT.itemsize:
            raise ValueError("the samples in flight end within a record")
        entries = np.frombuffer(self.entries, IN_FLIGHT)
        limits = {
            "t_sent_ns": 2**62,
            "order": self.order,
            "port": len(self.ports) - 1,
            "seq": 2**62,
            "t_ns": 2**62,
            "valid": 1,
        }
        if any(((entries[name] < 0) | (entries[name] > most)).any() for name, most in limits.items()):
            raise ValueError("a sample in flight is not possible")
        if (np.lexsort((entries["order"], entries["t_sent_ns"])) != np.arange(len(entries))).any():
            raise ValueError("the samples in flight are not in the order of their delivery")
        return entries


class Sensing(Part):
    """A part that stands for all sensors. The step (`uwserver.step.tick`) decides when they read and when samples are delivered.

    Attributes:
        numbers: numbers of the streams, by port.
        groups: sensors that are due together; a new list whenever other sensors are due.
        python_readings: the Python work for the sensors that are due.
        casts_rays: whether some of them cast rays.
        callable: how many samples can come from the sensors that may be called.
        pending_jobs: readings that take time.
        tell: hands the delivered samples of some ticks on; see `_tell`.
    """

    path = "world/samples"
    state_type = InFlightSamples

    def __init__(self, slots: Mapping[str, SensorSlot], sensor_arrays: SensorArrays) -> None:
        """Begin without sensors, in a world that is still being built.

        Args:
            slots: the sensors by path; may change before each `schedule`.
            sensor_arrays: the arrays of the sensors.
        """
        self._slots, self._sensor_arrays = slots, sensor_arrays
        self.groups: list[Group] = []
        self.python_readings = PythonReadings({}, sensor_arrays, untimed)
        self.casts_rays, self.callable = False, 0
        self._listening: list[SensorSlot] = []
        self._placed: dict[SensorSlot, None] = {}
        self._subscriptions: Container[str] | None = None
        self._measured: Collection[str] | None = None
        self._decimations = EVERY_SAMPLE
        self._parts_listen_to: Collection[str] = ()
        self._kernels_listen_to: Collection[str] = ()
        self._streams: dict[int, SensorStream] = {}
        self._with_loose: list[SensorStream] = []
        self._origins: dict[int, Origin] = {}
        self._is_read = self._mask_of(())
        self._batch: SampleBatch | None = None
        self.numbers: dict[str, int] = {}
        self.pending_jobs = PendingJobs(sensor_arrays, self._is_needed)
        self.services = ((DROP, self.pending_jobs.drop),)
        self.watch(untimed)

    def watch(self, timed: Timer) -> None:
        """Call the functions of a tick through what `timed` makes of them. `schedule` must follow."""
        self._timed = timed
        self.tell = timed("samples", "for readers", self._tell)

    def sensors_changed(self) -> None:
        """Give sensors their places in the arrays, after sensors were added or removed."""
        slots, there, self._decimations = self._slots, dict.fromkeys(self._slots.values()), EVERY_SAMPLE
        gone = [slot for slot in self._placed if slot not in there]
        streams = dict(self._streams)
        if gone:
            lost = {k for slot in gone for k in slot.stream_numbers}
            self._sensor_arrays.lose(lambda k, _: k in lost)  # while their streams still exist
            for k in lost:
                del streams[k]
            for slot in gone:
                slot.move_out()
        new = [slot for slot in slots.values() if slot not in self._placed]
        for slot in new:
            slot.enter(self._sensor_arrays)
            streams |= zip(slot.stream_numbers, slot.streams, strict=True)
        self._placed, self._streams = there, streams
        self.numbers = {stream.port.path: k for k, stream in streams.items()}
        self._with_loose = [stream for stream in streams.values() if stream.columns.loose]
        writing = [(slot, slot.sensor.writing) for slot in there]
        texts = {k: w.texts for slot, w in writing if w is not None for k in slot.stream_numbers}
        self._origins = {
            k: Origin(s.port.path, s.columns.width, s.columns.values, texts.get(k, ())) for k, s in streams.items()
        }
        loose_streams = {k: SMALL if s.columns.is_small else LARGE for k, s in streams.items() if s.columns.loose}
        self._sensor_arrays.streams.rows["loose"] = 0
        self._sensor_arrays.streams.rows["loose"][[*loose_streams]] = [*loose_streams.values()]
        self.pending_jobs.sensors_changed(slots.values())
        self._sensor_arrays.gather({id(s.wiring): s.wiring for s in slots.values() if s.wiring is not None}.values())

    def subscribe(self, ports: Container[str] | None, decimations: Decimations = EVERY_SAMPLE) -> None:
        """Make samples of these ports only; None for all ports. Samples of ports that parts of the world listen to are always made.

        Args:
            ports: paths.
            decimations: decimations by path. Of these ports only the samples are needed that one of the decimations takes. More may be made,
                for instance if samples are not delivered in the order of their times. It holds until sensors are added or removed, or the
                time is set.
        """
        self._subscriptions, self._decimations = ports, decimations
        self._mark_streams()

    def forget_newest(self) -> None:
        """Forget the newest samples, as the time was set and they belong to another time."""
        self._sensor_arrays.forget_newest()
        self._decimations = EVERY_SAMPLE
        self._sensor_arrays.decimate({})

    def set_listeners(self, ports: Collection[str], of_kernels: Collection[str]) -> None:
        """Set the ports that parts of the world listen to, and the ports that compiled code listens to (`of_kernels`)."""
        self._parts_listen_to, self._kernels_listen_to = ports, of_kernels
        self._mark_streams()

    def _mark_streams(self) -> None:
        """Mark in the rows of the streams which of them are read."""
        rows, streams, subscriptions = self._sensor_arrays.streams.rows["use"], self._streams, self._subscriptions
        rows[:] = 0
        if subscriptions is None:
            rows[list(streams)] = READ
            self._sensor_arrays.is_read = bool(streams)
            self._sensor_arrays.decimate({})
            return
        read = {k for path, k in self.numbers.items() if path in subscriptions or path in self._parts_listen_to}
        self._is_read, self._sensor_arrays.is_read = self._mask_of(read), bool(read)
        # Values that are no numbers wait in Python for their sample.
        rows[[k for k, stream in streams.items() if stream.columns.loose]] = KEPT
        rows[[self.numbers[path] for path in self._kernels_listen_to]] = LISTENED
        rows[list(read)] = READ
        known = [
            (self.numbers.get(path), some)
            for path, some in self._decimations.items()
            if path not in self._parts_listen_to
        ]
        self._sensor_arrays.decimate({k: some for k, some in known if k in read and streams[k].columns.is_small})

    def _is_needed(self, stream: int) -> bool:
        return self._subscriptions is None or bool(self._is_read[stream])

    def _mask_of(self, streams: Collection[int]) -> Any:
        """Return for each number of a stream whether it is one of these."""
        marked = np.zeros(max(self._streams, default=-1) + 1, bool)
        marked[list(streams)] = True
        return marked

    def choose(self, measured: Collection[str] | None) -> None:
        """Let only sensors of these paths measure; None for all, as at first."""
        self._measured = measured
        self.schedule()

    def schedule(self) -> None:
        """Sort the active sensors by how often they are due."""
        measured = self._measured
        slots = [slot for path, slot in self._slots.items() if measured is None or path in measured]
        self.groups = groups_of(slots)
        active = [slot for group in self.groups for slot in group.slots]
        self._listening = [slot for slot in slots if slot.active and slot.sensor.listens]
        called = [slot for slot in active if slot.sensor.listens or slot.sensor.rouses]
        self.callable = sum(len(slot.streams) for slot in called)
        self.casts_rays = any(slot.sensor.rays for slot in active if isinstance(slot.sensor, CompiledSensor))
        self.python_readings = PythonReadings({slot.head: slot for slot in active}, self._sensor_arrays, self._timed)

    @property
    def call_ns(self) -> int:
        """Before this simulation time (ns) no sensor has to be called because something has come to it, as far as is known now."""
        wakes = [slot.sensor.wake for slot in (*self._listening, *self._sensor_arrays.roused)]
        first = min([wake for wake in wakes if wake is not None], default=None)
        return NEVER if first is None else math.floor(first * NANOSECONDS) - _EARLY_NS

    def called(self, now: float) -> list[SensorSlot]:
        """Return the sensors to which something has come by now (s) that they wait for, in an order that does not depend on the order of
        arrival."""
        roused = self._sensor_arrays.roused
        for slot in [slot for slot in roused if slot.sensor.wake is None]:
            del roused[slot]
        inorder = sorted((slot for slot in roused if slot.active), key=lambda slot: slot.path)
        return [
            slot
            for slot in (*self._listening, *inorder)
            if slot.sensor.wake is not None and slot.sensor.wake <= now + 1e-9
        ]

    def take_texts(self) -> None:
        """Find the texts of readings that compiled code has written (`sensors.others.Writing`)."""
        written = self._sensor_arrays.streams.rows["texts"]
        (streams,) = written.nonzero()
        for k, texts in zip(streams.tolist(), written[streams].tolist(), strict=True):
            stream = self._streams[k]
            stream.fresh = stream.loose = stream.newest = self._origins[k].texts[texts - 1]
        written[streams] = 0

    def _tell(self, first: int, ends: Sequence[int], with_loose: bool, samples: list[Sample]) -> None:
        """Hand on the samples that were delivered in some ticks.

        Args:
            first: place in the log at which they begin.
            ends: for each tick with samples that are read, the place in the log behind them.
            with_loose: whether the last tick has samples with values that are no numbers.
            samples: takes the samples that `take_batch` does not return.
        """
        log, is_large = self._sensor_arrays.log, False
        for k, seq, place in self._sensor_arrays.loose if with_loose else ():
            stream = self._streams[k]
            # A state from outside may have two samples of one number in flight.
            stream.newest = stream.coming.pop(seq, stream.newest or stream.loose)
            if place >= 0:
                log.loose[place] = wait_for_values(stream.newest)
                is_large = is_large or not stream.columns.is_small
        if not ends:
            return
        before, batch = self._batch, SampleBatch(self._origins, log, first, ends[-1], len(ends), tuple(ends[:-1]))
        together = batch if before is None else before.followed_by(batch)
        if together is not None and not is_large:
            self._batch = together
            return
        samples += (*(before or ()), *batch)
        self._batch = None
        for place in range(
            first, ends[-1]
        ):  # A picture must not be kept alive by the samples that were delivered with it.
            log.loose.pop(place, None)

    def take_batch(self) -> SampleBatch | None:
        """Return the samples that were delivered lately, except those that `tell` has appended."""
        batch, self._batch = self._batch, None
        return batch

    def newest(self, path: str) -> Sample | None:
        """Return the newest delivered sample of a port; None before the first, and after the time was set."""
        k = self.numbers.get(path)
        if k is None:
            return None
        row, stream = self._sensor_arrays.streams.rows[k], self._streams[k]
        if not row["newest"]:
            return None
        first, width = row["newest_first"], row["width"]
        values = stream.columns.unpack(
            self._sensor_arrays.numbers.rows[first : first + width], wait_for_values(stream.newest)
        )
        return Sample(path, int(row["seq"]), int(row["t_ns"]), int(row["t_sent_ns"]), bool(row["valid"]), values)

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def save(self) -> InFlightSamples:
        """Return the samples in flight, in the order of their delivery."""
        order, pending, numbers = self._sensor_arrays.in_flight()
        if not len(pending):
            return InFlightSamples(order, (), b"", b"", ())
        ports: dict[int, int] = {}
        places = [ports.setdefault(k, len(ports)) for k in pending["stream"].tolist()]
        entries = np.empty(len(pending), IN_FLIGHT)
        for name in ("t_sent_ns", "order", "seq", "t_ns", "valid"):
            entries[name] = pending[name]
        entries["port"] = places
        streams = [self._streams[k] for k in ports]
        loose: list[Any] = []
        pictures: list[Any] = []
        if self._with_loose:
            for k, seq in zip(pending["stream"].tolist(), pending["seq"].tolist(), strict=True):
                stream = self._streams[k]
                if stream.columns.loose:
                    kept = pictures if k in self.pending_jobs.streams else loose
                    kept.append(stream.coming.get(seq, stream.loose))
        paths = tuple([stream.port.path for stream in streams])
        return InFlightSamples(order, paths, entries.tobytes(), numbers.tobytes(), tuple(loose), tuple(pictures))

    def check(self, state: Any) -> None:
        """Raise ValueError if a sample is not of a sensor of this world, or does not fit its fields."""
        unknown = [path for path in state.ports if path not in self.numbers]
        if unknown:
            raise ValueError(f'a sample in flight from "{unknown[0][:80]}", which is no sensor of this world')
        entries = state.checked_entries()
        streams = [self._streams[self.numbers[path]] for path in state.ports]
        width = sum([streams[place].columns.width for place in entries["port"].tolist()])
        if len(state.numbers) != 8 * width:
            raise ValueError(f"the samples in flight have other fields: {len(state.numbers)} bytes, not {8 * width}")
        loose_streams, slow = self._loose_samples(state, entries)
        if len(state.loose) != len(loose_streams) or len(state.pictures) != len(slow):
            raise ValueError("the samples in flight have other fields")
        for (stream, _), values in zip(loose_streams + slow, state.loose + state.pictures, strict=True):
            check_values([stream.port.fields[k] for k in stream.columns.loose], values)

    def _loose_samples(self, state: InFlightSamples, entries: Any) -> tuple[list[tuple[SensorStream, int]], ...]:
        """Return stream and number of each sample whose values are in `loose` of a state, and of each sample whose values are in
        `pictures`."""
        numbers = [self.numbers[path] for path in state.ports]
        each = [(numbers[place], seq) for place, seq in entries[["port", "seq"]].tolist()]
        each = [(k, seq) for k, seq in each if self._streams[k].columns.loose]
        takes_time = self.pending_jobs.streams
        return tuple([[(self._streams[k], n) for k, n in each if (k in takes_time) is slow] for slow in (False, True)])

    def load(self, state: InFlightSamples) -> None:
        """Put the samples of a checked state in flight."""
        for stream in self._with_loose:
            stream.coming.clear()
        given = np.frombuffer(state.entries, IN_FLIGHT)
        entries = np.zeros(len(given), ENTRY)
        for name in ("t_sent_ns", "order", "seq", "t_ns", "valid"):
            entries[name] = given[name]
        numbers = np.array([self.numbers[path] for path in state.ports], np.int64)
        entries["stream"] = numbers[given["port"]]
        self.pending_jobs.forget()
        for known, each in zip(self._loose_samples(state, given), (state.loose, state.pictures), strict=True):
            for (stream, seq), values in zip(known, each, strict=True):
                stream.coming[seq] = values
        self._sensor_arrays.put_in_flight(state.order, entries, np.frombuffer(state.numbers))

    def leave(self, why: str) -> None:
        """End the thread that computes readings, as the run ends."""
        self._sensor_arrays.computing.end()
