"""The rows of autopilots: those of one autopilot (`AutopilotRow`), those of all autopilots of a world (`AutopilotArrays`), and typed records of them.

Python reads and writes the records. A saved state that no autopilot can have had is refused: it may come from a file that somebody else wrote.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple, TypeVar, cast

import msgspec
import numpy as np
from msgspec import Struct, structs

from uwserver.autopilot.config import Gains
from uwserver.autopilot.mission import Item
from uwserver.autopilot.rows import DEVICE, FORMS, FRAMES, MODES, PILOT, PILOTS, REMEMBERED, SENSOR
from uwserver.autopilot.state import GIVEN, NAN, REASONS, Estimate, Memory, Orders, Remembered
from uwserver.autopilot.vehicle_spec import VehicleSpec
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.straight import address_of, straight

R = TypeVar("R", Estimate, Memory, Orders)


class Form(NamedTuple):
    """Form of a field in a row: `read` makes the value from the number there, and `write` the number from the value."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


class Beside(NamedTuple):
    """Access to a field of a record that is not in its row."""

    get: Callable[[], Any]
    set: Callable[[Any], None]


def _choice(choices: Sequence[Any]) -> Form:
    """Return the form of a field that holds one of `choices`, as its index."""

    def read(code: int) -> Any:
        if not 0 <= code < len(choices):
            raise ValueError(f"{code} is no code of {', '.join(map(repr, choices))}")
        return choices[code]

    return Form(read, choices.index)


def _several(choices: Sequence[str]) -> Form:
    """Return the form of a field that holds some of `choices`, as bits."""

    def read(bits: int) -> tuple[str, ...]:
        if not 0 <= bits < 1 << len(choices):
            raise ValueError(f"{bits} are no bits of {', '.join(choices)}")
        return tuple([name for k, name in enumerate(choices) if bits >> k & 1])

    return Form(read, lambda names: sum(1 << choices.index(name) for name in names))


_FORMS: Mapping[str, Form] = {
    "mode": _choice(MODES),
    "pilot": _choice(PILOTS),
    "frame": _choice(FRAMES),
    "failsafe": _choice(REASONS),
    "given": _several(GIVEN),
    "attitude": Form(lambda q: None if math.isnan(q[0]) else q, lambda q: (NAN,) * 4 if q is None else q),
    **dict.fromkeys(
        ("leak", "armed", "waits", "looks", "blind", "settled", "astray", "entered"), _choice((False, True))
    ),
}


class _Place(NamedTuple):
    """The place of a field in a row: its first number (of 8 bytes); its length, 0 for a single number; whether the numbers are integers; its form."""

    first: int
    size: int
    is_whole: bool
    form: Form | None


@cache
def _places(form: Any) -> Mapping[str, _Place]:
    """Return the places of the fields of a dtype. Fields that are records themselves are left out."""
    places = {}
    for name in form.names:
        kind, offset = form.fields[name]
        if kind.names is None:
            places[name] = _Place(offset // 8, math.prod(kind.shape or (0,)), kind.base == np.int64, _FORMS.get(name))
    return places


class Live:
    """A typed record whose fields are in a row: reading a field gives the present value, and setting it changes the row.

    Fields are accessed by memory views, which refuse numbers of a wrong type or length before anything changes. A field of a numpy record would
    take five times as long.
    """

    __slots__ = ("_beside", "_kind", "_numbers", "_places", "_whole")

    def __init__(self, kind: type[Struct], beside: Mapping[str, Beside]) -> None:
        """Make a record of a type. `beside` gives access to the fields that are not in the row."""
        object.__setattr__(self, "_kind", kind)
        object.__setattr__(self, "_beside", beside)

    def bind_row(self, rows: Any) -> None:
        """Use this array of one row from now on."""
        set_own = partial(object.__setattr__, self)
        set_own("_places", _places(rows.dtype))
        set_own("_numbers", memoryview(rows.view(np.float64)))
        set_own("_whole", memoryview(rows.view(np.int64)))

    def __getattr__(self, name: str) -> Any:
        place = self._places.get(name)
        if place is None:
            return self._find(name).get()
        first, size, is_whole, form = place
        numbers = self._whole if is_whole else self._numbers
        return _value(numbers[first : first + size].tolist() if size else numbers[first], form)

    def __setattr__(self, name: str, value: Any) -> None:
        place = self._places.get(name)
        if place is None:
            self._find(name).set(value)
            return
        first, size, is_whole, form = place
        numbers, plain = self._whole if is_whole else self._numbers, value if form is None else form.write(value)
        if size:
            numbers[first : first + size] = array(numbers.format, plain)
        else:
            numbers[first] = plain

    def _find(self, name: str) -> Any:
        if name not in self._beside:
            raise AttributeError(f"{self._kind.__name__} has no {name}")
        return self._beside[name]

    def write(self, record: Struct) -> None:
        """Set all fields to those of a record."""
        for name in self._kind.__struct_fields__:
            setattr(self, name, getattr(record, name))


def record(kind: type[R], row: Any, beside: Mapping[str, Any]) -> R:
    """Return the typed record of a row, and of the values that are not in the row.

    Raises:
        ValueError: a number is not the code of any value.
    """
    names = row.dtype.names
    plain = map(_value, row.tolist(), map(_FORMS.get, names))
    return kind(**{**dict(zip(names, plain, strict=True)), **beside})


def _value(plain: Any, form: Form | None) -> Any:
    """Return the value of a number, vector or record in a row. Every NaN becomes the object `NAN`, so that equal rows give equal records."""
    if isinstance(plain, np.ndarray):
        plain = plain.tolist()
    if isinstance(plain, list):
        # The sum is NaN if a number is.
        total = sum(plain)
        plain = tuple(plain) if total == total else tuple([NAN if x != x else x for x in plain])
    elif plain != plain:
        plain = NAN
    return plain if form is None else form.read(plain)


def refuse_impossible(path: str, estimate: Estimate, memory: Memory, orders: Orders) -> None:
    """Refuse a saved state that no autopilot can have had.

    Args:
        path: path of the autopilot.
        estimate, memory, orders: the saved state.

    Raises:
        ValueError: an attitude without unit length, a present item that the mission does not have, or a number that is far too large.
    """
    for q in (estimate.q, orders.attitude or estimate.q):
        if not abs(math.hypot(*q) - 1.0) < 1e-3:
            raise ValueError(f'"{path}" has an attitude that is no rotation')
    if not -1 <= orders.index < len(orders.items) or not 0 <= orders.reached <= len(orders.items):
        raise ValueError(f'"{path}" is at an item that its mission does not have')
    limited = structs.replace(orders, turn_limit=0.0 if orders.turn_limit == math.inf else orders.turn_limit)
    if not all(_is_plausible(x) for part in (estimate, memory, limited) for x in _numbers(part)):
        raise ValueError(f'"{path}" holds a number out of all range')


def _is_plausible(x: float) -> bool:
    """Return whether a number is possible. Differences of whole numbers (times in ns, counts) must fit into 64 bits."""
    return abs(x) < 2**62 if isinstance(x, int) else math.isnan(x) or abs(x) < 1e12


def _numbers(value: object) -> Iterator[float]:
    """Yield all numbers in a record, at any depth."""
    if isinstance(value, float | int):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, Struct):
        yield from _numbers(structs.astuple(value))


class AutopilotRow:
    """The rows of one autopilot: its own, or in the arrays of a world.

    Attributes:
        spec: its vehicle.
        estimate, memory, orders: its records, which read and write the row.
        record, devices: a PILOT, and a DEVICE for each of its devices.
        k, first_sensor: number of its row in the arrays, and of the first SENSOR of its sensors.
    """

    first_sensor: int

    def __init__(self, spec: VehicleSpec) -> None:
        self.spec = spec
        self._gains = spec.gains
        self._items: tuple[Item, ...] = ()
        outputs = Beside(lambda: tuple(self.devices["part"].tolist()), self._set_outputs)
        gains = Beside(lambda: self._gains, self._set_gains)
        items = Beside(lambda: self._items, self._set_items)
        test = Beside(self._test, self._set_test)
        self._live = (
            Live(Estimate, {}),
            Live(Memory, {"outputs": outputs}),
            Live(Orders, {"gains": gains, "items": items, "test": test}),
        )
        self.estimate, self.memory, self.orders = cast("tuple[Estimate, Memory, Orders]", self._live)
        self.bind_row(None, 0, np.zeros(1, PILOT), spec.allocation.devices.copy())
        spec.fill(self.record["c"])
        self.write(spec.begin(), Memory(), Orders(gains=spec.gains, mode=spec.mode))
        self.switch()

    def bind_row(self, arrays: AutopilotArrays | None, k: int, pilots: Any, devices: Any) -> None:
        """Use row k and these rows of devices from now on. They already contain its values. `arrays` is None if these are rows of its own."""
        self._arrays, self.k, self.record, self.devices = arrays, k, pilots[k], devices
        self._here = pilots[k : k + 1].view(np.uint8)[: REMEMBERED.itemsize]
        for live, name in zip(self._live, "emo", strict=True):
            live.bind_row(pilots[name][k : k + 1])

    @property
    def arrays(self) -> AutopilotArrays:
        """The arrays of its rows; outside a world arrays of its own."""
        if self._arrays is None:
            AutopilotArrays().gather([self], {}, 0)
        assert self._arrays is not None
        return self._arrays

    def read(self) -> tuple[Estimate, Memory, Orders]:
        """Return copies of its records."""
        return self.records(self.save())

    def write(self, estimate: Estimate, memory: Memory, orders: Orders) -> None:
        """Replace its records."""
        for live, value in zip(self._live, (estimate, memory, orders), strict=True):
            live.write(value)

    def save(self) -> Remembered:
        """Return a copy of its records, as bytes."""
        devices = self.devices
        test = devices["test"].tobytes() if self.record["c"]["testing"] else b""
        return Remembered(self._here.tobytes(), devices["part"].tobytes(), test, self._items)

    def records(self, kept: Remembered) -> tuple[Estimate, Memory, Orders]:
        """Return a saved state as typed records.

        Raises:
            ValueError: it is not a state of this vehicle, or contains an impossible value.
        """
        wide = 8 * len(self.devices)
        if len(kept.row) != REMEMBERED.itemsize or len(kept.outputs) != wide or len(kept.test) not in (0, wide):
            raise ValueError(f'"{self.spec.path}" was saved by another version, or with other actuators')
        row: Any = np.frombuffer(kept.row, REMEMBERED)[0]
        outputs, test = (tuple(np.frombuffer(data).tolist()) for data in (kept.outputs, kept.test))
        return (
            record(Estimate, row["e"], {}),
            record(Memory, row["m"], {"outputs": outputs}),
            record(Orders, row["o"], {"gains": _gains_in(row), "items": kept.items, "test": test}),
        )

    def load(self, kept: Remembered) -> bool:
        """Restore a saved state that `records` has checked. Returns whether the mode, or who commands the actuators, has changed."""
        o = self.record["o"]
        before = o.copy()
        self._here[:] = np.frombuffer(kept.row, np.uint8)
        self.devices["part"] = np.frombuffer(kept.outputs)
        self.devices["test"] = np.frombuffer(kept.test) if kept.test else 0.0
        self.record["c"]["testing"] = bool(kept.test)
        self._set_items(kept.items)
        if before["gains"].tobytes() != o["gains"].tobytes():
            self._gains = _gains_in(self.record)
        return any(before[name] != o[name] for name in ("mode", "armed", "waits"))

    def forget(self) -> None:
        """Reset the memory of the controllers."""
        self._live[1].write(Memory())

    def _set_gains(self, gains: Gains) -> None:
        self._gains, self.record["o"]["gains"] = gains, structs.astuple(gains)

    def _set_items(self, items: tuple[Item, ...]) -> None:
        self._items, self.record["c"]["items"] = items, len(items)

    def _set_outputs(self, parts: Sequence[float]) -> None:
        self.devices["part"] = parts or 0.0

    def _test(self) -> tuple[float, ...]:
        return tuple(self.devices["test"].tolist()) if self.record["c"]["testing"] else ()

    def _set_test(self, parts: Sequence[float]) -> None:
        self.record["c"]["testing"], self.devices["test"] = bool(parts), parts or 0.0

    def stay(self) -> None:
        """Move the set points that no command has given to where the vehicle is."""
        self.arrays.entries.stay_one(self.arrays.table, self.k)

    def on_sample(self, port: str, values: Sequence[Any], t_ns: int, now_ns: int) -> None:
        """Correct the estimate by a valid sample of one of its ports."""
        place, numbers = self.spec.inputs.numbers(port, values)
        self.arrays.entries.listen_one(self.arrays.table, self.first_sensor + place, numbers, t_ns, now_ns)

    def tell(self, t_ns: int, row: FloatArray) -> int:
        """Write the reading of its port `state` into a row of numbers. Returns the number of its texts (`flight.tell`)."""
        arrays = self.arrays
        return int(arrays.tell_one(arrays.table, self.k, t_ns, row))

    def go_on(self, world: IntArray, t_ns: int, stage: int) -> int:
        """Continue a step at a stage. Returns what it needs Python for (`flight`). `world` is the table of the bodies' arrays."""
        return int(self.arrays.entries.step_on(self.arrays.table, world, self.k, t_ns, stage))

    def switch(self) -> None:
        """Find out which actuators are switched on."""
        first = 0
        for slot, count in zip(self.spec.held, self.spec.shares, strict=True):
            self.devices["active"][first : first + count] = slot.active
            first += count


class AutopilotArrays:
    """The rows of several autopilots, one after the other.

    Attributes:
        rows: rows of the autopilots.
        table: the table of the arrays for compiled code.
        entries: the module with the compiled code.
        tell_one: an entry of it that is called in ticks, without the search for a version.
    """

    def __init__(self) -> None:
        from uwserver.autopilot import entries

        self.entries = entries
        self.tell_one, self._step_all = straight(entries.tell_one), straight(entries.step_all)
        self.rows: tuple[AutopilotRow, ...] = ()

    def gather(self, rows: Iterable[AutopilotRow], streams: Mapping[str, int], count: int) -> None:
        """Hold the rows of these autopilots, and of no others. All autopilots that come or go keep their values.

        Args:
            rows: rows of the autopilots.
            streams: numbers of the streams that compiled code delivers, by port.
            count: count of these numbers.
        """
        gone, self.rows = self.rows, tuple(rows)
        all_inputs = [row.spec.inputs for row in self.rows]
        allocations = [row.spec.allocation for row in self.rows]
        pilots: Any = np.zeros(len(self.rows), PILOT)
        devices = _records(DEVICE, [row.devices for row in self.rows])
        sensors = _records(SENSOR, [each.rows for each in all_inputs])
        curves = np.concatenate([np.zeros((0, 2)), *[each.curves for each in allocations]])
        beacons = np.concatenate([np.zeros((0, 3)), *[each.beacons for each in all_inputs]])
        listeners = np.full(count, -1, np.int64)
        device = curve = sensor = beacon = 0
        for k, (row, inputs, allocation) in enumerate(zip(self.rows, all_inputs, allocations, strict=True)):
            own_devices, own_sensors = (
                devices[device : device + len(row.devices)],
                sensors[sensor : sensor + len(inputs.rows)],
            )
            pilots[k] = row.record
            own_devices["curve_first"] = allocation.devices["curve_first"] + curve
            own_sensors["pilot"], own_sensors["beacon_first"], own_sensors["next"] = k, beacon, -1
            for n, port in enumerate(inputs.ports):
                if port in streams and port not in inputs.text_ports:
                    own_sensors["next"][n], listeners[streams[port]] = listeners[streams[port]], sensor + n
            pilots["c"]["device_first"][k], pilots["c"]["device_count"][k] = device, len(own_devices)
            row.bind_row(self, k, pilots, own_devices)
            row.first_sensor = sensor
            device, curve = device + len(own_devices), curve + len(allocation.curves)
            sensor, beacon = sensor + len(own_sensors), beacon + len(inputs.beacons)
        self._kept: Mapping[str, Any] = {
            "pilots": pilots, "devices": devices, "curves": curves, "sensors": sensors, "beacons": beacons, "listeners": listeners,
        }  # fmt: skip
        self.table: IntArray = layout.addresses(FORMS, self._kept)
        for row in set(gone).difference(self.rows):
            # Another autopilot has its number now, so it gets rows of its own.
            row.bind_row(None, 0, np.array([row.record]), row.devices.copy())

    def step(self, world: IntArray, tick: int, t_ns: int) -> bool:
        """Step all autopilots that are due. Returns whether some need Python (`needs`). `world` is the table of the bodies' arrays."""
        return bool(self._step_all(self.table, world, tick, t_ns))

    def needs(self) -> tuple[tuple[int, int], ...]:
        """Return the numbers of the autopilots that need Python after a step, and for what (`flight`)."""
        needs = self._kept["pilots"]["c"]["need"].tolist()
        return tuple((k, need) for k, need in enumerate(needs) if need)

    def codes(self) -> tuple[int, int, int]:
        """Return the addresses of `entries.step_all`, `listen_all` and `tell_one`, for kernels that call them (`kernel.calling`)."""
        entries = self.entries
        step, listen, tell = entries.step_all, entries.listen_all, entries.tell_one
        return address_of(step, "int64"), address_of(listen, "none"), address_of(tell, "int64")


def _gains_in(row: Any) -> Gains:
    """Return the gains in a PILOT or a REMEMBERED; ValueError if one is outside its limits."""
    return msgspec.convert(dict(zip(Gains.__struct_fields__, row["o"]["gains"].tolist(), strict=True)), Gains)


def _records(form: np.dtype[Any], parts: Sequence[Any]) -> Any:
    """Join arrays of records. They are joined as bytes, because numpy compares all fields when it joins records."""
    plain = f"V{form.itemsize}"
    return np.concatenate([np.zeros(0, plain), *[part.view(plain) for part in parts]]).view(form)
