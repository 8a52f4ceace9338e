"""Readings that take time, from their begin to their delivery: which of them are computed, awaited, given back to their sensor, or dropped."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from uwserver.ports import Call, Json, Refused
from uwserver.ports.checks import shown
from uwserver.units import NANOSECONDS
from uwserver.world.sensing.computing import Work, drop_call
from uwserver.world.sensing.sensor_arrays import SensorArrays
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot


class PendingJobs:
    """The readings of a world that take time.

    Attributes:
        streams: the sensors that take time with their streams, by the number of the stream.
        is_idle: whether there are no such sensors.
    """

    def __init__(self, sensor_arrays: SensorArrays, is_read: Callable[[int], bool]) -> None:
        """Begin without readings. `is_read` returns whether a stream is read, by its number."""
        self._sensor_arrays, self._computing, self._is_read = sensor_arrays, sensor_arrays.computing, is_read
        self._slots: dict[str, SensorSlot] = {}
        self.streams: dict[int, tuple[SensorSlot, SensorStream]] = {}
        self._to_drop: dict[str, int] = {}
        self._dropped: set[tuple[int, int]] = set()
        self.is_idle = True

    def sensors_changed(self, slots: Iterable[SensorSlot]) -> None:
        """Take over the sensors that there are now."""
        self._slots = {slot.path: slot for slot in slots if slot.sensor.takes_time}
        self.streams = {k: (slot, stream) for slot in self._slots.values() for k, stream in _numbered(slot)}
        self.is_idle = not self._slots

    def forget(self) -> None:
        """Forget which readings are to be dropped, as the world is in another state."""
        self._to_drop.clear()

    def late(self, tick: int, t_ns: int) -> list[Call]:
        """Return the calls that drop readings for a world that must not wait: readings that are due and not computed, and readings that
        would begin while the one before is under computation. Called before the tick that leads to `tick`, at `t_ns`."""
        found: dict[tuple[str, int], None] = {}
        if t_ns >= self._sensor_arrays.next_ns:
            for _, k, seq in self._sensor_arrays.arriving(t_ns):
                slot, stream = self.streams.get(k, (None, None))
                work = None if stream is None else stream.coming.get(seq)
                if slot is not None and isinstance(work, Work) and not work.is_done and self._is_needed(k, slot):
                    found[slot.path, seq] = None
        for path, slot in self._slots.items():
            is_due = slot.active and slot.fault != "silent" and tick % slot.divisor == 0
            if is_due and any(_is_busy(stream) for stream in slot.streams) and slot.sensor.begins(t_ns / NANOSECONDS):
                found[path, slot.number] = None
        return [drop_call(path, number) for path, number in found]

    def arrive(self, t_ns: int) -> None:
        """Compute or wait for the values of samples that are due and needed. Called before they are delivered."""
        for place, k, seq in self._sensor_arrays.arriving(t_ns):
            slot, stream = self.streams.get(k, (None, None))
            if slot is None or stream is None or seq not in stream.coming or not self._is_needed(k, slot):
                continue
            loose = stream.coming[seq]
            if isinstance(loose, Work):
                stream.coming[seq] = values = loose.result()
                if loose.error and not loose.is_told:
                    loose.is_told = True
                    self._computing.count_failure(slot.path, seq, loose.error)
            else:  # from a saved state
                values = loose
            if None in values:
                self._sensor_arrays.invalidate(place)
            elif slot.sensor.learns and stream is slot.streams[0]:
                slot.sensor.learn(values)

    def take(self, slot: SensorSlot, t_ns: int) -> None:
        """Begin to compute the reading that a sensor has just begun at a time."""
        if not slot.sensor.takes_time or not slot.is_ready:
            return
        number = slot.number - 1
        if self._to_drop.get(slot.path) == number:
            del self._to_drop[slot.path]
            self._drop_reading(slot, number)
            return
        due_ns = t_ns + slot.delay_ns
        for k, stream in _numbered(slot):
            work = stream.coming.get(number)
            if isinstance(work, Work) and not work.is_begun and self._is_needed(k, slot):
                self._computing.begin(work, due_ns)

    def purge(self) -> None:
        """Remove the samples of lost readings. Not called while samples are delivered."""
        if self._dropped:
            lost, self._dropped = self._dropped, set()
            self._sensor_arrays.lose(lambda k, seq: (k, seq) in lost)

    def drop(self, args: Mapping[str, Json]) -> Json:
        """Carry out ``world/drop_reading``."""
        slot, number = self._slots.get(str(args["port"])), int(args["number"])  # type: ignore[arg-type]  # checked against the argument
        if slot is None:
            names = ", ".join(self._slots) or "none"
            text = f'no sensor that takes time is "{shown(str(args["port"]))}", there are: {names}'
            raise Refused("bad_argument", text, "port")
        if number == slot.number:
            self._to_drop[slot.path] = number
            return None
        if not any(number in stream.coming for stream in slot.streams):
            raise Refused("bad_argument", f"reading {number} is not under way; the next is {slot.number}", "number")
        self._drop_reading(slot, number)
        self.purge()
        return None

    def _drop_reading(self, slot: SensorSlot, number: int) -> None:
        for k, stream in _numbered(slot):
            work = stream.coming.pop(number, None)
            if isinstance(work, Work) and work is not stream.loose:
                work.is_cancelled = True
            self._dropped.add((k, number))
        self._computing.count_drop(slot.path, number)

    def _is_needed(self, k: int, slot: SensorSlot) -> bool:
        """Return whether the stream is read, or the sensor needs the values itself."""
        return self._is_read(k) or (slot.sensor.learns and k == slot.stream_numbers.start)


def _numbered(slot: SensorSlot) -> Iterator[tuple[int, SensorStream]]:
    return zip(slot.stream_numbers, slot.streams, strict=True)


def _is_busy(stream: SensorStream) -> bool:
    return any(isinstance(work, Work) and work.is_begun and not work.is_done for work in stream.coming.values())
