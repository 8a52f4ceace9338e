"""The autopilot's side of ArduPilot's JSON simulator interface, as strict and as naive as its own reader, for tests and benches.

Written after what that reader does: it searches the text for the first place of each name, skips a fixed number of characters behind it,
and scans numbers there. So a blank behind a colon, a name within an earlier name, or "true" for a number go wrong here as they do there.
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

# Section, name, how many numbers, whether a line without it is thrown away: in the order of the reader's table.
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
    """The autopilot would not take this line, or would take something else from it; the text says what."""


def read(buffer: bytes) -> dict[str, tuple[float, ...]]:
    """What the autopilot takes from what it has received: the text between the last two newlines.

    Raises:
        Misread: it takes nothing, stops on the way, or reads a number that ends its filters.
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
    """Frame `number` with these pulse widths (us); outputs beyond them are not driven."""
    padded = [*pwm, *[0] * (channels - len(pwm))]
    chosen = MAGIC[channels] if magic is None else magic
    return struct.pack(f"<HHI{channels}H", chosen, rate_hz, number, *padded)


class ArduPilotPeer:
    """An autopilot without control loops: it sends frames, and follows the time of the answers as a real one does.

    Attributes:
        number: of the next frame.
        rate_hz: physics rate that its frames ask for.
        time_s: its own clock.
        skipped: answers that did not move its clock.
        resets: answers whose time lay before the last one's.
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
        """Send a frame, by default the next."""
        chosen = self.number if number is None else number
        self._socket.send(servo_packet(chosen, pwm, self.rate_hz, self._channels))

    def send_raw(self, data: bytes) -> None:
        """Send anything."""
        self._socket.send(data)

    def receive(self, timeout_s: float) -> bytes | None:
        """An answer as it came; None when none comes in time."""
        self._socket.settimeout(timeout_s)
        try:
            return self._socket.recv(65_000)
        except (TimeoutError, ConnectionRefusedError):
            return None

    def take(self, answer: bytes) -> dict[str, tuple[float, ...]]:
        """Follow an answer; returns what was read."""
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
        """One frame and its answer, sent again each second of wall time as long as none comes.

        Raises:
            TimeoutError: nobody answers.
        """
        for _ in range(max(1, round(patience_s))):
            self.send(pwm)
            answer = self.receive(1.0)
            if answer is not None:
                return self.take(answer)
        raise TimeoutError(f"no answer to frame {self.number} in {patience_s:g} s")

    def close(self) -> None:
        """Go away."""
        self._socket.close()
