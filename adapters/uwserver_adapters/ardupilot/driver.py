"""The lock-step with an autopilot: each new servo frame is a tick, and the answer is the state after it. Runs on the simulation thread."""

from __future__ import annotations

import logging
import select
import socket
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

from uwserver.adapter import AdapterStats, Order, Reading, Refusals, address_text
from uwserver.frames import Quat, Vec3, rotate
from uwserver.ports import Fault, Sample
from uwserver_adapters.ardupilot import wire
from uwserver_adapters.ardupilot.wire import Bad, Frame
from uwserver_adapters.sil.in_the_loop import Outputs, Scale, inertial

log = logging.getLogger(__name__)

DATAGRAM = 2048
"""Longest datagram that is read, bytes. A longer one is cut, so its length is wrong."""
AT_ONCE = 256
"""Datagrams that are read in a row."""
QUIET_S = 0.5
"""After this wall time without reading the socket, repeated frames may be waiting: an autopilot repeats a frame after 1 s."""
GONE_S = 1.0
"""After this wall time without a frame, one with number 0 from another address is the same autopilot, started again. While an autopilot is
answered, its next frame comes within milliseconds; unanswered, it repeats its frame once per second."""
NO_ECHO_M = 1000.0
"""Distance for a rangefinder without an echo, which is out of any range. If its key were left out, the last distance would remain valid."""
RATE_FRAMES = 400
"""Frames in a row that request the same wrong rate before it is reported. After a start with `--rate` the requested rate approaches its goal
by 1 Hz per frame, which is not reported."""

COUNTS = ("frames", "duplicates", "lost", "restarts", "strangers", "bad_magic", "bad_length", "limited")
"""Keys of the adapter's details that are counters."""

Address = Any
Datagram = tuple[Frame | Bad, Address]


class State(NamedTuple):
    """The readings that a line of state holds.

    Attributes:
        pose: p_NB and q_NB.
        velocity: v_NB_B and w_NB_B.
        imu: w_S and f_S.
        distances: distances of rangefinders.
        battery: voltage and current.
        no_time_sync: whether the autopilot leaves the pace to us.
    """

    pose: Reading
    velocity: Reading
    imu: Reading
    distances: Sequence[Reading]
    battery: Reading | None
    no_time_sync: bool

    def line(self, t_ns: int) -> bytes | None:
        """Return the current line; None before the first samples of pose and velocity."""
        pose: Any = self.pose.values
        velocity: Any = self.velocity.values
        if pose is None or velocity is None:
            return None
        p_NB: Vec3 = pose[0]
        q_NB: Quat = pose[1]
        v_NB_B, w_NB_B = velocity
        w_B, f_B = inertial(self.imu.values, q_NB, w_NB_B)
        far = (NO_ECHO_M,)
        distances = [float((reading.values or far)[0]) for reading in self.distances]  # type: ignore[arg-type]  # finite
        battery: Any = None if self.battery is None else self.battery.values
        rest = wire.extras(distances, battery, self.no_time_sync)
        return wire.line(t_ns, w_B, f_B, p_NB, q_NB, rotate(q_NB, v_NB_B), rest)


class ArduPilotDriver:
    """The adapter's `Driver`. Runs on the simulation thread, except for its construction.

    Args:
        endpoint: bound non-blocking UDP socket; the caller closes it.
        outputs: what the servo channels move.
        scale: deflections of pulse widths.
        state: what is answered.
        see: takes time and samples of a tick.
        physics_hz: tick rate.
        silence_s: wall time after which a silent autopilot counts as gone.
        steady: returns wall time, s.
        stats: the adapter's statistics, with `COUNTS` and `frame_rate_hz` in its details.
        tell_conflict: tells all clients of a second autopilot.

    Attributes:
        subscriptions: ports that `see` reads; None for all.
    """

    def __init__(
        self, endpoint: socket.socket, outputs: Outputs, scale: Scale, state: State,
        see: Callable[[int, Sequence[Sample]], None], physics_hz: float, silence_s: float, steady: Callable[[], float],
        stats: AdapterStats, tell_conflict: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._endpoint = endpoint
        self._outputs = outputs
        self._scale = scale
        self._state = state
        self._see = see
        self._physics_hz = physics_hz
        self._silence_s = silence_s
        self._steady = steady
        self._stats = stats
        self._tell_conflict = tell_conflict
        self._refusals = Refusals("ardupilot_json", stats, steady)
        self._counts: dict[str, Any] = stats.details
        self._poll = select.poll()
        self._poll.register(endpoint, select.POLLIN)
        self._waiting: Datagram | None = None
        self._read_at = 0.0
        self._peer: Address = None
        self._heard_at = 0.0
        self._last_number = -1
        self._reply: bytes | None = None
        self._odd_frames = 0
        self.subscriptions: Collection[str] | None = None

    # -- uwserver.adapter.Driver ----------------------------------------------------------------------------------------------------

    def order(self, wait_s: float) -> Order | None:
        """Return an order for the next new frame. Older ones are answered or counted on the way."""
        now = self._steady()
        if now - self._read_at > QUIET_S:
            self._heard_at += now - self._read_at  # nobody read the socket, so this was no silence of the autopilot
            self._skip_old()
        end = now + wait_s
        for _ in range(AT_ONCE):
            datagram = self._next(end - now)
            now = self._read_at = self._steady()
            if datagram is None:
                break
            frame, address = datagram
            if isinstance(frame, str):
                self._counts[frame] += 1
                self._stats.errors += 1
            elif self._is_new(frame, address, now):
                return Order(1, self._commands(frame))
        if self._stats.peers and now - self._heard_at > self._silence_s:
            self._stats.peers = 0
            log.warning("the autopilot has sent nothing for %g s; the world waits for it", self._silence_s)
        return None

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        """Keep the samples for the next line."""
        self._see(t_ns, samples)

    def answer(self, t_ns: int) -> None:
        """Send the state after the tick."""
        # After a pause the frame of this tick may have been repeated. This answer is for the repetitions too.
        if self._steady() - self._read_at > QUIET_S:
            self._skip_old()
            waiting = self._waiting
            if waiting is not None and isinstance(waiting[0], Frame) and waiting[0].number == self._last_number:
                self._counts["duplicates"] += 1
                self._waiting = None
        self._reply = self._state.line(t_ns)
        self._send()

    def refuse(self, fault: Fault) -> None:
        """Note a refused command. Channels are within the actuators' limits, so the actuator has been removed or switched off."""
        self._stats.count_error(fault.text)

    # -- datagrams ------------------------------------------------------------------------------------------------------------------

    def _next(self, wait_s: float) -> Datagram | None:
        if self._waiting is not None:
            datagram, self._waiting = self._waiting, None
            return datagram
        if not self._poll.poll(max(0.0, wait_s) * 1e3):
            return None
        return self._received()

    def _received(self) -> Datagram | None:
        try:
            data, address = self._endpoint.recvfrom(DATAGRAM)
        except OSError:  # nothing is there, or the network reports an error of an earlier datagram
            return None
        return wire.parse(data), address

    def _skip_old(self) -> None:
        """Keep only the newest frame that waits in the socket: an autopilot without an answer repeats the same frame."""
        for _ in range(AT_ONCE):
            datagram = self._received()
            if datagram is None:
                return
            if isinstance(datagram[0], str):
                self._counts[datagram[0]] += 1
                self._stats.errors += 1
            else:
                held = self._waiting
                self._counts["duplicates"] += held is not None
                # A frame of another sender never replaces one of the autopilot in charge.
                if held is None or held[1] != self._peer or datagram[1] == self._peer:
                    self._waiting = datagram

    def _send(self) -> None:
        if self._reply is None:
            return
        try:
            self._stats.bytes_sent += self._endpoint.sendto(self._reply, self._peer)
        except OSError as error:
            self._stats.count_error(f"cannot answer {self._peer}: {error}")

    # -- frames ---------------------------------------------------------------------------------------------------------------------

    def _is_new(self, frame: Frame, address: Address, now: float) -> bool:
        if address != self._peer and not self._admits(frame, address, now):
            return False
        self._heard_at = now
        self._stats.peers = 1
        if frame.number == self._last_number:
            self._counts["duplicates"] += 1
            self._send()
            return False
        if frame.number < self._last_number:
            self._counts["restarts"] += 1
            log.info("the autopilot has restarted; the world goes on")
        elif self._last_number >= 0:
            self._counts["lost"] += frame.number - self._last_number - 1
        self._last_number = frame.number
        self._counts["frames"] += 1
        self._compare(frame.rate_hz)
        return True

    def _admits(self, frame: Frame, address: Address, now: float) -> bool:
        """Return whether another sender replaces the last one. That one must have been quiet, less long for a sender that begins at 0."""
        quiet_s = min(GONE_S, self._silence_s) if frame.number == 0 else self._silence_s
        if self._peer is not None and now - self._heard_at < quiet_s:
            self._counts["strangers"] += 1
            text = (
                f"two autopilots send here: {_text(address)} is not answered while {_text(self._peer)} flies the vehicle; "
                "give each an adapter with a port of its own"
            )
            if self._refusals.note_error("second autopilot", text):
                self._tell_conflict(text)
            return False
        if self._peer is not None:
            log.warning(
                "the autopilot at %s is quiet; the one at %s takes over the vehicle", _text(self._peer), _text(address)
            )
        log.info("an autopilot is at %s", _text(address))
        self._counts["restarts"] += self._peer is not None
        self._last_number = -1
        self._peer = address
        return True

    def _compare(self, rate_hz: int) -> None:
        stays = rate_hz == self._counts["frame_rate_hz"]
        self._counts["frame_rate_hz"] = rate_hz
        self._odd_frames = self._odd_frames + 1 if stays and rate_hz != self._physics_hz else 0
        if self._odd_frames == RATE_FRAMES:
            text = f"the autopilot requests {rate_hz} frames/s, but the physics has {self._physics_hz:g} ticks/s"
            self._stats.last_error = f"{text}: start it with --rate {self._physics_hz:g}, or set [world] rate_hz"
            log.warning("%s", self._stats.last_error)

    def _commands(self, frame: Frame) -> list[tuple[str, dict[str, object]]]:
        levels = list(map(self._scale.__getitem__, frame.pwm))
        outside = self._scale.outside
        if not outside.isdisjoint(frame.pwm):
            self._counts["limited"] += any(
                pwm in outside for pwm in map(frame.pwm.__getitem__, self._outputs.channels(len(frame.pwm)))
            )
        self._stats.commands += 1
        return self._outputs.commands(levels)


def _text(address: Address) -> str:
    return address_text(*address[:2])
