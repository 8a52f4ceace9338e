"""VectorNav VN-100 and VN-200: registers and asynchronous messages in ASCII, binary outputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from msgspec import Struct, field
from msgspec.structs import replace

from uwserver.adapter import AdapterContext
from uwserver.ports import Sample
from uwserver_adapters.devices import vectornav_messages as wire
from uwserver_adapters.devices.codec import NANOSECONDS
from uwserver_adapters.devices.device import Garbage, LineReader, Reply
from uwserver_adapters.devices.inertial import InertialDevice, InertialTable, Readings
from uwserver_adapters.devices.vectornav_messages import OUTPUTS, BinaryOutput, Command, Misread

ASYNC_TYPE, ASYNC_HZ, FIRST_BINARY, BINARIES = 6, 7, 75, 3
FIRMWARE = "2.1.0.0"
_READ_ONLY: Mapping[int, tuple[str, ...]] = {
    2: ("4",), 3: ("0100000001",), 4: (FIRMWARE,),
    # A scenario turns its sensors itself. A rotation that the device keeps but does not obey would be worse than a refusal.
    26: ("+1.000000", "+0.000000", "+0.000000", "+0.000000", "+1.000000", "+0.000000", "+0.000000", "+0.000000", "+1.000000"),
}  # fmt: skip
_KEPT: Mapping[int, tuple[str, ...]] = {
    0: ("",), 5: ("115200",), 30: ("0", "0", "0", "0", "1", "0", "1"), 32: ("3", "0", "0", "0", "6", "1", "0", "100000000", "0"),
    35: ("1", "1", "1", "1"),
}  # fmt: skip
"""Registers that are only kept: user tag, baud rate, protocol, synchronisation, attitude filter."""
_BY_REGISTER = {output.register: output for output in OUTPUTS.values()}


class VectorNavTable(InertialTable, tag="vectornav", kw_only=True, frozen=True):
    """Attributes:
    model: the VN-200 has a satellite receiver, and needs `gps`; the VN-100 has none.
    """

    model: Literal["VN-100", "VN-200"] = "VN-100"

    def __post_init__(self) -> None:
        """Raise ValueError where model and `gps` do not fit each other."""
        super().__post_init__()
        if (self.model == "VN-200") != (self.gps is not None):
            raise ValueError("gps goes with the VN-200, and with it alone: a VN-100 has no satellite receiver")

    def build(self, context: AdapterContext) -> VectorNav:
        """Return the device."""
        return VectorNav(self, context)


class Settings(Struct, frozen=True):
    """Settings that clients can write.

    Attributes:
        async_type: number of the asynchronous message, a key of `OUTPUTS`; 0 for none.
        async_hz: rate of that message.
        binary: the three binary outputs.
        kept: registers that are only kept.
    """

    async_type: int
    async_hz: int = 40
    binary: tuple[BinaryOutput, ...] = (BinaryOutput(),) * BINARIES
    kept: Mapping[int, tuple[str, ...]] = field(default_factory=lambda: _KEPT)


class _Refused(Exception):
    def __init__(self, number: int, reason: str) -> None:
        super().__init__(reason)
        self.number = number


class VectorNav(InertialDevice):
    """The device.

    Attributes:
        settings: the present settings.
    """

    def __init__(self, table: VectorNavTable, context: AdapterContext) -> None:
        super().__init__(table, context)
        self._model = table.model
        self._factory = Settings(22 if table.gps else 14)
        self._saved = self.settings = self._factory
        self._is_paused = False

    def reader(self) -> LineReader[Command | Misread | Garbage]:
        """Return a reader of commands."""
        return LineReader(wire.LINE_LIMIT, wire.read)

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def take(self, message: Command | Misread, reply: Reply) -> str:
        """Answer a command: by its echo with what it asked for, or by an error."""
        if isinstance(message, Misread):
            reply(wire.error(wire.BAD_CHECKSUM))
            return "the checksum of a message is wrong"
        try:
            reply(self._obeyed(message))
        except _Refused as refused:
            reply(wire.error(refused.number))
            return f"{message.verb}: {refused}"
        return ""

    def _obeyed(self, command: Command) -> bytes:
        values = command.values
        if command.verb == "VNRRG":
            _counted(values, 1, 1)
            number = _whole(values[0], 0, 255)
            return wire.line("VNRRG", f"{number:02d}", *self._read(number))
        if command.verb == "VNWRG":
            _counted(values, 2, len(values))
            number = _whole(values[0], 0, 255)
            self._write(number, values[1:])
            return wire.line("VNWRG", f"{number:02d}", *values[1:])
        if command.verb == "VNBOM":
            _counted(values, 1, 1)
            return self._poll(_whole(values[0], 0, 255))
        if command.verb == "VNASY":
            self._is_paused = _whole(values[0] if values else "", 0, 1) == 0
        elif command.verb == "VNWNV":
            self._saved = self.settings
        elif command.verb == "VNRFS":
            self._saved = self.settings = self._factory
        elif command.verb == "VNRST":
            self.settings, self._is_paused = self._saved, False
        else:
            raise _Refused(wire.UNKNOWN_COMMAND, "this simulated device does not know the command")
        return wire.line(command.verb, *values)

    def _read(self, number: int) -> tuple[str, ...]:
        settings = self.settings
        plain = {
            1: (self._model,),
            ASYNC_TYPE: (str(settings.async_type),),
            ASYNC_HZ: (str(settings.async_hz),),
            **_READ_ONLY,
            **settings.kept,
        }
        if number in plain:
            return plain[number]
        if 0 <= number - FIRST_BINARY < BINARIES:
            output = settings.binary[number - FIRST_BINARY]
            fields = (f"{bits:04X}" for bits in output.fields)
            return str(output.ports), str(output.divisor), f"{output.groups:02X}", *fields
        output_of = _BY_REGISTER.get(number)
        if output_of is None or (output_of.needs_gps and self._model == "VN-100"):
            raise _Refused(wire.UNKNOWN_REGISTER, f"register {number} is not simulated")
        return (output_of.values(self._readings()),)

    def _readings(self) -> Readings:
        if self.newest is None:
            raise _Refused(wire.BAD_PARAMETER, "nothing is measured yet")
        return self.newest

    def _write(self, number: int, values: tuple[str, ...]) -> None:
        settings = self.settings
        if number in (ASYNC_TYPE, ASYNC_HZ):
            _counted(values, 1, 2)  # the second value names one of the two lines of a real device; there is one here
            value = _whole(values[0], 0, 255)
            if number == ASYNC_HZ and value not in wire.FREQUENCIES_HZ:
                raise _Refused(wire.BAD_PARAMETER, f"{value} Hz: it is one of {wire.FREQUENCIES_HZ}")
            if number == ASYNC_TYPE and value and not self._has(value):
                raise _Refused(wire.BAD_PARAMETER, f"asynchronous message {value} is not simulated")
            name = "async_type" if number == ASYNC_TYPE else "async_hz"
            self.settings = replace(settings, **{name: value})
        elif 0 <= number - FIRST_BINARY < BINARIES:
            outputs = list(settings.binary)
            outputs[number - FIRST_BINARY] = _binary(values)
            self.settings = replace(settings, binary=tuple(outputs))
        elif number in settings.kept:
            most = len(_KEPT[number])
            _counted(values, min(1, most), max(most, 2) if number == 5 else most)
            self.settings = replace(settings, kept={**settings.kept, number: values})
        elif number == 1 or number in _READ_ONLY or number in _BY_REGISTER:
            raise _Refused(wire.NOT_ALLOWED, f"register {number} cannot be written")
        else:
            raise _Refused(wire.UNKNOWN_REGISTER, f"register {number} is not simulated")

    def _has(self, async_type: int) -> bool:
        output = OUTPUTS.get(async_type)
        return output is not None and (self._model == "VN-200" or not output.needs_gps)

    def _poll(self, number: int) -> bytes:
        if not 1 <= number <= BINARIES or not self.settings.binary[number - 1].groups:
            raise _Refused(wire.BAD_PARAMETER, f"there is no binary output {number}")
        return wire.encode(self.settings.binary[number - 1], self._readings())

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """Take a sample. Returns the messages that are due with a reading of the IMU."""
        readings = self.measure(sample)
        if readings is None or self._is_paused:
            return []
        settings, said, t_ns = self.settings, [], readings.t_ns
        if settings.async_type and self.is_due(0, t_ns // (NANOSECONDS // settings.async_hz)):
            output = OUTPUTS[settings.async_type]
            said.append(wire.line(output.header, output.values(readings)))
        for number, output_to in enumerate(settings.binary, start=1):
            if not (output_to.ports and output_to.groups and output_to.divisor):
                continue
            if self.is_due(number, t_ns // (output_to.divisor * NANOSECONDS // wire.IMU_RATE_HZ)):
                said.append(wire.encode(output_to, readings))
        return said


def _counted(values: tuple[str, ...], least: int, most: int) -> None:
    if len(values) < least:
        raise _Refused(wire.TOO_FEW, f"{len(values)} values, at least {least} are needed")
    if len(values) > most:
        raise _Refused(wire.TOO_MANY, f"{len(values)} values, at most {most} are taken")


def _whole(value: str, least: int, most: int, base: int = 10) -> int:
    try:
        number = int(value, base)
    except ValueError:
        raise _Refused(wire.BAD_PARAMETER, f'"{value[:20]}" is no whole number') from None
    if not least <= number <= most:
        raise _Refused(wire.BAD_PARAMETER, f"{number} is not in {least} to {most}")
    return number


def _binary(values: tuple[str, ...]) -> BinaryOutput:
    _counted(values, 3, 3 + len(wire.FIELDS))
    ports, divisor = _whole(values[0], 0, 3), _whole(values[1], 0, 0xFFFF)
    groups = _whole(values[2], 0, 0xFF, 16)
    # An output that is switched off may carry fields of groups that are not named: the maker's own library sends zeros.
    fields = tuple(_whole(value, 0, 0xFFFF, 16) for value in values[3:])
    output = BinaryOutput(ports, divisor, groups, fields if groups else ())
    if output.ports and output.groups and not divisor:
        raise _Refused(wire.BAD_PARAMETER, "the divisor of the rate is 0")
    if fault := wire.fault_of(output):
        raise _Refused(wire.BAD_PARAMETER, fault)
    return output
