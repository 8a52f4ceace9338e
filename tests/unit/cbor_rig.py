"""A decoder of CBOR of the tests' own."""

from __future__ import annotations

import struct

import numpy as np


def uncbor(data, at=0):
    """A decoder of the test's own (RFC 8949); typed arrays become (tag, numbers)."""
    major, info = data[at] >> 5, data[at] & 31
    at += 1
    if major == 7 and info == 27:
        return struct.unpack_from(">d", data, at)[0], at + 8
    if major == 7:
        return {20: False, 21: True, 22: None}[info], at
    width = {24: 1, 25: 2, 26: 4, 27: 8}.get(info, 0)
    number = int.from_bytes(data[at : at + width], "big") if width else info
    at += width
    if major in (0, 1):
        return (number if major == 0 else -1 - number), at
    if major in (2, 3):
        body = data[at : at + number]
        return (bytes(body) if major == 2 else body.decode()), at + number
    if major == 4:
        items = []
        for _ in range(number):
            item, at = uncbor(data, at)
            items.append(item)
        return items, at
    if major == 5:
        made = {}
        for _ in range(number):
            key, at = uncbor(data, at)
            made[key], at = uncbor(data, at)
        return made, at
    body, at = uncbor(data, at)
    if number in (2, 3):
        return (int.from_bytes(body, "big") if number == 2 else -1 - int.from_bytes(body, "big")), at
    kind = {64: "u1", 69: "<u2", 70: "<u4", 72: "i1", 77: "<i2", 78: "<i4", 85: "<f4", 86: "<f8"}[number]
    return (number, np.frombuffer(body, kind).tolist()), at
