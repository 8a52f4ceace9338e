"""Autopilots as rows: where each lies, alone or in the bank of a world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import msgspec
import numpy as np
from msgspec import structs

from uwserver.autopilot.craft import Craft
from uwserver.autopilot.flight import SHOWN
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.mission import Item
from uwserver.autopilot.records import Beside, Live, record
from uwserver.autopilot.rows import DEVICE, FORMS, ORDERS, PILOT, REMEMBERED, SOURCE
from uwserver.autopilot.state import NAN, Estimate, Memory, Orders, Remembered
from uwserver.frames import Vec3
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.straight import address_of, straight


def _bytes_of(first: str, end: str) -> slice:
    """Of REMEMBERED: those of the orders from one on to before another."""
    begin = _offset(REMEMBERED, "o")
    return slice(begin + _offset(ORDERS, first), begin + _offset(ORDERS, end))


def _offset(form: np.dtype[Any], name: str) -> int:
    fields = form.fields
    assert fields is not None
    return int(fields[name][1])


_GAINS, _STANCE = _bytes_of("gains", "mode"), _bytes_of("mode", "stick")
"""The gains; mode, armed and waits."""


class Seat:
    """The rows of one autopilot: alone, or in the bank of a world.

    Attributes:
        craft: its vehicle.
        estimate, memory, orders: what it believes, remembers, and was told, as they stand in its row.
        bank, k: where it lies.
    """

    def __init__(self, craft: Craft) -> None:
        self.craft = craft
        self._gains = craft.gains
        self._items: tuple[Item, ...] = ()
        self._shown: FloatArray = np.zeros(SHOWN)
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
        self.lie(None, 0, np.zeros(1, PILOT), craft.allocation.devices.copy())
        craft.fill(self.row["c"])
        self.write(craft.begin(), Memory(), Orders(gains=craft.gains, mode=craft.mode))
        self.switch()

    def lie(self, bank: Bank | None, k: int, pilots: Any, devices: Any) -> None:
        """Row k, and these of its devices, are its own from now on; they hold all that it was. `bank`: None for none."""
        self._bank, self.k, self.row, self.devices = bank, k, pilots[k], devices
        self._here = pilots[k : k + 1].view(np.uint8)[: REMEMBERED.itemsize]
        for live, name in zip(self._live, "emo", strict=True):
            live.lie(pilots[name][k : k + 1])

    @property
    def bank(self) -> Bank:
        """Where it lies; one of its own outside of a world."""
        if self._bank is None:
            Bank().gather([self], {}, 0)
        assert self._bank is not None
        return self._bank

    def read(self) -> tuple[Estimate, Memory, Orders]:
        """Copies of its records."""
        estimate, memory, orders = self._live
        return estimate.read(), memory.read(), orders.read()

    def write(self, estimate: Estimate, memory: Memory, orders: Orders) -> None:
        """Put others in their place."""
        for live, value in zip(self._live, (estimate, memory, orders), strict=True):
            live.write(value)

    def save(self) -> Remembered:
        """The same copies as they lie here."""
        devices = self.devices
        test = devices["test"].tobytes() if self.row["c"]["testing"] else b""
        return Remembered(self._here.tobytes(), devices["part"].tobytes(), test, self._items)

    def records(self, kept: Remembered) -> tuple[Estimate, Memory, Orders]:
        """What was saved as typed records; changes nothing.

        Raises:
            ValueError: it is not of this vehicle, or cannot be.
        """
        wide = 8 * len(self.devices)
        if len(kept.row) != REMEMBERED.itemsize or len(kept.outputs) != wide or len(kept.test) not in (0, wide):
            raise ValueError(f'"{self.craft.path}" is made of other numbers, or commands other actuators')
        row: Any = np.frombuffer(kept.row, REMEMBERED)[0]
        outputs, test = (tuple(np.frombuffer(data).tolist()) for data in (kept.outputs, kept.test))
        gains = msgspec.convert(dict(zip(Gains.__struct_fields__, row["o"]["gains"].tolist(), strict=True)), Gains)
        return (
            record(Estimate, row["e"], {}),
            record(Memory, row["m"], {"outputs": outputs}),
            record(Orders, row["o"], {"gains": gains, "items": kept.items, "test": test}),
        )

    def load(self, kept: Remembered) -> bool:
        """Put back what was saved, and checked by `records`. Returns whether the mode, or who commands the actuators, is another one."""
        before = self._here.tobytes()
        self._here[:] = np.frombuffer(kept.row, np.uint8)
        self.devices["part"] = np.frombuffer(kept.outputs)
        self.devices["test"] = np.frombuffer(kept.test) if kept.test else 0.0
        self.row["c"]["testing"] = bool(kept.test)
        self._set_items(kept.items)
        if before[_GAINS] != kept.row[_GAINS]:
            self._gains = Gains(**dict(zip(Gains.__struct_fields__, self.row["o"]["gains"].tolist(), strict=True)))
        return bool(before[_STANCE] != kept.row[_STANCE])

    def forget(self) -> None:
        """What the controllers remember is that of the start."""
        self._live[1].write(Memory())

    def _set_gains(self, gains: Gains) -> None:
        self._gains, self.row["o"]["gains"] = gains, structs.astuple(gains)

    def _set_items(self, items: tuple[Item, ...]) -> None:
        self._items, self.row["c"]["items"] = items, len(items)

    def _set_outputs(self, parts: Sequence[float]) -> None:
        self.devices["part"] = parts or 0.0

    def _test(self) -> tuple[float, ...]:
        return tuple(self.devices["test"].tolist()) if self.row["c"]["testing"] else ()

    def _set_test(self, parts: Sequence[float]) -> None:
        self.row["c"]["testing"], self.devices["test"] = bool(parts), parts or 0.0

    def stay(self) -> None:
        """Set points that no command has given are where the vehicle is."""
        self.bank.entries.stay_one(self.bank.table, self.k)

    def set_course(self, place: Vec3, heading: float | None, speed: float | None, radius: float) -> None:
        """Go to a place, p_N in m, at its depth.

        Args:
            place: to go to.
            heading: rad; None for looking where it goes.
            speed: m/s; None for that of the gains.
            radius: within which it has arrived, m.
        """
        heading, speed = NAN if heading is None else heading, NAN if speed is None else speed
        self.bank.set_course_one(self.bank.table, self.k, *place, heading, speed, radius)

    def leave_bottom(self) -> None:
        """The depth no longer follows the bottom."""
        self.bank.leave_bottom_one(self.bank.table, self.k)

    def hear(self, port: str, values: Sequence[Any], t_ns: int, now_ns: int) -> None:
        """Take a valid sample of one of its ports into the estimate."""
        place, numbers = self.craft.hearing.numbers(port, values)
        self.bank.entries.hear_one(self.bank.table, self.bank.first_source(self) + place, numbers, t_ns, now_ns)

    def show(self, t_ns: int) -> tuple[list[float], tuple[float, ...]]:
        """What it believes and wants, as `flight.show` has it, and its outputs."""
        self.bank.entries.show_one(self.bank.table, self.k, t_ns, self._shown)
        return self._shown.tolist(), tuple(self.devices["part"].tolist())

    def tell(self, t_ns: int, row: FloatArray) -> int:
        """Write what its port `state` tells into the row of numbers of a reading; returns which texts belong to it (`entries.tell_one`)."""
        bank = self.bank
        return int(bank.tell_one(bank.table, self.k, t_ns, row))

    def go_on(self, world: IntArray, t_ns: int, stage: int) -> int:
        """Go on with a step from a stage; returns what it needs of Python. `world`: the table of the bodies' arrays."""
        return int(self.bank.entries.step_on(self.bank.table, world, self.k, t_ns, stage))

    def switch(self) -> None:
        """Actuators were switched on or off."""
        first = 0
        for slot, count in zip(self.craft.held, self.craft.shares, strict=True):
            self.devices["active"][first : first + count] = slot.active
            first += count


class Bank:
    """Rows of autopilots, one after the other.

    Attributes:
        seats: whose they are.
        table: by which compiled code finds them.
        entries: the compiled code.
        tell_one, set_course_one, leave_bottom_one: of it, as they are called in ticks.
    """

    def __init__(self) -> None:
        from uwserver.autopilot import entries

        self.entries = entries
        self.tell_one, self._step_all = straight(entries.tell_one), straight(entries.step_all)
        self.set_course_one, self.leave_bottom_one = (
            straight(entries.set_course_one),
            straight(entries.leave_bottom_one),
        )
        self.seats: tuple[Seat, ...] = ()
        self._first: list[int] = []

    def gather(self, seats: Iterable[Seat], streams: Mapping[str, int], count: int) -> None:
        """Let these, and no others, lie here.

        Args:
            seats: they move in, and keep what they are; so do those that move out.
            streams: numbers of the streams of samples that compiled code delivers, by port.
            count: of such numbers.
        """
        gone, self.seats = self.seats, tuple(seats)
        hearings = [seat.craft.hearing for seat in self.seats]
        allocations = [seat.craft.allocation for seat in self.seats]
        pilots: Any = np.zeros(len(self.seats), PILOT)
        devices = _records(DEVICE, [seat.devices for seat in self.seats])
        sources = _records(SOURCE, [each.rows for each in hearings])
        curves = np.concatenate([np.zeros((0, 2)), *[each.curves for each in allocations]])
        beacons = np.concatenate([np.zeros((0, 3)), *[each.beacons for each in hearings]])
        ears = np.full(count, -1, np.int64)
        self._first, firsts = [], []
        device = curve = source = beacon = 0
        for k, (seat, hearing, allocation) in enumerate(zip(self.seats, hearings, allocations, strict=True)):
            rows, heard = devices[device : device + len(seat.devices)], sources[source : source + len(hearing.rows)]
            pilots[k] = seat.row
            rows["curve_first"] = allocation.devices["curve_first"] + curve
            heard["pilot"], heard["beacon_first"], heard["next"] = k, beacon, -1
            for n, port in enumerate(hearing.ports):
                if port in streams and port not in hearing.in_words:
                    heard["next"][n], ears[streams[port]] = ears[streams[port]], source + n
            self._first.append(source)
            firsts.append((device, len(rows)))
            seat.lie(self, k, pilots, rows)
            device, curve = device + len(rows), curve + len(allocation.curves)
            source, beacon = source + len(heard), beacon + len(hearing.beacons)
        pilots["c"]["device_first"], pilots["c"]["device_count"] = np.array(firsts, np.int64).reshape(-1, 2).T
        self._kept: Mapping[str, Any] = {
            "pilots": pilots, "devices": devices, "curves": curves, "sources": sources, "beacons": beacons, "ears": ears,
        }  # fmt: skip
        self.table: IntArray = layout.addresses(FORMS, self._kept)
        for seat in set(gone).difference(self.seats):
            # Its number is that of another one from now on.
            seat.lie(None, 0, np.array([seat.row]), seat.devices.copy())

    def first_source(self, seat: Seat) -> int:
        """The row of the first sensor that one hears."""
        return self._first[seat.k]

    def step(self, world: IntArray, tick: int, t_ns: int) -> bool:
        """Step all that are due; whether some need Python (`needs`). `world`: the table of the bodies' arrays."""
        return bool(self._step_all(self.table, world, tick, t_ns))

    def needs(self) -> tuple[tuple[int, int], ...]:
        """The rows of those who need Python after a step, and for what (`flight`)."""
        needs = self._kept["pilots"]["c"]["need"].tolist()
        return tuple((k, need) for k, need in enumerate(needs) if need)

    def codes(self) -> tuple[int, int, int]:
        """Where the code of `entries.step_all`, `hear_all` and `tell_one` lies, for kernels that call it (`kernel.calling`)."""
        entries = self.entries
        step, hear, tell = entries.step_all, entries.hear_all, entries.tell_one
        return address_of(step, "int64"), address_of(hear, "none"), address_of(tell, "int64")


def _records(form: np.dtype[Any], parts: Sequence[Any]) -> Any:
    """Records of one form, one after the other; as bytes, since numpy compares the fields of each two arrays of records that it joins."""
    plain = f"V{form.itemsize}"
    return np.concatenate([np.zeros(0, plain), *[part.view(plain) for part in parts]]).view(form)
