"""Parameters with the names and defaults of ArduSub. Those that mean something in the simulation take effect (docs/reference/mavlink.md).

`parameters.json` holds type and default of each: the ones that take effect, and the ones that QGroundControl and Cockpit request by name.

Ground stations read them one by one, or as a file by the file transfer protocol. Files are read-only; everything else is refused at once.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from importlib.resources import files

import msgspec
from msgspec import Struct

from uwserver_adapters.mavlink.wire.channel import Outgoing
from uwserver_adapters.mavlink.wire.dialect import Fields, addressed_to

_RANGES = {"int8": (-0x80, 0x7F), "int16": (-0x8000, 0x7FFF), "int32": (-0x8000_0000, 0x7FFF_FFFF)}
_WIRE_TYPES = {"int8": 2, "int16": 4, "int32": 6, "real32": 9}
"""Numbers of MAV_PARAM_TYPE."""
PACKED = {"int8": (1, "b"), "int16": (2, "h"), "int32": (3, "i"), "real32": (4, "f")}
"""Number and format of a type in a packed parameter file."""
READ_ONLY = frozenset({"MAV_SYSID", "FORMAT_VERSION", "STAT_BOOTCNT", "STAT_RUNTIME", "STAT_FLTTIME", "MIS_TOTAL"})
"""Parameters that only the scenario may set."""
_HEAD = struct.Struct("<HBBBBBxI")
DATA = 239
"""Bytes of a file in one message."""
SIZE = 251
TERMINATE, RESET, LIST, OPEN, READ, CRC, BURST, ACK, NAK = 1, 2, 3, 4, 5, 14, 15, 128, 129
INVALID_SESSION, NO_SESSIONS, END, UNKNOWN_COMMAND, NOT_FOUND = 4, 5, 6, 7, 10
SESSIONS = 64
"""Files that may be open at a time, of all clients."""
BURST_PARTS = 20
"""Messages of one burst: 4780 bytes. Then the peer requests the next."""


class Parameters:
    """All parameters. Values last until the adapter ends.

    Args:
        given: values that differ from the defaults, by name.

    Attributes:
        names: all names, in the order of their index.

    Raises:
        ValueError: a given name does not exist, or a value is not allowed. The text says which.
    """

    def __init__(self, given: Mapping[str, float]) -> None:
        text = files(__package__).joinpath("parameters.json").read_bytes()
        table = msgspec.json.decode(text, type=dict[str, tuple[str, float]])
        self._types = {name: kind for name, (kind, _) in table.items()}
        self._defaults = {name: float(value) for name, (_, value) in table.items()}
        self._values = dict(self._defaults)
        self.names = tuple(table)
        self._packed: dict[bool, bytes] = {}
        self._places = {name: index for index, name in enumerate(self.names)}
        for name, value in given.items():
            if not self.set(name, value, is_trusted=True):
                raise ValueError(
                    f'parameters: "{name}" = {value!r}: there is no such parameter, or it cannot have that value'
                )

    @property
    def gcs_system(self) -> int:
        """System number of the ground station that may steer."""
        return round(self._values["MAV_GCS_SYSID"])

    def value(self, name: str) -> float:
        """Return the value of a parameter."""
        return self._values[name]

    def set(self, name: str, value: float, is_trusted: bool = False) -> bool:
        """Set a parameter, truncated if its type is an integer. Only a trusted caller sets `READ_ONLY` ones.

        Returns:
            False for an unknown name, a value that is not finite or does not fit the type, and a read-only parameter.
        """
        if name not in self._values or not math.isfinite(value) or (name in READ_ONLY and not is_trusted):
            return False
        self._packed.clear()
        kind = self._types[name]
        if kind == "real32":
            if abs(value) > 3.4e38:
                return False
            self._values[name] = struct.unpack("<f", struct.pack("<f", value))[0]
            return True
        low, high = _RANGES[kind]
        whole = math.trunc(value)  # ArduPilot casts in C: 3.7 becomes 3
        if not low <= whole <= high:
            return False
        self._values[name] = float(whole)
        return True

    def at(self, index: int) -> str | None:
        """Return the name at an index, None where there is none."""
        return self.names[index] if 0 <= index < len(self.names) else None

    def message(self, name: str, is_answer_to_set: bool = False) -> Fields:
        """Return the fields of PARAM_VALUE. The value is a float for every type, as in ArduPilot."""
        return {
            "param_id": name,
            "param_value": self._values[name],
            "param_type": _WIRE_TYPES[self._types[name]],
            "param_count": len(self.names),
            "param_index": 0xFFFF if is_answer_to_set else self._places[name],
        }

    def download(self) -> Iterator[Outgoing]:
        """Yield one message for each parameter, with the value at the time when it is sent."""
        for name in self.names:
            yield "PARAM_VALUE", self.message(name)

    def packed(self, with_defaults: bool) -> bytes:
        """Return the file `@PARAM/param.pck`, in which a name leaves out what it shares with the name before.

        The file is kept until a parameter is set: it takes 0.8 ms to build, and a peer may open it 2000 times a second.

        Args:
            with_defaults: add the defaults where they differ from the values.
        """
        if with_defaults not in self._packed:
            self._packed[with_defaults] = self._pack(with_defaults)
        return self._packed[with_defaults]

    def _pack(self, with_defaults: bool) -> bytes:
        names = sorted(self.names)
        out = bytearray(struct.pack("<HHH", 0x671C if with_defaults else 0x671B, len(names), len(names)))
        before = ""
        for name in names:
            common = 0
            while common < min(len(before), len(name) - 1, 15) and before[common] == name[common]:
                common += 1
            number, form = PACKED[self._types[name]]
            value, default = self._values[name], self._defaults[name]
            has_default = with_defaults and value != default
            tail = name[common:].encode("ascii")
            # Type and a flag for a default; then how many characters are shared with the name before, and how many follow, less one.
            out += bytes((number | (0x10 if has_default else 0), common | (len(tail) - 1) << 4)) + tail
            for item in (value, default) if has_default else (value,):
                out += struct.pack(f"<{form}", item if form == "f" else int(item))
            before = name
        return bytes(out)


class Request(Struct, frozen=True):
    """The payload of FILE_TRANSFER_PROTOCOL.

    Attributes:
        seq: number of the request; its answer has the next.
        session: number of an open file.
        opcode: what to do.
        size: length of `data`, or how much is wanted.
        offset: bytes in a file, or entries in a listing.
        data: name or content.
    """

    seq: int
    session: int
    opcode: int
    size: int
    offset: int
    data: bytes


def parse(payload: bytes) -> Request:
    """Return the request in a payload of any length. Missing bytes are zero."""
    seq, session, opcode, size, _, _, offset = _HEAD.unpack(payload[: _HEAD.size].ljust(_HEAD.size, b"\0"))
    return Request(seq, session, opcode, size, offset, payload[_HEAD.size :].ljust(DATA, b"\0")[: min(size, DATA)])


class Files:
    """Serves files.

    Args:
        sources: content by name, built each time that the file is opened. Called with the part of the name after its `?`.
    """

    def __init__(self, sources: Mapping[str, Callable[[str], bytes]]) -> None:
        self._sources = sources
        self._open: dict[tuple[int, int, int], bytes] = {}

    def answer(self, owner: tuple[int, int], request: Request) -> Iterator[bytes]:
        """Yield the payloads that answer a request: one, or several for a burst.

        Args:
            owner: system and component that asks; it owns its sessions.
            request: the request.
        """
        if request.opcode == OPEN:
            yield self._opened(owner, request)
        elif request.opcode in (READ, BURST):
            yield from self._read(owner, request)
        elif request.opcode == TERMINATE:
            self._open.pop((*owner, request.session), None)
            yield _reply(request, ACK)
        elif request.opcode == RESET:
            for key in [key for key in self._open if key[:2] == owner]:
                del self._open[key]
            yield _reply(request, ACK)
        elif request.opcode == CRC:
            content = self._content(request)
            if content is None:
                yield _refusal(request, NOT_FOUND)
            else:
                # The checksum of MAVLink FTP is CRC-32 without the inversions of zlib.
                crc = zlib.crc32(content, 0xFFFF_FFFF) ^ 0xFFFF_FFFF
                yield _reply(request, ACK, struct.pack("<I", crc))
        elif request.opcode == LIST:
            yield _refusal(request, END if request.offset else NOT_FOUND)
        else:
            yield _refusal(request, UNKNOWN_COMMAND)

    def _content(self, request: Request) -> bytes | None:
        name, _, options = request.data.split(b"\0", 1)[0].decode("latin-1").partition("?")
        source = self._sources.get(name)
        return None if source is None else source(options)

    def _opened(self, owner: tuple[int, int], request: Request) -> bytes:
        content = self._content(request)
        if content is None:
            return _refusal(request, NOT_FOUND)
        # The client chooses the number, as in ArduPilot. Some clients expect their own number, and others use the one in the answer.
        key = (*owner, request.session)
        if key not in self._open and len(self._open) >= SESSIONS:
            return _refusal(request, NO_SESSIONS)
        self._open[key] = content
        return _reply(request, ACK, struct.pack("<I", len(content)))

    def _read(self, owner: tuple[int, int], request: Request) -> Iterator[bytes]:
        content = self._open.get((*owner, request.session))
        if content is None:
            yield _refusal(request, INVALID_SESSION)
            return
        if request.offset >= len(content):
            yield _refusal(request, END)
            return
        size = min(request.size or DATA, DATA)
        if request.opcode == READ:
            yield _reply(request, ACK, content[request.offset : request.offset + size])
            return
        offset, seq = request.offset, request.seq
        for part in range(BURST_PARTS):
            data = content[offset : offset + size]
            is_last = part == BURST_PARTS - 1 or offset + len(data) >= len(content)
            answer = Request(seq, request.session, request.opcode, 0, offset, b"")
            yield _reply(answer, ACK, data, is_last)
            offset, seq = offset + len(data), seq + 1
            if is_last:
                return


def message(payload: bytes, peer: tuple[int, int]) -> Outgoing:
    """Return FILE_TRANSFER_PROTOCOL for a peer."""
    return "FILE_TRANSFER_PROTOCOL", {**addressed_to(peer), "payload": tuple(payload)}


def _reply(request: Request, opcode: int, data: bytes = b"", is_last: bool = False) -> bytes:
    seq = (request.seq + 1) & 0xFFFF
    return _HEAD.pack(seq, request.session, opcode, len(data), request.opcode, is_last, request.offset) + data


def _refusal(request: Request, reason: int) -> bytes:
    return _reply(request, NAK, bytes((reason,)))
