"""A camera of MAVLink's camera protocol, version 2: its heartbeats, and the answers that say where its video is. Sans-IO; needs pymavlink."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

FIRST_COMPONENT: Final = 100
"""MAV_COMP_ID_CAMERA. The five component numbers after it are cameras too."""
MOST_CAMERAS: Final = 6
"""Cameras of one vehicle."""
_URI, _NAME, _MODEL = 160, 32, 32
_FRAMES: Final = 8
"""Frames that are decoded from one datagram."""
_MAGIC_1, _MAGIC_2, _SIGNED = 0xFE, 0xFD, 0x01
# Commands that are older than REQUEST_MESSAGE. Each requests one message.
_OLD: Final = {
    mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION: mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION: mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_STATUS: mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS,
}
_STREAMING: Final = (mavlink.MAV_CMD_VIDEO_START_STREAMING, mavlink.MAV_CMD_VIDEO_STOP_STREAMING)


class Facts(NamedTuple):
    """What a camera says of itself.

    Attributes:
        name: name of its stream.
        model: model of the camera.
        uri: a UDP port as text for RTP, or an RTSP address.
        is_rtp: whether `uri` is for RTP.
        is_h264: whether the stream is H.264.
        is_running: whether pictures are sent.
        size: width and height in pixels; 0 while unknown.
        rate_hz: pictures per second.
        bit_rate: most bits per second.
    """

    name: str
    model: str
    uri: str
    is_rtp: bool
    is_h264: bool
    is_running: bool
    size: tuple[int, int]
    rate_hz: float
    bit_rate: int


class Command(NamedTuple):
    """A command that was received.

    Attributes:
        system, component: the addressee; 0 for all.
        sender: system and component that sent it.
        number: number of the command.
        first, second: its first two parameters.
    """

    system: int
    component: int
    sender: tuple[int, int]
    number: int
    first: float
    second: float


class Decoder:
    """Finds commands in datagrams.

    Attributes:
        bad: frames that were not understood.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._mav = mavlink.MAVLink(None, 0, 0)

    def commands(self, datagram: bytes) -> Iterator[Command]:
        """Yield the commands of a datagram, which begins with a frame."""
        at = 0
        for _ in range(_FRAMES):
            size = _size(datagram, at)
            if at >= len(datagram):
                return
            if size == 0:
                self.bad += 1
                return
            command = self._command(datagram[at : at + size])
            at += size
            if command is not None:
                yield command

    def _command(self, frame: bytes) -> Command | None:
        try:
            message: Any = self._mav.decode(bytearray(frame))
        except Exception:  # noqa: BLE001  # pymavlink raises many types; the frame is dropped and counted
            self.bad += 1
            return None
        if message.get_type() not in ("COMMAND_LONG", "COMMAND_INT"):
            return None
        return Command(
            message.target_system, message.target_component, (message.get_srcSystem(), message.get_srcComponent()),
            message.command, message.param1, message.param2,
        )  # fmt: skip


def _size(datagram: bytes, at: int) -> int:
    """Return the length of the frame that begins here, in bytes; 0 where none does."""
    if len(datagram) < at + 8:
        return 0
    if datagram[at] == _MAGIC_1:
        size = 8 + datagram[at + 1]
    elif datagram[at] == _MAGIC_2:
        size = 12 + datagram[at + 1] + (13 if datagram[at + 2] & _SIGNED else 0)
    else:
        return 0
    return size if at + size <= len(datagram) else 0


class Camera:
    """One camera component.

    Args:
        system: system number of its vehicle.
        component: its component number.
    """

    def __init__(self, system: int, component: int) -> None:
        self._id = (system, component)
        self._mav = mavlink.MAVLink(None, system, component)

    def _pack(self, message: Any) -> bytes:
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return bytes(data)

    def heartbeat(self) -> bytes:
        """Return a heartbeat."""
        return self._pack(
            self._mav.heartbeat_encode(
                mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
        )

    def answer(self, command: Command, facts: Facts, time_ms: int) -> list[bytes]:
        """Return the answers to a command; none to a command for others.

        Args:
            command: the command.
            facts: the camera's state now.
            time_ms: time since the start.
        """
        if command.system not in (0, self._id[0]) or command.component not in (0, self._id[1]):
            return []
        if command.number == mavlink.MAV_CMD_REQUEST_MESSAGE:
            wanted = int(command.first) if math.isfinite(command.first) else -1
            stream = command.second
        else:
            wanted, stream = _OLD.get(command.number, -1), command.first
        told = self._told(wanted, stream, facts, time_ms)
        # Starting and stopping is accepted, but changes nothing: pictures are sent to those who take the stream.
        is_taken = told is not None or command.number in _STREAMING
        if not is_taken and command.component == 0:
            return []  # a command to all components is answered only by those that know it
        result = mavlink.MAV_RESULT_ACCEPTED if is_taken else mavlink.MAV_RESULT_UNSUPPORTED
        if told is None and wanted in _OLD.values():
            result = mavlink.MAV_RESULT_DENIED
        ack = self._mav.command_ack_encode(command.number, result, 0, 0, *command.sender)
        return [self._pack(ack), *([] if told is None else [self._pack(told)])]

    def _told(self, wanted: int, stream: float, facts: Facts, time_ms: int) -> Any:
        if wanted == mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION:
            return self._information(facts, time_ms)
        if stream not in (0.0, 1.0):
            return None
        if wanted == mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION:
            return self._stream_information(facts)
        if wanted == mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS:
            return self._mav.video_stream_status_encode(
                1, _flags(facts), facts.rate_hz, *facts.size, facts.bit_rate, 0, 0
            )
        return None

    def _information(self, facts: Facts, time_ms: int) -> Any:
        return self._mav.camera_information_encode(
            time_ms & 0xFFFF_FFFF, _row("uwserver"), _row(facts.model), 0,
            math.nan, math.nan, math.nan, *facts.size, 0, mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM, 0, b"",
        )  # fmt: skip

    def _stream_information(self, facts: Facts) -> Any:
        kind = mavlink.VIDEO_STREAM_TYPE_RTPUDP if facts.is_rtp else mavlink.VIDEO_STREAM_TYPE_RTSP
        encoding = mavlink.VIDEO_STREAM_ENCODING_H264 if facts.is_h264 else mavlink.VIDEO_STREAM_ENCODING_UNKNOWN
        return self._mav.video_stream_information_encode(
            1, 1, kind, _flags(facts), facts.rate_hz, *facts.size, facts.bit_rate, 0, 0,
            facts.name.encode("ascii", "replace")[: _NAME - 1], facts.uri.encode("ascii", "replace")[: _URI - 1], encoding,
        )  # fmt: skip


def _flags(facts: Facts) -> int:
    return int(mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING) if facts.is_running else 0


def _row(text: str) -> list[int]:
    return list(text.encode("ascii", "replace")[: _MODEL - 1].ljust(_MODEL, b"\0"))
