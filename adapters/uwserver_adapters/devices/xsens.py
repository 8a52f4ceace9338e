"""Xsens MTi: an inertial unit that speaks MTData2."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Annotated

from msgspec import Meta

from uwserver.adapter import AdapterContext
from uwserver.ports import Sample
from uwserver_adapters.devices import xbus
from uwserver_adapters.devices.codec import NANOSECONDS
from uwserver_adapters.devices.device import Reply
from uwserver_adapters.devices.inertial import InertialDevice, InertialTable
from uwserver_adapters.devices.xbus import XbusMessage, XbusReader, encode

FIRMWARE, HARDWARE = (1, 12, 0), (2, 0)
MOST_ITEMS = 32
"""Most items of an output configuration."""
MOST_HZ = 2000
FACTORY = ((0x1020, xbus.EVERY), (0x1060, xbus.EVERY), (0x2010, 100), (0x4020, 100), (0x8020, 100))
"""Number and rate of each item: counter, time, quaternion, acceleration, rate of turn."""


class XsensTable(InertialTable, tag="xsens", kw_only=True, frozen=True):
    """Attributes:
    product_code: the product code that clients are told.
    device_id: the device id that clients are told.
    """

    product_code: Annotated[str, Meta(min_length=1, max_length=20, pattern="^[ -~]*$")] = "MTi-30-2A5G4"
    device_id: Annotated[int, Meta(ge=1, le=0xFFFFFFFF)] = 0x0360_0001

    def build(self, context: AdapterContext) -> Xsens:
        """Return the device."""
        return Xsens(self, context)


class Xsens(InertialDevice):
    """The device.

    Attributes:
        items: number and rate of each item that it sends.
        is_measuring: it sends measurements; otherwise it waits in its configuration state.
    """

    def __init__(self, table: XsensTable, context: AdapterContext) -> None:
        super().__init__(table, context)
        self._has_gps = table.gps is not None
        self.items: tuple[tuple[int, int], ...] = FACTORY
        self.is_measuring = True
        self._count = 0
        self._answers: Mapping[int, Callable[[bytes], bytes]] = {
            xbus.REQ_DID: lambda _: struct.pack(">I", table.device_id),
            xbus.REQ_PRODUCT_CODE: lambda _: table.product_code.encode("ascii").ljust(20),
            xbus.REQ_FIRMWARE: lambda _: bytes(FIRMWARE),
            xbus.REQ_HARDWARE: lambda _: bytes(HARDWARE),
            xbus.REQ_BAUDRATE: lambda _: b"\x02",
            xbus.GO_TO_CONFIG: lambda _: self._measure(False),
            xbus.GO_TO_MEASUREMENT: lambda _: self._measure(True),
            xbus.RESET: lambda _: self._restart(),
            xbus.OUTPUT_CONFIGURATION: self._configure,
        }

    def reader(self) -> XbusReader:
        """Return a reader of messages."""
        return XbusReader()

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def take(self, message: XbusMessage, reply: Reply) -> str:
        """Answer a request: by the message of the next number, or by an error."""
        answer = self._answers.get(message.number)
        if answer is None:
            reply(encode(XbusMessage(xbus.ERROR, bytes((xbus.INVALID_MESSAGE,)))))
            return f"message 0x{message.number:02X} is not simulated"
        try:
            data = answer(message.data)
        except ValueError as error:
            reply(encode(XbusMessage(xbus.ERROR, bytes((xbus.INVALID_PARAMETER,)))))
            return f"message 0x{message.number:02X}: {error}"
        reply(encode(XbusMessage(message.number + 1, data)))
        return ""

    def _measure(self, on: bool) -> bytes:
        self.is_measuring = on
        return b""

    def _restart(self) -> bytes:
        self.items, self.is_measuring, self._count = FACTORY, True, 0
        self._periods.clear()
        return b""

    def _configure(self, data: bytes) -> bytes:
        """Set the items that the device sends, and return them; empty data only ask for them. Raises ValueError where it cannot send them."""
        if data:
            if len(data) % 4 or len(data) > 4 * MOST_ITEMS:
                raise ValueError(f"an output configuration has four bytes an item, at most {MOST_ITEMS} items")
            items = tuple(struct.iter_unpack(">HH", data))
            for number, rate in items:
                if number == 0 and len(items) == 1:
                    continue  # this alone means that nothing is sent
                if fault := xbus.fault_of(number, self._has_gps):
                    raise ValueError(fault)
                if rate != xbus.EVERY and rate > MOST_HZ:
                    raise ValueError(f"item 0x{number:04X}: {rate} Hz, at most {MOST_HZ}")
            self.items = tuple((number, rate) for number, rate in items if number)
            self._periods.clear()
        return b"".join(struct.pack(">HH", *each) for each in self.items) or bytes(4)

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """Take a sample. Returns the items that are due with a reading of the IMU."""
        readings = self.measure(sample)
        if readings is None or not self.is_measuring:
            return []
        timed = [(number, rate) for number, rate in self.items if 0 < rate < xbus.EVERY]
        due = [number for number, rate in timed if self.is_due(number, readings.t_ns * rate // NANOSECONDS)]
        if timed and not due:
            return []
        told = [number for number, rate in self.items if rate == xbus.EVERY or number in due]
        if not told:
            return []
        self._count += 1
        data = b"".join(xbus.item(number, readings, self._count) for number in told)
        return [encode(XbusMessage(xbus.MT_DATA_2, data))]
