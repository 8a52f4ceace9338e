"""The autopilot's side of ArduPilot's JSON simulator interface, for tests and benchmarks. It reads exactly as ArduPilot does.

ArduPilot searches the text for the first occurrence of each name, skips a fixed number of characters behind it, and reads numbers there. So a blank
behind a colon, a name within an earlier name, or "true" for a number fail here as they fail there.
"""

from __future__ import annotations

import math
import re
import socket
import struct
from collections.abc import Sequence

MAGIC = {16: 18458, 32: 29569}

_NUMBER = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|nan|inf)"
_SCALAR = re.compile(rf"\s*({_NUMBER})", re.IGNORECASE)

# Section, name, number of numbers, and whether a line without the name is discarded; in the order of ArduPilot's table.
KEYS: tuple[tuple[str, str, int, bool], ...] = (
    ("", "timestamp", 1, True),
    ("imu", "gyro", 3, True),
    ("imu", "accel_body", 3, True),
    ("", "position", 3, True),
    ("", "attitude", 3, False),
    ("", "quaternion", 4, False),
    ("", "velocity", 3, True),
    *(("", f"rng_{n}", 1, False) for n in range(1, 7)),
    ("windvane", "direction", 1, False),
    ("windvane", "speed", 1, False),
    ("", "airspeed", 1, False),
    ("", "no_time_sync", 1, False),
    ("battery", "voltage", 1, False),
    ("battery", "current", 1, False),
)


class Misread(Exception):
    """The autopilot would not accept this line, or would read something else in it; the text says what."""


def read(buffer: bytes) -> dict[str, tuple[float, ...]]:
    """Return what the autopilot reads in the received text: it uses the part between the last two newlines.

    Raises:
        Misread: it accepts nothing, stops before the end, or reads a number that makes its filters fail.
    """
    pieces = buffer.split(b"\n")
    if len(pieces) < 3 or pieces[-1]:
        raise Misread(f"no text between two newlines at its end: {buffer!r}")
    text = pieces[-2].decode("ascii")
    found: dict[str, tuple[float, ...]] = {}
    for section, name, count, required in KEYS:
        numbers = _find(text, section, name, count)
        if numbers is None and required:
            raise Misread(f"failed to find {section}/{name}: {text}")
        if numbers is not None:
            found[f"{section}/{name}".lstrip("/")] = numbers
    if "attitude" not in found and "quaternion" not in found:
        raise Misread(f"neither attitude nor quaternion: {text}")
    return found


def _find(text: str, section: str, name: str, count: int) -> tuple[float, ...] | None:
    start = text.find(section)
    if start < 0:
        return None
    at = text.find(name, start + len(section) + 1)
    if at < 0:
        return None
    rest = text[at + len(name) + 2 :]
    pattern = _SCALAR if count == 1 else re.compile(r"\[" + r",\s*".join([rf"\s*({_NUMBER})"] * count), re.IGNORECASE)
    match = pattern.match(rest)
    if match is None:
        raise Misread(f"failed to parse {section}/{name} at {rest[:40]!r}")
    numbers = tuple(map(float, match.groups()))
    if not all(map(math.isfinite, numbers)):
        raise Misread(f"{section}/{name} is not finite: {rest[:40]!r}")
    return numbers


def servo_packet(
    number: int, pwm: Sequence[int], rate_hz: int = 1200, channels: int = 16, magic: int | None = None
) -> bytes:
    """Return frame `number` with these pulse widths (us); further outputs are not driven."""
    padded = [*pwm, *[0] * (channels - len(pwm))]
    chosen = MAGIC[channels] if magic is None else magic
    return struct.pack(f"<HHI{channels}H", chosen, rate_hz, number, *padded)


class ArduPilotPeer:
    """An autopilot without control loops. It sends frames, and follows the time of the answers as a real one does.

    Attributes:
        number: number of the next frame.
        rate_hz: physics rate that its frames ask for.
        time_s: its own clock.
        skipped: number of answers that did not advance its clock.
        resets: number of answers with a time before that of the previous one.
    """

    def __init__(self, host: str, port: int, channels: int = 16, rate_hz: int = 1200) -> None:
        self.number = 0
        self.time_s = 0.0
        self.skipped = 0
        self.resets = 0
        self._last_s = 0.0
        self._channels = channels
        self.rate_hz = rate_hz
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((host, port))

    def send(self, pwm: Sequence[int], number: int | None = None) -> None:
        """Send a frame; default: the next one."""
        chosen = self.number if number is None else number
        self._socket.send(servo_packet(chosen, pwm, self.rate_hz, self._channels))

    def send_raw(self, data: bytes) -> None:
        """Send any bytes."""
        self._socket.send(data)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return an answer as it was received; None if none comes in time."""
        self._socket.settimeout(timeout_s)
        try:
            return self._socket.recv(65_000)
        except (TimeoutError, ConnectionRefusedError):
            return None

    def take(self, answer: bytes) -> dict[str, tuple[float, ...]]:
        """Set the clock by an answer, and return what was read."""
        state = read(answer)
        (stamp,) = state["timestamp"]
        step = stamp - self._last_s
        self.resets += step < 0.0
        if 0.0 < step < 0.1:
            self.time_s += step
        else:
            self.skipped += 1
        self._last_s = stamp
        self.number += 1
        return state

    def exchange(self, pwm: Sequence[int], patience_s: float = 30.0) -> dict[str, tuple[float, ...]]:
        """Send a frame and return its answer. The frame is sent again after each second of wall time without an answer.

        Raises:
            TimeoutError: no answer came.
        """
        for _ in range(max(1, round(patience_s))):
            self.send(pwm)
            answer = self.receive(1.0)
            if answer is not None:
                return self.take(answer)
        raise TimeoutError(f"no answer to frame {self.number} in {patience_s:g} s")

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
