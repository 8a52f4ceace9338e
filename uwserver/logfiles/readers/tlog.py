"""Reads MAVLink telemetry logs (.tlog): frames of any number of systems, each after a time stamp (UTC, µs, big-endian).

This module finds and checks the frames; the fields, units and byte layouts come from pymavlink's message classes. That is ten times faster than
making a pymavlink object of each message, and gives the same values.
"""

from __future__ import annotations

import importlib
import mmap
import re
import struct
from array import array
from binascii import crc_hqx
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.logfiles.log import Limits, LogError, LogField
from uwserver.logfiles.readers.indexed import Decode, Entries, IndexedLog, LogTopic, mapped
from uwserver.logfiles.timebase import time_base

_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_DIALECT = "pymavlink.dialects.v20.ardupilotmega"
_BEGINS = re.compile(b"[\xfd\xfe]")
# The checksum of MAVLink (CRC-16/MCRF4XX) is the mirror image of the CRC that the standard library computes in C.
_MIRROR = bytes(int(f"{k:08b}"[::-1], 2) for k in range(256))
_MOST_LOST = 1 << 22
"""A file without a frame in its first bytes, this many, is not a .tlog."""
_LATEST_US = 4_102_444_800_000_000
"""2100-01-01; a later stamp is damaged."""


def open_file(path: Path, limits: Limits) -> IndexedLog:
    """Open the log in a .tlog file.

    Raises:
        LogError: it contains no frame.
    """
    data = mapped(path)
    messages: dict[int, Any] = importlib.import_module(_DIALECT).mavlink_map
    stamps, keys, places, lost, unknown = _scan(data, messages)
    if not stamps:
        data.close()
        raise LogError(f"{path}: no MAVLink frame after a time stamp in {lost} bytes: not a .tlog")
    distinct, numbers = np.unique(np.frombuffer(keys, np.int64), return_inverse=True)
    if len(distinct) > limits.topics:
        raise LogError(f"{path}: {len(distinct)} kinds of messages, more than {limits.topics}")
    sources = [_source(int(key), messages[int(key) & 0xFFFFFF], data) for key in distinct]
    remarks = []
    if lost:
        remarks.append(f"{lost} of {len(data)} bytes are no frame, or a damaged one, and were skipped")
    if unknown:
        most = ", ".join(str(number) for number, _ in unknown.most_common(5))
        remarks.append(f"{unknown.total()} frames were skipped: their message numbers are in no known dialect ({most})")
    base = time_base(np.frombuffer(stamps, np.int64) * 1000, utc=True)
    entries = Entries(numbers.astype(np.int32), np.frombuffer(places, np.int64))
    return IndexedLog(path, "tlog", sources, entries, base, remarks=remarks, close=data.close)


def _scan(data: mmap.mmap, messages: dict[int, Any]) -> tuple[array[int], array[int], array[int], int, Counter[int]]:
    """Find all frames.

    Returns:
        Stamps (µs), keys (system, component and message in one number) and places of the stamps of the frames; the number of bytes that belong to
        no frame; and the counts of unknown messages.
    """
    stamps, keys, places = array("q"), array("q"), array("q")
    unknown: Counter[int] = Counter()
    extras = {number: message.crc_extra for number, message in messages.items()}
    end, at, lost = len(data), 0, 0
    stamp_of = struct.Struct(">Q").unpack_from
    begins = _BEGINS.search
    mirror, crc_of, extra_byte = _MIRROR, crc_hqx, [bytes((k,)) for k in range(256)]
    while at + 16 <= end:
        magic = data[at + 8]
        length = 0
        if magic == _V2:
            length = 12 + data[at + 9] + (_SIGNATURE_BYTES if data[at + 10] & _SIGNED else 0)
        elif magic == _V1:
            length = 8 + data[at + 9]
        stamp, after = stamp_of(data, at)[0], at + 8 + length
        if length and after <= end and stamp < _LATEST_US:
            frame = data[at + 8 : after]
            if magic == _V2:
                number, sender, body = (
                    frame[7] | frame[8] << 8 | frame[9] << 16,
                    frame[5] << 8 | frame[6],
                    10 + frame[1],
                )
            else:
                number, sender, body = frame[5], frame[3] << 8 | frame[4], length - 2
            extra = extras.get(number)
            if extra is None:
                # Its checksum cannot be computed. It counts as a frame if another frame, or the end of the file, follows immediately.
                if after == end or (after + 8 < end and data[after + 8] in (_V1, _V2)):
                    unknown[number] += 1
                    at = after
                    continue
            else:
                crc = crc_of((frame[1:body] + extra_byte[extra]).translate(mirror), 0xFFFF)
                if mirror[crc >> 8] == frame[body] and mirror[crc & 0xFF] == frame[body + 1]:
                    stamps.append(stamp)
                    keys.append(sender << 24 | number)
                    places.append(at)
                    at = after
                    continue
        # Continue at the next byte that may begin a frame.
        magic_at = begins(data, at + 9)
        after = magic_at.start() - 8 if magic_at else end
        lost += after - at
        at = after
        if lost > _MOST_LOST and not stamps:
            break
    return stamps, keys, places, lost + end - at, unknown


def _source(key: int, message: Any, data: mmap.mmap) -> LogTopic:
    units = message.fieldunits_by_name
    fields = []
    for name, type_, k in zip(message.fieldnames, message.fieldtypes, message.orders, strict=True):
        length = message.array_lengths[k]
        fields.append(LogField(name, f"{type_}[{length}]" if length else type_, units.get(name, "").strip("[]")))
    name = f"{key >> 32}/{key >> 24 & 0xFF}/{message.msgname}"
    return LogTopic(name, message.msgname, tuple(fields), _decoder(message, data))


def _decoder(message: Any, data: mmap.mmap) -> Decode:
    """Return the decoder of a message. Bytes that the sender left out at the end are zero, as MAVLink 2 defines."""
    names, unpack, size = message.ordered_fieldnames, message.unpacker.unpack, message.unpacker.size
    arrays = max(message.array_lengths) > 0

    def decode(at: int) -> Mapping[str, object]:
        begin = at + (18 if data[at + 8] == _V2 else 14)
        payload = data[begin : begin + min(data[at + 9], size)]
        values = unpack(payload.ljust(size, b"\0"))
        return _with_arrays(message, values) if arrays else dict(zip(names, values, strict=True))

    return decode


def _with_arrays(message: Any, values: tuple[Any, ...]) -> dict[str, object]:
    found: dict[str, object] = {}
    k = 0
    for name, length in zip(message.ordered_fieldnames, message.lengths, strict=True):
        value = values[k]
        if isinstance(value, bytes):
            found[name] = value.partition(b"\0")[0].decode(errors="backslashreplace")
        else:
            found[name] = value if length == 1 else list(values[k : k + length])
        k += length
    return found
