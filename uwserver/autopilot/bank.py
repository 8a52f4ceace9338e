"""Autopilots as rows: where each lies, alone or in the bank of a world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np
from msgspec import structs

from uwserver.autopilot.craft import Craft
from uwserver.autopilot.flight import SHOWN
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.rows import DEVICE, FORMS, PILOT, SOURCE, Beside, Live
from uwserver.autopilot.state import Estimate, Memory, Orders
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray


class Seat:
    """The rows of one autopilot: alone, or in the bank of a world.

    Attributes:
        craft: its vehicle.
        estimate, memory, orders: what it believes, remembers, and was told, as they stand in its row.
        bank, k: where it lies.
    """

    def __init__(self, craft: Craft) -> None:
        self.craft = craft
        self.row: Any = np.zeros(1, PILOT)[0]
        self.devices: Any = craft.allocation.devices.copy()
        craft.fill(self.row["c"])
        self._gains = craft.gains
        self._shown: FloatArray = np.zeros(SHOWN)
        outputs = Beside(lambda: tuple(self.devices["part"].tolist()), self._set_outputs)
        gains = Beside(lambda: self._gains, self._set_gains)
        mission: dict[str, Any] = {"items": ()}
        items = Beside(lambda: mission["items"], lambda value: mission.update(items=value))
        test = Beside(self._test, self._set_test)
        self._live = (
            Live(Estimate, {}),
            Live(Memory, {"outputs": outputs}),
            Live(Orders, {"gains": gains, "items": items, "test": test}),
        )
        self.estimate, self.memory, self.orders = cast("tuple[Estimate, Memory, Orders]", self._live)
        self.bank, self.k = Bank(), 0
        self.bank.gather([self], {}, 0)
        self.write(craft.begin(), Memory(), Orders(gains=craft.gains, mode=craft.mode))
        self.switch()

    def lie(self, bank: Bank, k: int, row: Any, devices: Any) -> None:
        """These are its rows from now on, which hold all that it was."""
        self.bank, self.k, self.row, self.devices = bank, k, row, devices
        for record, name in zip(self._live, "emo", strict=True):
            record.lie(row[name])

    def read(self) -> tuple[Estimate, Memory, Orders]:
        """Copies of its records."""
        estimate, memory, orders = self._live
        return estimate.read(), memory.read(), orders.read()

    def write(self, estimate: Estimate, memory: Memory, orders: Orders) -> None:
        """Put others in their place."""
        for record, value in zip(self._live, (estimate, memory, orders), strict=True):
            record.write(value)

    def forget(self) -> None:
        """What the controllers remember is that of the start."""
        self._live[1].write(Memory())

    def _set_gains(self, gains: Gains) -> None:
        self._gains, self.row["o"]["gains"] = gains, structs.astuple(gains)

    def _set_outputs(self, parts: Sequence[float]) -> None:
        self.devices["part"] = parts or 0.0

    def _test(self) -> tuple[float, ...]:
        return tuple(self.devices["test"].tolist()) if self.row["c"]["testing"] else ()

    def _set_test(self, parts: Sequence[float]) -> None:
        self.row["c"]["testing"], self.devices["test"] = bool(parts), parts or 0.0

    def stay(self) -> None:
        """Set points that no command has given are where the vehicle is."""
        self.bank.entries.stay_one(self.bank.table, self.k)

    def hear(self, port: str, values: Sequence[Any], t_ns: int, now_ns: int) -> None:
        """Take a valid sample of one of its ports into the estimate."""
        place, numbers = self.craft.hearing.numbers(port, values)
        self.bank.entries.hear_one(self.bank.table, self.bank.first_source(self) + place, numbers, t_ns, now_ns)

    def show(self, t_ns: int) -> tuple[list[float], tuple[float, ...]]:
        """What it believes and wants, as `flight.show` has it, and its outputs."""
        self.bank.entries.show_one(self.bank.table, self.k, t_ns, self._shown)
        return self._shown.tolist(), tuple(self.devices["part"].tolist())

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
    """

    def __init__(self) -> None:
        from uwserver.autopilot import entries

        self.entries = entries
        self.seats: tuple[Seat, ...] = ()
        self._first: list[int] = []

    def gather(self, seats: Iterable[Seat], streams: Mapping[str, int], count: int) -> None:
        """Let these, and no others, lie here.

        Args:
            seats: they move in, and keep what they are.
            streams: numbers of the streams of samples that compiled code delivers, by port.
            count: of such numbers.
        """
        self.seats = tuple(seats)
        crafts = [seat.craft for seat in self.seats]
        pilots: Any = np.zeros(len(self.seats), PILOT)
        devices = _joined([seat.devices for seat in self.seats], np.zeros(0, DEVICE))
        curves = _joined([craft.allocation.curves for craft in crafts], np.zeros((0, 2)))
        sources = _joined([craft.hearing.rows for craft in crafts], np.zeros(0, SOURCE))
        beacons = _joined([craft.hearing.beacons for craft in crafts], np.zeros((0, 3)))
        ears = np.full(count, -1, np.int64)
        self._first = []
        device = curve = source = beacon = 0
        for k, seat in enumerate(self.seats):
            allocation, hearing = seat.craft.allocation, seat.craft.hearing
            rows = devices[device : device + len(seat.devices)]
            pilots[k] = seat.row
            pilots[k]["c"]["device_first"], pilots[k]["c"]["device_count"] = device, len(rows)
            rows["curve_first"] = allocation.devices["curve_first"] + curve
            heard = sources[source : source + len(hearing.rows)]
            heard["pilot"], heard["beacon_first"] = k, beacon
            for n, port in enumerate(hearing.ports):
                if port in streams and port not in hearing.in_words:
                    ears[streams[port]] = source + n
            self._first.append(source)
            seat.lie(self, k, pilots[k], rows)
            device, curve = device + len(rows), curve + len(allocation.curves)
            source, beacon = source + len(heard), beacon + len(hearing.beacons)
        self._kept: Mapping[str, Any] = {
            "pilots": pilots, "devices": devices, "curves": curves, "sources": sources, "beacons": beacons, "ears": ears,
        }  # fmt: skip
        self.table: IntArray = layout.addresses(FORMS, self._kept)

    def first_source(self, seat: Seat) -> int:
        """The row of the first sensor that one hears."""
        return self._first[seat.k]

    def step(self, world: IntArray, tick: int, t_ns: int) -> tuple[tuple[int, int], ...]:
        """Step all that are due; the rows of those who need Python, and for what (`flight`). `world`: the table of the bodies' arrays."""
        if not self.entries.step_all(self.table, world, tick, t_ns):
            return ()
        needs = self._kept["pilots"]["c"]["need"].tolist()
        return tuple((k, need) for k, need in enumerate(needs) if need)

    def hear(self, told: Any, values: FloatArray, count: int, now_ns: int) -> None:
        """See `entries.hear_all`."""
        self.entries.hear_all(self.table, told, values, count, now_ns)


def _joined(parts: Sequence[Any], nothing: Any) -> Any:
    return np.concatenate([nothing, *parts])
