"""The frames of Blue Robotics' ping-protocol: ``BR``, length, message id, source, destination, payload, sum of all bytes."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from uwserver_adapters.devices.device import Garbage

HEAD = struct.Struct("<2sHHBB")
CHECK = struct.Struct("<H")
START = b"BR"
PAYLOAD_LIMIT = 1024
"""Longest payload of a command, bytes; the longest that the protocol knows has some 20. Told garbage above."""

ACK, NACK, ASCII_TEXT, DEVICE_INFORMATION, PROTOCOL_VERSION, GENERAL_REQUEST, SET_DEVICE_ID = 1, 2, 3, 4, 5, 6, 100
VERSION = struct.pack("<BBBB", 1, 0, 0, 0)
BROADCAST = 255


@dataclass(frozen=True)
class Frame:
    """One message."""

    message_id: int
    payload: bytes = b""
    source: int = 0
    destination: int = 0


def encode(frame: Frame) -> bytes:
    """The bytes of a message."""
    head = HEAD.pack(START, len(frame.payload), frame.message_id, frame.source, frame.destination)
    return head + frame.payload + CHECK.pack(sum(head + frame.payload) & 0xFFFF)


def acknowledgement(message_id: int, source: int) -> bytes:
    """ACK of a message."""
    return encode(Frame(ACK, struct.pack("<H", message_id), source))


def refusal(message_id: int, reason: str, source: int) -> bytes:
    """NACK of a message, with its text."""
    return encode(Frame(NACK, struct.pack("<H", message_id) + reason.encode()[:200] + b"\0", source))


class FrameReader:
    """Bytes to frames. What is between them is garbage, told once a piece; after a broken frame the next one is looked for from its second
    byte on."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._buffer += data

    def next_event(self) -> Frame | Garbage | None:
        """The next message; None until more bytes come."""
        buffer = self._buffer
        start = buffer.find(START)
        if start < 0:
            start = len(buffer) - buffer.endswith(START[:1])
        if start > 0:
            # A client wakes the line with a "U" (or more) before it speaks: that is no fault.
            is_wake = not buffer[:start].strip(b"U\r\n\x00")
            del buffer[:start]
            if not is_wake:
                return Garbage(f"{start} bytes are no frame of the ping-protocol")
        if len(buffer) < HEAD.size:
            return None
        _, size, message_id, source, destination = HEAD.unpack_from(buffer)
        end = HEAD.size + size
        if size > PAYLOAD_LIMIT:
            del buffer[:1]
            return Garbage(f"a frame claims {size} bytes, at most {PAYLOAD_LIMIT} are read")
        if len(buffer) < end + CHECK.size:
            return None
        if CHECK.unpack_from(buffer, end)[0] != sum(buffer[:end]) & 0xFFFF:
            del buffer[:1]
            return Garbage("the checksum of a frame is wrong")
        payload = bytes(buffer[HEAD.size : end])
        del buffer[: end + CHECK.size]
        return Frame(message_id, payload, source, destination)
