"""The lock-step with an autopilot: a new servo frame is a tick, and its answer the state after it. Runs on the simulation thread."""

from __future__ import annotations

import logging
import select
import socket
from collections.abc import Callable, Collection, Sequence
from typing import Any

from uwserver.adapter import AdapterStats, Order, Reading, Refusals, address_text
from uwserver.frames import Quat, Vec3, rotate
from uwserver.ports import Fault, Sample
from uwserver_adapters.ardupilot import wire
from uwserver_adapters.ardupilot.wire import Bad, Frame
from uwserver_adapters.sil.channels import Outputs, Scale
from uwserver_adapters.sil.world import inertial

log = logging.getLogger(__name__)

DATAGRAM = 2048
"""Longest datagram that is read, bytes; longer ones are cut, and so of a wrong length."""
AT_ONCE = 256
"""Datagrams that are looked at in a row."""
QUIET_S = 0.5
"""Wall time without a look at the socket after which frames may wait twice: an autopilot repeats one after 1 s."""
GONE_S = 1.0
"""Wall time without a frame after which one that begins at 0 from another address is the same autopilot, started again. While it runs and is
answered it says the next frame within milliseconds; unanswered, the same once a second."""
NO_ECHO_M = 1000.0
"""Distance that stands for a rangefinder without echo: out of any range, where a missing key would leave the last one."""
RATE_FRAMES = 400
"""Frames in a row that ask for the same other rate than the physics has before it is told: a wish that still walks to its goal,
1 Hz a frame after a start with `--rate`, is none."""

COUNTS = ("frames", "duplicates", "lost", "restarts", "strangers", "bad_magic", "bad_length", "limited")
"""Keys of the adapter's details that count."""

Address = Any
Datagram = tuple[Frame | Bad, Address]


class State:
    """What a line holds, as the world told it last.

    Args:
        pose, velocity, imu: p_NB and q_NB; v_NB_B and w_NB_B; w_S and f_S.
        distances: of rangefinders.
        battery: voltage and current.
        no_time_sync: whether the autopilot leaves the pace to us.
    """

    def __init__(
        self, pose: Reading, velocity: Reading, imu: Reading, distances: Sequence[Reading], battery: Reading | None,
        no_time_sync: bool,
    ) -> None:  # fmt: skip
        self._pose = pose
        self._velocity = velocity
        self._imu = imu
        self._distances = distances
        self._battery = battery
        self._no_time_sync = no_time_sync

    def line(self, t_ns: int) -> bytes | None:
        """The line of now; None before the world has said where the vehicle is."""
        pose: Any = self._pose.values
        velocity: Any = self._velocity.values
        if pose is None or velocity is None:
            return None
        p_NB: Vec3 = pose[0]
        q_NB: Quat = pose[1]
        v_NB_B, w_NB_B = velocity
        w_B, f_B = inertial(self._imu.values, q_NB, w_NB_B)
        far = (NO_ECHO_M,)
        distances = [float((reading.values or far)[0]) for reading in self._distances]  # type: ignore[arg-type]  # finite
        battery: Any = None if self._battery is None else self._battery.values
        rest = wire.extras(distances, battery, self._no_time_sync)
        return wire.line(t_ns, w_B, f_B, p_NB, q_NB, rotate(q_NB, v_NB_B), rest)


class ArduPilotDriver:
    """The adapter's `Driver`. Simulation thread, but for its construction.

    Args:
        endpoint: bound UDP socket that does not block; whoever made it closes it.
        outputs: what servo channels move.
        scale: of their pulse widths.
        state: what is answered.
        see: takes time and samples of a tick.
        physics_hz: rate of the ticks.
        silence_s: wall time after which the autopilot is said to be gone.
        steady: wall time, s.
        stats: of the adapter; `COUNTS` and `frame_rate_hz` in its details.
        tell_conflict: tells all clients of a second autopilot.

    Attributes:
        wanted: ports that `see` reads; None for all.
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
        self._looked = 0.0
        self._peer: Address = None
        self._heard = 0.0
        self._last = -1
        self._reply: bytes | None = None
        self._odd_frames = 0
        self.wanted: Collection[str] | None = None

    # -- uwserver.adapter.Driver ----------------------------------------------------------------------------------------------------

    def order(self, wait_s: float) -> Order | None:
        """The next new frame; older ones are answered or counted on the way."""
        now = self._steady()
        if now - self._looked > QUIET_S:
            self._heard += now - self._looked  # nobody listened: that is no silence
            self._skip_old()
        end = now + wait_s
        for _ in range(AT_ONCE):
            datagram = self._next(end - now)
            now = self._looked = self._steady()
            if datagram is None:
                break
            frame, address = datagram
            if isinstance(frame, str):
                self._counts[frame] += 1
                self._stats.errors += 1
            elif self._is_new(frame, address, now):
                return Order(1, self._commands(frame))
        if self._stats.peers and now - self._heard > self._silence_s:
            self._stats.peers = 0
            log.warning("the autopilot has said nothing for %g s; the world waits for it", self._silence_s)
        return None

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        """Keep what a line will hold."""
        self._see(t_ns, samples)

    def answer(self, t_ns: int) -> None:
        """Send the state after the tick."""
        if (
            self._steady() - self._looked > QUIET_S
        ):  # a pause lay between: what was repeated meanwhile is answered with this
            self._skip_old()
            if (
                self._waiting is not None
                and isinstance(self._waiting[0], Frame)
                and self._waiting[0].number == self._last
            ):
                self._counts["duplicates"] += 1
                self._waiting = None
        self._reply = self._state.line(t_ns)
        self._send()

    def refuse(self, fault: Fault) -> None:
        """Channels are limited to what actuators take, so this is an actuator that is gone or was switched off."""
        self._stats.errors += 1
        self._stats.last_error = fault.text

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
        except OSError:  # nothing there, or the network's word on an earlier datagram
            return None
        return wire.parse(data), address

    def _skip_old(self) -> None:
        """Of all that waits in the socket keep the newest frame: an autopilot that was not answered has sent the same again and again."""
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
                if held is None or held[1] != self._peer or datagram[1] == self._peer:
                    self._waiting = datagram

    def _send(self) -> None:
        if self._reply is None:
            return
        try:
            self._stats.bytes_sent += self._endpoint.sendto(self._reply, self._peer)
        except OSError as error:
            self._stats.errors += 1
            self._stats.last_error = f"cannot answer {self._peer}: {error}"

    # -- frames ---------------------------------------------------------------------------------------------------------------------

    def _is_new(self, frame: Frame, address: Address, now: float) -> bool:
        if address != self._peer and not self._admits(frame, address, now):
            return False
        self._heard = now
        self._stats.peers = 1
        if frame.number == self._last:
            self._counts["duplicates"] += 1
            self._send()
            return False
        if frame.number < self._last:
            self._counts["restarts"] += 1
            log.info("the autopilot has restarted; the world goes on")
        elif self._last >= 0:
            self._counts["lost"] += frame.number - self._last - 1
        self._last = frame.number
        self._counts["frames"] += 1
        self._compare(frame.rate_hz)
        return True

    def _admits(self, frame: Frame, address: Address, now: float) -> bool:
        """Whether another sender takes the place of the last, which must have been quiet: less long for one that begins."""
        quiet_s = min(GONE_S, self._silence_s) if frame.number == 0 else self._silence_s
        if self._peer is not None and now - self._heard < quiet_s:
            self._counts["strangers"] += 1
            self._stats.errors += 1
            self._stats.last_error = (
                f"two autopilots send here: {_text(address)} is not answered while {_text(self._peer)} flies the vehicle; "
                "give each an adapter with a port of its own"
            )
            if self._refusals.note("second autopilot", self._stats.last_error):
                self._tell_conflict(self._stats.last_error)
            return False
        if self._peer is not None:
            log.warning(
                "the autopilot at %s is quiet; the one at %s takes the vehicle over", _text(self._peer), _text(address)
            )
        log.info("an autopilot is at %s", _text(address))
        self._counts["restarts"] += self._peer is not None
        self._last = -1
        self._peer = address
        return True

    def _compare(self, rate_hz: int) -> None:
        stays = rate_hz == self._counts["frame_rate_hz"]
        self._counts["frame_rate_hz"] = rate_hz
        self._odd_frames = self._odd_frames + 1 if stays and rate_hz != self._physics_hz else 0
        if self._odd_frames == RATE_FRAMES:
            text = f"the autopilot asks for {rate_hz} frames/s, the physics has {self._physics_hz:g} ticks/s"
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
