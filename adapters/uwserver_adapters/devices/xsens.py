"""Xsens MTi: an inertial unit that speaks MTData2, with Xbus messages (MT Low Level Communication Protocol), big-endian.

A message is 0xFA, 0xFF, message id, length, data, and the sum that makes all bytes after 0xFA add up to 0.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from uwserver.adapter import AdapterContext
from uwserver.frames import Quat, frd_from_flu, matrix, multiply, rotate, rpy_from_quat
from uwserver.ports import Sample
from uwserver_adapters.devices.codec import NANOSECONDS, deg
from uwserver_adapters.devices.device import BinaryReader, Garbage, Reply
from uwserver_adapters.devices.inertial import InertialDevice, InertialTable, Readings

PREAMBLE, MASTER, EXTENDED = 0xFA, 0xFF, 0xFF
DATA_LIMIT = 2048
"""Longest data of a command, bytes, as the protocol allows."""
REQ_DID, GO_TO_MEASUREMENT, REQ_FIRMWARE = 0x00, 0x10, 0x12
REQ_BAUDRATE, REQ_PRODUCT_CODE, REQ_HARDWARE, GO_TO_CONFIG, MT_DATA_2 = 0x18, 0x1C, 0x1E, 0x30, 0x36
RESET, ERROR, OUTPUT_CONFIGURATION = 0x40, 0x42, 0xC0
INVALID_MESSAGE, INVALID_PARAMETER = 0x04, 0x21
EVERY = 0xFFFF
"""Rate of an item that is sent with every message."""
ENU, NED, NWU = 0x0, 0x4, 0x8
"""Local frames, in bits 2 and 3 of an item's number."""
FIELD_UNIT_T = 5e-5
"""Magnetic field that the device tells as 1, T: the field where it was calibrated, some 50 uT."""
_HALF = math.sqrt(0.5)
# The device's own axes are forward, left, up: the sensor's axes after half a turn about x.
_FLIP: Quat = (0.0, 1.0, 0.0, 0.0)
_FROM_NED: Mapping[int, Quat] = {ENU: (0.0, _HALF, _HALF, 0.0), NWU: _FLIP}
NEED_GPS = frozenset((0x5020, 0x5040, 0xD010))
"""Items of the satellite receiver."""
FIRMWARE, HARDWARE = (1, 12, 0), (2, 0)
MOST_ITEMS = 32
"""Most items of an output configuration."""
MOST_HZ = 2000
FACTORY = ((0x1020, EVERY), (0x1060, EVERY), (0x2010, 100), (0x4020, 100), (0x8020, 100))
"""Number and rate of each item: counter, time, quaternion, acceleration, rate of turn."""


@dataclass(frozen=True)
class XbusMessage:
    """Any message; its data are not parsed."""

    number: int
    data: bytes = b""


def encode(message: XbusMessage) -> bytes:
    """Return the bytes of a message."""
    size = len(message.data)
    length = bytes((size,)) if size < EXTENDED else bytes((EXTENDED,)) + size.to_bytes(2, "big")
    body = bytes((MASTER, message.number)) + length + message.data
    return bytes((PREAMBLE,)) + body + bytes((-sum(body) & 0xFF,))


class XbusReader(BinaryReader[XbusMessage]):
    """Splits a stream into messages."""

    mark, noun = bytes((PREAMBLE,)), "message of the Xbus protocol"

    def parse(self, buffer: bytearray) -> tuple[int, XbusMessage | Garbage | None]:
        """Read the message at the start of the buffer."""
        if len(buffer) < 4 or (buffer[3] == EXTENDED and len(buffer) < 6):
            return 0, None
        begin, size = (6, int.from_bytes(buffer[4:6], "big")) if buffer[3] == EXTENDED else (4, buffer[3])
        if buffer[1] not in (MASTER, 1) or size > DATA_LIMIT:
            return 1, Garbage("the head of a message is wrong")
        end = begin + size
        if len(buffer) <= end:
            return 0, None
        if sum(buffer[1 : end + 1]) & 0xFF:
            return 1, Garbage("the checksum of a message is wrong")
        return end + 1, XbusMessage(buffer[2], bytes(buffer[begin:end]))


# -- items ----------------------------------------------------------------------------------------------------------------------------


def orientation(q_NS: Quat, local: int) -> Quat:
    """Return the attitude of the device's axes in its local frame, w x y z; w is not negative."""
    w, x, y, z = multiply(multiply(_FROM_NED[local], q_NS), _FLIP)
    return (w, x, y, z) if w >= 0.0 else (-w, -x, -y, -z)


def _euler(r: Readings, local: int) -> tuple[float, ...]:
    roll, pitch, yaw = rpy_from_quat(orientation(r.q_NS, local))
    return deg(roll), deg(pitch), deg(math.remainder(yaw, 2.0 * math.pi))


def _rows(r: Readings, local: int) -> tuple[float, ...]:
    return tuple(value for row in matrix(orientation(r.q_NS, local)) for value in row)


def _utc(r: Readings) -> bytes:
    t = r.utc
    return struct.pack(">IH6B", t.microsecond * 1000, t.year, t.month, t.day, t.hour, t.minute, t.second, 0x07)


def _status(r: Readings) -> int:
    """Return the status bits: self test passed, filter valid, and whether there is a fix."""
    return 0x3 | (0x4 if r.fix.kind else 0)


REALS: Mapping[int, Callable[[Readings, int], tuple[float, ...]]] = {
    0x0810: lambda r, _: (r.temperature,),
    0x2010: lambda r, local: orientation(r.q_NS, local),
    0x2020: _rows,
    0x2030: _euler,
    0x4020: lambda r, _: frd_from_flu(r.f_S),
    0x5020: lambda r, _: (r.fix.height,),
    0x5040: lambda r, _: (deg(r.fix.latitude), deg(r.fix.longitude)),
    0x8020: lambda r, _: frd_from_flu(r.w_S),
    0xC020: lambda r, _: tuple(value / FIELD_UNIT_T for value in frd_from_flu(r.field_S)),
    0xD010: lambda r, local: rotate(_FROM_NED[local], r.fix.v_N),
}
"""Items that are real numbers. The last four bits of the item's number name the precision and the local frame."""
WHOLE: Mapping[int, Callable[[Readings, int], bytes]] = {
    0x1010: lambda r, _: _utc(r),
    0x1020: lambda _, count: struct.pack(">H", count & 0xFFFF),
    0x1060: lambda r, _: struct.pack(">I", r.t_ns // 100_000 & 0xFFFFFFFF),
    0x1070: lambda r, _: struct.pack(">I", r.t_ns // 1_000_000_000),
    0xE010: lambda r, _: bytes((_status(r) & 0xFF,)),
    0xE020: lambda r, _: struct.pack(">I", _status(r)),
}
"""All other items. The second argument is the number of the message."""


def fault_of(number: int, has_gps: bool) -> str:
    """Return why an item cannot be sent, or ""."""
    if number in WHOLE:
        return ""
    base, local = number & 0xFFF0, number & 0xC
    if base not in REALS or (base in NEED_GPS and not has_gps):
        return f"item 0x{number:04X} is not simulated"
    if local not in _FROM_NED:
        return f"item 0x{number:04X}: the local frames are ENU and NWU"
    return ""


def real(value: float, precision: int) -> bytes:
    """Return a number as float (precision 0), fixed point 12.20 (1), fixed point 16.32 (2) or double (3)."""
    if precision == 0:
        return struct.pack(">f", value)
    if precision == 3:
        return struct.pack(">d", value)
    bits, size = (20, 32) if precision == 1 else (32, 48)
    most = 1 << (size - 1)
    fixed = min(most - 1, max(-most, round(value * (1 << bits)))) & (2 * most - 1)
    if precision == 1:
        return fixed.to_bytes(4, "big")
    # The device sends the fraction before the whole part.
    return (fixed & 0xFFFFFFFF).to_bytes(4, "big") + (fixed >> 32).to_bytes(2, "big")


def item(number: int, readings: Readings, count: int) -> bytes:
    """Return an item of MTData2: its number, length and value."""
    if number in WHOLE:
        data = WHOLE[number](readings, count)
    else:
        values = REALS[number & 0xFFF0](readings, number & 0xC)
        data = b"".join(real(value, number & 0x3) for value in values)
    return number.to_bytes(2, "big") + bytes((len(data),)) + data


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
            REQ_DID: lambda _: struct.pack(">I", table.device_id),
            REQ_PRODUCT_CODE: lambda _: table.product_code.encode("ascii").ljust(20),
            REQ_FIRMWARE: lambda _: bytes(FIRMWARE),
            REQ_HARDWARE: lambda _: bytes(HARDWARE),
            REQ_BAUDRATE: lambda _: b"\x02",
            GO_TO_CONFIG: lambda _: self._measure(False),
            GO_TO_MEASUREMENT: lambda _: self._measure(True),
            RESET: lambda _: self._restart(),
            OUTPUT_CONFIGURATION: self._configure,
        }

    def reader(self) -> XbusReader:
        """Return a reader of messages."""
        return XbusReader()

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def take(self, message: XbusMessage, reply: Reply) -> str:
        """Answer a request: by the message of the next number, or by an error."""
        answer = self._answers.get(message.number)
        if answer is None:
            reply(encode(XbusMessage(ERROR, bytes((INVALID_MESSAGE,)))))
            return f"message 0x{message.number:02X} is not simulated"
        try:
            data = answer(message.data)
        except ValueError as error:
            reply(encode(XbusMessage(ERROR, bytes((INVALID_PARAMETER,)))))
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
                if fault := fault_of(number, self._has_gps):
                    raise ValueError(fault)
                if rate != EVERY and rate > MOST_HZ:
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
        timed = [(number, rate) for number, rate in self.items if 0 < rate < EVERY]
        due = [number for number, rate in timed if self.is_due(number, readings.t_ns * rate // NANOSECONDS)]
        if timed and not due:
            return []
        told = [number for number, rate in self.items if rate == EVERY or number in due]
        if not told:
            return []
        self._count += 1
        data = b"".join(item(number, readings, self._count) for number in told)
        return [encode(XbusMessage(MT_DATA_2, data))]
