"""The lock-step with PX4: an IMU sample goes out, and actuator outputs come back. Runs on the simulation thread."""

from __future__ import annotations

import logging
import select
import socket
from collections.abc import Callable, Collection, Sequence
from typing import Any

from uwserver.adapter import AdapterStats, Order, Refusals
from uwserver.ports import Fault, Sample
from uwserver_adapters.px4 import codec
from uwserver_adapters.px4.door import READ, Connection, Door
from uwserver_adapters.px4.sensor_messages import SensorMessages
from uwserver_adapters.sil.in_the_loop import Outputs

log = logging.getLogger(__name__)

BAD_IN_A_ROW = 100
"""Messages and pieces in a row that were not understood, after which the connection is closed."""
WAITING = 1 << 20
"""Bytes that may be buffered for an autopilot that does not read. Above, the connection is closed."""

COUNTS = ("controls", "late", "missed", "bad", "limited", "connections")
"""Keys of the adapter's details that are counters."""


class Px4Driver:
    """The adapter's `Driver`. Runs on the simulation thread, except for its construction and `close`.

    Args:
        listener: non-blocking listening TCP socket; the caller closes it.
        outputs: what the actuator outputs command.
        sensors: the sensor messages.
        ticks: physics ticks from one IMU sample to the next.
        step_s: the same as time, s. Without lock-step the world runs no faster than real time.
        steady: returns wall time, s.
        stats: the adapter's statistics, with `COUNTS` and `is_locked` in its details.
        tell_conflict: tells all clients of a second autopilot.
    """

    def __init__(
        self, listener: socket.socket, outputs: Outputs, sensors: SensorMessages, ticks: int, step_s: float,
        steady: Callable[[], float], stats: AdapterStats, tell_conflict: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._refusals = Refusals("px4_hil", stats, steady)
        self._door = Door(listener, self._refusals, steady)
        self._tell_conflict = tell_conflict
        self._outputs = outputs
        self._sensors = sensors
        self._ticks = ticks
        self._step_s = step_s
        self._steady = steady
        self._stats = stats
        self._counts: dict[str, Any] = stats.details
        self._link: Connection | None = None
        self._due = 0.0

    # -- uwserver.adapter.Driver ----------------------------------------------------------------------------------------------------

    def order(self, wait_s: float) -> Order | None:
        """Return the next step: at once until the autopilot has sent outputs, then with each of its outputs."""
        end = self._steady() + wait_s
        self._wait(0.0)
        while True:
            now, link = self._steady(), self._link
            order = None if link is None else self._next(link, now)
            if order is not None or now >= end:
                return order
            # While bytes are unsent no step is possible, so only the socket can wake us.
            again = end
            if link is not None and not link.unsent:
                again = min(end, link.patience_end if link.is_locked else self._due)
            self._wait(again - now)

    @property
    def subscriptions(self) -> Collection[str]:
        """Ports that are read."""
        return self._sensors.readings.subscriptions

    def see(self, t_ns: int, samples: Sequence[Sample]) -> None:
        """Keep the samples that will be sent."""
        self._sensors.readings.see(samples)

    def answer(self, t_ns: int) -> None:
        """Send what is new after a step."""
        link = self._link
        if link is not None:
            link.told_s = self._steady()
            self._send(link, self._sensors.messages(link.codec, t_ns))

    def refuse(self, fault: Fault) -> None:
        """Note a refused command. Outputs are within the actuators' limits, so the actuator has been removed or switched off."""
        self._stats.count_error(fault.text)

    def close(self) -> None:
        """Close all connections. Runs on the loop thread when the simulation no longer calls the driver."""
        self._drop("")
        self._door.close()

    # -- steps ----------------------------------------------------------------------------------------------------------------------

    def _next(self, link: Connection, now: float) -> Order | None:
        if link.unsent:
            return None
        if link.is_locked and not link.is_fresh:
            if now < link.patience_end:
                return None
            link.controls = None
            self._counts["missed"] += 1
            self._counts["is_locked"] = False
        if not link.is_locked and now < self._due:
            return None
        self._due = max(now, self._due + self._step_s)
        link.is_fresh = False
        if link.controls is None:
            return Order(self._ticks, ())
        self._stats.commands += 1
        return Order(self._ticks, self._outputs.commands(link.controls.levels))

    # -- bytes ----------------------------------------------------------------------------------------------------------------------

    def _wait(self, seconds: float) -> None:
        poll = select.poll()
        self._door.register(poll)
        link = self._link
        if link is not None:
            poll.register(link.stream, select.POLLIN | (select.POLLOUT if link.unsent else 0))
        ready = dict(poll.poll(max(0.0, seconds) * 1e3))
        if link is not None and link.stream.fileno() in ready:
            if link.unsent:
                self._send(link, b"")
            self._read(link)
        found = self._door.take(ready)
        if found is not None:
            self._begin(*found)

    def _begin(self, link: Connection, events: Sequence[codec.Event], bad: int) -> None:
        """Put another autopilot, which has spoken, in charge."""
        text = (
            "two autopilots connect here: the first connection is closed and the second autopilot flies the vehicle; "
            "give each an adapter with a port of its own"
        )
        if self._link is not None and self._refusals.note("second autopilot", text):
            self._tell_conflict(text)
        self._drop("another autopilot has connected")
        self._link = link
        self._stats.peers = 1
        self._counts["connections"] += 1
        self._sensors.restart()
        log.info("an autopilot has connected")
        self._count_bad(bad)
        self._take(link, events)

    def _read(self, link: Connection) -> None:
        try:
            data = link.stream.recv(READ)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(str(error))
            return
        if not data:
            self._drop("it closed")
            return
        events = link.codec.receive(data)
        link.bad_in_a_row = 0 if events else link.bad_in_a_row + link.codec.bad
        self._take(link, events)
        self._count_bad(link.codec.bad)
        link.codec.bad = 0
        if link.bad_in_a_row > BAD_IN_A_ROW:
            self._drop("what it sends is no MAVLink")

    def _take(self, link: Connection, events: Sequence[codec.Event]) -> None:
        for event in events:
            if isinstance(event, codec.Controls):
                link.controls = event
                # Without lock-step the outputs carry a time of the autopilot's own clock.
                link.is_fresh = not event.is_lockstep or event.t_us >= self._sensors.told_ns // codec.MICROSECOND_NS
                self._counts["controls"] += 1
                self._counts["late"] += not link.is_fresh
                self._counts["limited"] += event.limited
                self._counts["is_locked"] = link.is_locked
            elif isinstance(event, codec.Interval):
                self._sensors.ask(event)

    def _count_bad(self, bad: int) -> None:
        if bad:
            self._counts["bad"] += bad
            self._stats.errors += bad

    def _send(self, link: Connection, data: bytes) -> None:
        unsent = link.unsent + data
        try:
            sent = link.stream.send(unsent) if unsent else 0
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._drop(str(error))
            return
        self._stats.bytes_sent += sent
        link.unsent = unsent[sent:]
        if len(link.unsent) > WAITING:
            self._drop("it does not read")

    def _drop(self, reason: str) -> None:
        if self._link is None:
            return
        self._link.stream.close()
        self._link = None
        self._stats.peers = 0
        self._counts["is_locked"] = False
        if reason:
            self._stats.last_error = f"the connection to the autopilot ended: {reason}"
            log.warning("%s; the world waits for the next one", self._stats.last_error)
