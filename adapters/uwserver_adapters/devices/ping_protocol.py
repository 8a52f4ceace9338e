"""Blue Robotics' ping-protocol. A frame is ``BR``, length, message id, source, destination, payload, and the sum of all bytes."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from uwserver_adapters.devices.device import BinaryReader, Garbage, Reply

HEAD = struct.Struct("<2sHHBB")
CHECK = struct.Struct("<H")
START = b"BR"
PAYLOAD_LIMIT = 1024
"""Longest payload of a command, bytes. The longest that the protocol knows has some 20; a longer one is reported as garbage."""

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
    """Return the bytes of a message."""
    head = HEAD.pack(START, len(frame.payload), frame.message_id, frame.source, frame.destination)
    return head + frame.payload + CHECK.pack(sum(head + frame.payload) & 0xFFFF)


class FrameReader(BinaryReader[Frame]):
    """Splits a stream into frames."""

    mark, noun = START, "frame of the ping-protocol"

    def may_skip(self, data: bytes) -> bool:
        """A client wakes the line with one "U" or more before it speaks."""
        return not data.strip(b"U\r\n\x00")

    def parse(self, buffer: bytearray) -> tuple[int, Frame | Garbage | None]:
        """Read the frame at the start of the buffer."""
        if len(buffer) < HEAD.size:
            return 0, None
        _, size, message_id, source, destination = HEAD.unpack_from(buffer)
        end = HEAD.size + size
        if size > PAYLOAD_LIMIT:
            return 1, Garbage(f"a frame claims {size} bytes, at most {PAYLOAD_LIMIT} are read")
        if len(buffer) < end + CHECK.size:
            return 0, None
        if CHECK.unpack_from(buffer, end)[0] != sum(buffer[:end]) & 0xFFFF:
            return 1, Garbage("the checksum of a frame is wrong")
        return end + CHECK.size, Frame(message_id, bytes(buffer[HEAD.size : end]), source, destination)


class PingDevice:
    """A device of the ping-protocol: it tells values, and acknowledges or refuses settings.

    Args:
        device_id: its address on the line until a client sets another.

    Attributes:
        model: name of the device, for refusals.
        forms: message id -> layout of the payload, of all messages that the device takes.
        id_setting: the device's own message for setting its id, beside the common one.
        values: message id -> makes the payload of a value that clients can ask for.
    """

    model: str
    forms: ClassVar[Mapping[int, str]]
    id_setting: int

    def __init__(self, device_id: int) -> None:
        self.device_id = device_id
        self.values: Mapping[int, Callable[[], bytes]] = {}

    def reader(self) -> FrameReader:
        """Return a reader of frames."""
        return FrameReader()

    def take(self, message: Frame, reply: Reply) -> str:
        """Answer a request or a setting: by the value, an acknowledgement or a refusal."""
        number = message.message_id
        if message.destination not in (0, self.device_id, BROADCAST):
            return ""  # for another device on the line
        if not message.payload and number in self.values:
            reply(self.value(number))
            return ""
        form = self.forms.get(number)
        if form is None or len(message.payload) != struct.calcsize(form):
            text = f"this simulated {self.model} does not know the message, or not of this length"
            return self.refuse(number, text, reply)
        values = struct.unpack(form, message.payload)
        if number == GENERAL_REQUEST:
            if values[0] not in self.values:
                return self.refuse(values[0], f"this simulated {self.model} cannot say that", reply)
            reply(self.value(values[0]))
            return ""
        reason: str | None = ""
        if number not in (self.id_setting, SET_DEVICE_ID):
            reason = self.obey(number, values, reply)
        elif 1 <= values[0] <= 254:
            self.device_id = values[0]
        else:
            reason = "the id is 1 to 254"
        if reason:
            return self.refuse(number, reason, reply)
        if reason is not None:
            self.acknowledge(number, reply)
        return ""

    def obey(self, number: int, values: tuple[int, ...], reply: Reply) -> str | None:
        """Carry out a setting or command.

        Returns:
            "" to acknowledge it now, the reason to refuse it, or None where the answer is sent later (or was sent already).
        """
        raise NotImplementedError

    def value(self, number: int) -> bytes:
        """Return the message that tells a value."""
        return encode(Frame(number, self.values[number](), self.device_id))

    def acknowledge(self, number: int, reply: Reply) -> None:
        """Send ACK of a message."""
        reply(encode(Frame(ACK, struct.pack("<H", number), self.device_id)))

    def refuse(self, number: int, reason: str, reply: Reply) -> str:
        """Send NACK of a message, with its reason. Returns the reason for the log."""
        reply(encode(Frame(NACK, struct.pack("<H", number) + reason.encode()[:200] + b"\0", self.device_id)))
        return f"message {number}: {reason}"
