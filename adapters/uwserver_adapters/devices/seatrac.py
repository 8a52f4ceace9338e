"""Blueprint Subsea SeaTrac X150: it tells positions of other beacons (PING, NAV), sends datagrams (DAT), and tells its own status."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection
from typing import Annotated, Any, NamedTuple, cast

from msgspec import Meta
from msgspec.structs import replace

from uwserver.adapter import AdapterContext
from uwserver.frames import rotate
from uwserver.ports import Sample
from uwserver.table import Name, Table
from uwserver_adapters.devices import seatrac_messages as wire
from uwserver_adapters.devices.codec import NANOSECONDS
from uwserver_adapters.devices.device import DeviceInput, DeviceTable, Garbage, LineReader, Reply
from uwserver_adapters.devices.seatrac_messages import Datagrams, Found, Local, SeaTracMessage, encode

BeaconId = Annotated[int, Meta(ge=1, le=15)]
PART_X150, SERIAL_NUMBER, FIRMWARE = 795, 1, (2, 4, 1000)
_FIX = ("beacon", "range", "bearing", "elevation", "p_beacon_S", "travel_time")


class SeaTracBeacon(Table, kw_only=True, frozen=True):
    """Attributes:
    id: number of the beacon.
    depth: depth sensor of the vehicle that carries the beacon; the beacon tells its depth.
    attitude: attitude sensor of that vehicle; the beacon tells its attitude.
    """

    id: BeaconId
    depth: Name | None = None
    attitude: Name | None = None


class SeaTracTable(DeviceTable, tag="seatrac", kw_only=True, frozen=True):
    """Attributes:
    usbl: the sensor, of kind `usbl`.
    beacons: the other beacons, by the names that the sensor has for them.
    id: number of this beacon.
    attitude: attitude sensor of this beacon, mounted as the USBL sensor; without it there are only directions, and no positions.
    depth: depth sensor of this beacon, with a field `depth`.
    modem: modem of this beacon (``rov/modem``), by which it sends and receives datagrams; its addresses are the beacons' numbers.
    """

    usbl: Name
    beacons: Annotated[dict[str, SeaTracBeacon], Meta(min_length=1)]
    id: BeaconId = 15
    attitude: Name | None = None
    depth: Name | None = None
    modem: Name | None = None

    def __post_init__(self) -> None:
        """Raise ValueError where two beacons have one number."""
        super().__post_init__()
        numbers = [beacon.id for beacon in self.beacons.values()] + [self.id]
        if len(set(numbers)) < len(numbers):
            raise ValueError("two beacons have the same id: that of this beacon and those of `beacons` must differ")

    def build(self, context: AdapterContext) -> SeaTrac:
        """Return the device."""
        return SeaTrac(self, context)


class _BeaconSensors:
    """Attitude and depth sensors of one beacon, and their last readings."""

    def __init__(self, role: str, attitude: str | None, depth: str | None, context: AdapterContext) -> None:
        ports = context.ports
        self._attitude = DeviceInput(f"{role}attitude", attitude, ports, ("q_NS",)) if attitude else None
        self._depth = (
            DeviceInput(f"{role}depth", depth, ports, ("depth",), ("temperature", "pressure")) if depth else None
        )
        self.subscriptions = {source.path for source in (self._attitude, self._depth) if source is not None}
        self.local = Local()

    def see(self, sample: Sample) -> None:
        """Take a sample of any sensor."""
        if not sample.valid:
            return
        if self._attitude is not None and self._attitude.path == sample.port:
            self.local = replace(self.local, q_NS=self._attitude.values(sample)["q_NS"])
        if self._depth is not None and self._depth.path == sample.port:
            said = self._depth.values(sample)
            self.local = replace(self.local, **{name: value for name, value in said.items() if value is not None})

    def reset(self) -> None:
        """Forget all readings but the speed of sound."""
        self.local = Local(sound_speed=self.local.sound_speed)


class _Awaited(NamedTuple):
    """A fix of another beacon that a peer waits for.

    Attributes:
        name: name of the beacon; "" where there is none of this number, so that none will answer.
        number: number of the beacon.
        request: kind of the request.
        query: bits of a NAV request; None for a PING.
        reply: sends to the peer.
    """

    name: str
    number: int
    request: int
    query: int | None
    reply: Reply


class SeaTrac:
    """The device.

    Attributes:
        subscriptions: its ports.
    """

    def __init__(self, table: SeaTracTable, context: AdapterContext) -> None:
        self._table = table
        self._usbl = DeviceInput("usbl", table.usbl, context.ports, _FIX)
        self._own = _BeaconSensors("", table.attitude, table.depth, context)
        self._others = {
            name: _BeaconSensors(f"beacons.{name}.", beacon.attitude, beacon.depth, context)
            for name, beacon in table.beacons.items()
        }
        self._modem = Datagrams(table.id, table.modem, context) if table.modem else None
        self.subscriptions: Collection[str] = {self._usbl.path}.union(
            self._own.subscriptions,
            self._modem.subscriptions if self._modem else (),
            *(other.subscriptions for other in self._others.values()),
        )
        self._there = (wire.ATTITUDE if table.attitude else 0) | (wire.ENVIRONMENT if table.depth else 0)
        self._content = self._there
        self._mode = 1
        self._t_ns = 0
        self._period = -1
        self._awaited: _Awaited | None = None
        self._answers: dict[int, Callable[[], bytes]] = {
            wire.SYS_ALIVE: lambda: struct.pack("<I", self._t_ns // NANOSECONDS),
            wire.SYS_INFO: self._information,
            wire.SYS_REBOOT: self._reboot,
            wire.STATUS: self._status,
            wire.STATUS_CFG_GET: lambda: bytes((self._content, self._mode)),
            wire.XCVR_STATUS: lambda: bytes((wire.IDLE if self._awaited is None else wire.REQUESTING,)),
        }

    def reader(self) -> LineReader[SeaTracMessage | Garbage]:
        """Return a reader of commands."""
        return LineReader(wire.LINE_LIMIT, wire.decode)

    def reset(self) -> None:
        """Start again at another time; the configuration stays."""
        self._fail()
        self._t_ns, self._period = 0, -1
        for sensors in (self._own, *self._others.values()):
            sensors.reset()

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def take(self, message: SeaTracMessage, reply: Reply) -> str:
        """Carry out a command; its answer has the same number."""
        number = message.number
        if number == wire.DAT_SEND and self._modem is not None:
            return self._modem.send(message.payload, reply)
        if number in (wire.PING_SEND, wire.NAV_QUERY_SEND):
            return self._ask(number, message.payload, reply)
        if number == wire.STATUS_CFG_SET:
            return self._configure(message.payload, reply)
        if number not in self._answers:
            return f"command 0x{number:02X} is not simulated"
        reply(encode(SeaTracMessage(number, self._answers[number]())))
        return ""

    def _information(self) -> bytes:
        hardware = struct.pack("<HBIHH", PART_X150, 1, SERIAL_NUMBER, 0, 0)
        firmware = struct.pack("<BHBBHI", 1, PART_X150, *FIRMWARE, 0)
        return struct.pack("<IB", self._t_ns // NANOSECONDS, 1) + hardware + firmware + firmware + b"\x01"

    def _reboot(self) -> bytes:
        self._fail()
        self._content, self._mode = self._there, 1
        return bytes((wire.OK,))

    def _configure(self, payload: bytes, reply: Reply) -> str:
        reason, code = "", wire.OK
        if len(payload) != 2:
            reason, code = "status configuration: two bytes are needed", wire.PARAM_MISSING
        elif payload[0] & ~self._there:
            reason, code = f"status content 0x{payload[0]:02X}: there is 0x{self._there:02X}", wire.PARAM_INVALID
        elif payload[1] >= len(wire.STATUS_HZ):
            reason, code = f"status mode {payload[1]}: 0 to {len(wire.STATUS_HZ) - 1}", wire.PARAM_INVALID
        else:
            self._content, self._mode = payload
        reply(encode(SeaTracMessage(wire.STATUS_CFG_SET, bytes((code,)))))
        return reason

    def _ask(self, command: int, payload: bytes, reply: Reply) -> str:
        """Ask another beacon. The payload is its number, and the kind of request (PING) or the bits of what is asked (NAV)."""
        is_ping = command == wire.PING_SEND
        number, second = (*payload, 0, 0)[:2] if is_ping or len(payload) > 1 else (0, 0)
        request, query = (second, None) if is_ping else (wire.REQX, second)
        faults = (
            (len(payload) < 2, "a request: the number of the beacon and the kind are needed", wire.PARAM_MISSING),
            (not 1 <= number <= 15 or number == self._table.id, f"beacon {number}: 1 to 15, and not its own", wire.PARAM_INVALID),
            (request not in (wire.REQ, wire.REQU, wire.REQX), f"message type {request} asks for no answer", wire.PARAM_INVALID),
            (self._awaited is not None, "", wire.BUSY),
        )  # fmt: skip
        reason, code = next(((text, code) for is_wrong, text, code in faults if is_wrong), ("", wire.OK))
        reply(encode(SeaTracMessage(command, bytes((code, number)))))
        if code == wire.OK:
            name = next((name for name, beacon in self._table.beacons.items() if beacon.id == number), "")
            self._awaited = _Awaited(name, number, request, query, reply)
        return reason

    # -- readings -------------------------------------------------------------------------------------------------------------------

    def see(self, sample: Sample) -> list[bytes]:
        """Take a sample. The fix that a peer waits for goes to that peer; returned is the status for all, when it is due."""
        self._own.see(sample)
        for other in self._others.values():
            other.see(sample)
        if sample.port == self._usbl.path:
            self._see_fix(sample)
        if self._modem is not None and sample.port in self._modem.subscriptions:
            return self._modem.hear(sample, self._own.local)
        self._t_ns = max(self._t_ns, sample.t_ns)
        rate = wire.STATUS_HZ[self._mode]
        period = int(self._t_ns * rate / NANOSECONDS)
        if not rate or period == self._period:
            return []
        self._period = period
        return [encode(SeaTracMessage(wire.STATUS, self._status()))]

    def _see_fix(self, sample: Sample) -> None:
        said = cast(dict[str, Any], self._usbl.values(sample))
        if sample.valid and said["travel_time"] > 0.0:
            speed = 2.0 * said["range"] / said["travel_time"]
            self._own.local = replace(self._own.local, sound_speed=speed)
        awaited = self._awaited
        if awaited is None or awaited.name not in ("", said["beacon"]):
            return  # the sensor asks its beacons in turn, and this is the answer of another one
        if not awaited.name or not sample.valid:
            self._fail()
            return
        self._awaited = None
        awaited.reply(self._answer(awaited, said))

    def _answer(self, awaited: _Awaited, said: dict[str, Any]) -> bytes:
        local, remote = self._own.local, self._others[awaited.name].local
        found = Found(said["range"], said["travel_time"])
        if awaited.request != wire.REQ:
            p_N = None if local.q_NS is None else rotate(local.q_NS, said["p_beacon_S"])
            depth = remote.depth if awaited.request == wire.REQX else None
            found = replace(found, bearing=said["bearing"], elevation=said["elevation"], p_N=p_N, depth=depth)
        record = wire.fix(self._table.id, awaited.number, awaited.request + 1, local, found)
        if awaited.query is None:
            return encode(SeaTracMessage(wire.PING_RESP, record))
        depth_dm, temperature = wire.i32(wire.DECI * (remote.depth or 0.0)), wire.i16(wire.DECI * remote.temperature)
        known = {
            wire.QUERY_DEPTH: None if remote.depth is None else struct.pack("<i", depth_dm),
            wire.QUERY_TEMPERATURE: None if remote.depth is None else struct.pack("<h", temperature),
            wire.QUERY_ATTITUDE: None if remote.q_NS is None else remote.attitude(),
        }
        told = {bit: data for bit, data in known.items() if awaited.query & bit and data is not None}
        return encode(
            SeaTracMessage(wire.NAV_QUERY_RESP, record + bytes((sum(told),)) + b"".join(told.values()) + b"\x01")
        )

    def _fail(self) -> None:
        """Tell the peer that waits that no answer came."""
        awaited, self._awaited = self._awaited, None
        if awaited is not None:
            error = wire.PING_ERROR if awaited.query is None else wire.NAV_ERROR
            awaited.reply(encode(SeaTracMessage(error, bytes((wire.TIMED_OUT, awaited.number)))))

    def _status(self) -> bytes:
        local, content = self._own.local, self._content
        body = struct.pack("<BQ", content, self._t_ns // 1_000_000)
        body += local.environment() if content & wire.ENVIRONMENT else b""
        return body + (local.attitude() if content & wire.ATTITUDE else b"")
