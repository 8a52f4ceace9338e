"""One conversation: a connection, a serial line, or one peer of a UDP socket, and which message it gets how often.

Sans-IO: the owner passes in how to write bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence

from uwserver.adapter import RateMeter
from uwserver_adapters.mavlink.wire.codec import nanoseconds
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields
from uwserver_adapters.mavlink.wire.frames import Decoder

POSITION = 6
"""Number of the group with the position messages."""
GROUPS: Mapping[int, tuple[str, tuple[str, ...]]] = {
    1: ("RAW_SENS", ("RAW_IMU", "SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3")),
    2: (
        "EXT_STAT",
        ("SYS_STATUS", "POWER_STATUS", "MEMINFO", "MISSION_CURRENT", "GPS_RAW_INT", "NAV_CONTROLLER_OUTPUT", "NAMED_VALUE_FLOAT"),
    ),
    3: ("RC_CHAN", ("SERVO_OUTPUT_RAW", "RC_CHANNELS")),
    POSITION: ("POSITION", ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")),
    10: ("EXTRA1", ("ATTITUDE", "AHRS2")),
    11: ("EXTRA2", ("VFR_HUD",)),
    12: ("EXTRA3", ("SYSTEM_TIME", "RANGEFINDER", "DISTANCE_SENSOR", "BATTERY_STATUS", "EKF_STATUS_REPORT", "VIBRATION",
                     "GIMBAL_DEVICE_ATTITUDE_STATUS")),
}  # fmt: skip
"""Group number -> suffix of its parameter's name, and its messages."""
FASTEST_S = 0.01
"""Shortest interval, s."""
BACKLOG = 16
"""Downloads (parameters, files) that may be in progress on a channel. A new one ends the oldest."""


class Streams:
    """The schedule of one channel, in simulation time.

    All streams of one rate are due at the same times, no matter when they were requested, so that each message is built once for all channels.

    Args:
        rates_hz: rate of each group, by group number.
    """

    def __init__(self, rates_hz: Mapping[int, float]) -> None:
        self._groups = dict(rates_hz)
        self._overrides: dict[str, int] = {}
        self._due: dict[str, int] = {}
        self._interval: dict[str, int] = {}
        self._next_ns = 0
        self._rebuild()

    def _rebuild(self) -> None:
        intervals: dict[str, int] = {}
        for group, (_, names) in GROUPS.items():
            rate = self._groups.get(group, 0.0)
            if rate > 0.0:
                interval = nanoseconds(max(1.0 / rate, FASTEST_S))
                intervals.update(dict.fromkeys(names, interval))
        intervals.update(self._overrides)
        self._interval = {name: interval for name, interval in intervals.items() if interval > 0}
        self._due = {name: self._due.get(name, 0) for name in self._interval}
        self._next_ns = 0

    def set_group(self, group: int, rate_hz: float) -> bool:
        """Set the rate of a group, or of all groups with 0. Intervals of its single messages end. Returns False when there is no such group."""
        chosen = list(GROUPS) if group == 0 else [group]
        if not all(number in GROUPS for number in chosen):
            return False
        for number in chosen:
            self._groups[number] = rate_hz
            for name in GROUPS[number][1]:
                self._overrides.pop(name, None)
        self._rebuild()
        return True

    def set_interval(self, name: str, interval_s: float | None) -> None:
        """Set the interval of one message: zero or less stops it, None returns to the rate of its group."""
        if interval_s is None:
            self._overrides.pop(name, None)
        else:
            self._overrides[name] = nanoseconds(max(interval_s, FASTEST_S)) if interval_s > 0.0 else 0
        self._rebuild()

    def interval_ns(self, name: str) -> int:
        """Return the interval of a message; 0 when it is not sent."""
        return self._interval.get(name, 0)

    def due(self, t_ns: int) -> Sequence[str]:
        """Return the messages that are due at `t_ns`, and schedule them anew."""
        if t_ns < self._next_ns:
            return ()
        names = []
        for name, interval in self._interval.items():
            if t_ns >= self._due[name]:
                self._due[name] = (t_ns // interval + 1) * interval
                names.append(name)
        self._next_ns = min(self._due.values(), default=t_ns + nanoseconds(1.0))
        return names

    def restart(self) -> None:
        """Make everything due at once: simulation time has begun again."""
        self._due = dict.fromkeys(self._due, 0)
        self._next_ns = 0


Outgoing = tuple[str, Fields]
"""A message to send: its name and fields."""


class Channel:
    """The state of one conversation.

    Args:
        number: number of the channel, which no later channel uses again.
        name: the channel as a user would type it.
        dialect: the messages, for the decoder.
        write: sends bytes; returns False when the peer does not keep up.
        is_ready: returns whether a download may send more now.
        streams: which telemetry it gets how often.
        frames_per_s: most frames that are accepted per second.

    Attributes:
        seq: sequence number of the next frame.
        backlog: downloads in progress, of which a few messages are sent at a time.
        heard_at: loop time of the last good frame, s.
        is_heard: a good frame has been received.
        has_peer: a peer has spoken, or is known to be there.
        allowance: download messages that may be sent before the next tick.
        meter: limits the frames that are accepted.
    """

    def __init__(
        self,
        number: int,
        name: str,
        dialect: Dialect,
        write: Callable[[bytes], bool],
        is_ready: Callable[[], bool],
        streams: Streams,
        frames_per_s: int,
    ) -> None:
        self.number = number
        self.name = name
        self.decoder = Decoder(dialect)
        self.write = write
        self.is_ready = is_ready
        self.streams = streams
        self.seq = 0
        self.backlog: deque[Iterator[Outgoing]] = deque(maxlen=BACKLOG)
        self.heard_at = 0.0
        self.is_heard = False
        self.has_peer = False
        self.allowance = 0
        self.meter = RateMeter(frames_per_s)

    def next_seq(self) -> int:
        """Return the sequence number of the frame that is written next."""
        seq = self.seq
        self.seq = (seq + 1) & 0xFF
        return seq
