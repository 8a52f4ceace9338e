"""Who connects to PX4's simulator port: only one that has spoken its MAVLink is let in. Runs on the simulation thread."""

from __future__ import annotations

import logging
import math
import select
import socket
from collections.abc import Callable, Container, Sequence

from uwserver.adapter import NO_DESCRIPTORS, REFUSALS, FirstBytes, Refusals, note_no_descriptors
from uwserver_adapters.px4 import codec

log = logging.getLogger(__name__)

READ = 1 << 10
"""Bytes read at a time: an autopilot says some 100 in a step, and what is no MAVLink takes long to read."""
GUESTS = 4
"""Connections that have not said a message yet; the oldest makes way."""
GREETING_S = 5.0
"""Wall time in which a connection must have said one."""
LINGER_S = 1.0
"""Wall time that a peer has to read why it is not let in."""
PATIENCE_S = 1.0
"""Wall time that a disarmed autopilot has for its outputs: some of its modes give none while nothing moves. An armed one has all of it."""
PAUSE_S = 1.0
"""Wall time for which nobody is accepted when this process has no file descriptors left."""


class Connection:
    """One autopilot's.

    Attributes:
        stream: non-blocking socket.
        codec: its messages.
        unsent: bytes that it has not taken yet.
        bad_in_a_row: messages and pieces since the last one that was understood.
        controls, is_fresh: its last actuator outputs, and whether no tick has used them.
        told_s: wall time at which it was last told of a tick.
    """

    def __init__(self, stream: socket.socket) -> None:
        self.stream = stream
        self.codec = codec.Codec()
        self.unsent = b""
        self.bad_in_a_row = 0
        self.controls: codec.Controls | None = None
        self.is_fresh = False
        self.told_s = math.inf

    @property
    def is_locked(self) -> bool:
        """Whether the next tick waits for its outputs. Before the first ones, or built without lock-step, it would wait for ever."""
        return self.controls is not None and self.controls.is_lockstep

    @property
    def patience_end(self) -> float:
        """Wall time until which its outputs are waited for, s."""
        return math.inf if self.controls is not None and self.controls.is_armed else self.told_s + PATIENCE_S


class Guest:
    """A connection that has not said a message yet."""

    def __init__(self, link: Connection, end_s: float) -> None:
        self.link = link
        self.end_s = end_s
        self.first: FirstBytes | None = FirstBytes()
        self.is_leaving = False


class Door:
    """Takes connections until they have shown what they are: whoever is served meanwhile notices nothing.

    Args:
        listener: listening TCP socket that does not block; whoever made it closes it.
        refusals: where it is told who was sent away.
        steady: wall time, s.
    """

    def __init__(self, listener: socket.socket, refusals: Refusals, steady: Callable[[], float]) -> None:
        self._listener = listener
        self._refusals = refusals
        self._steady = steady
        self._guests: list[Guest] = []
        self._accepts_at = 0.0

    def register(self, poll: select.poll) -> None:
        """Name what is to be waited for."""
        if self._steady() >= self._accepts_at:
            poll.register(self._listener, select.POLLIN)
        for guest in self._guests:
            poll.register(guest.link.stream, select.POLLIN)

    def take(self, ready: Container[int]) -> tuple[Connection, Sequence[codec.Event], int] | None:
        """Read what has come.

        Args:
            ready: descriptors with something to read.

        Returns:
            A connection that is an autopilot's, the first it said, and the bytes or messages among these that were not understood.
        """
        now = self._steady()
        for guest in list(self._guests):
            events = self._heard(guest) if guest.link.stream.fileno() in ready else None
            if any(not isinstance(event, codec.Interval) for event in events or ()):
                assert events is not None
                self._guests.remove(guest)
                bad, guest.link.codec.bad = guest.link.codec.bad, 0
                return guest.link, events, bad
            if now >= guest.end_s:
                if guest.first is None:
                    text = "a peer speaks MAVLink, but not as an autopilot: ground stations find PX4 at UDP 14550, not here"
                    self._refusals.note("no autopilot", text)
                self._end(guest)
        if self._listener.fileno() in ready:
            self._accept(now)
        return None

    def close(self) -> None:
        """End all."""
        for guest in list(self._guests):
            self._end(guest)

    def _accept(self, now: float) -> None:
        try:
            stream, _ = self._listener.accept()
        except OSError as error:  # without descriptors; else it went again
            if error.errno in NO_DESCRIPTORS:
                self._accepts_at = now + PAUSE_S
                note_no_descriptors(error, self._refusals)
            return
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if len(self._guests) >= GUESTS:
            self._refusals.note(
                "strangers", "too many connections have not said a message of MAVLink: the oldest is closed"
            )
            self._end(self._guests[0])
        guest = Guest(Connection(stream), now + GREETING_S)
        self._guests.append(guest)
        self._send(guest, guest.link.codec.heartbeat())

    def _heard(self, guest: Guest) -> list[codec.Event] | None:
        try:
            data = guest.link.stream.recv(READ)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if not data:
            self._end(guest)
            return None
        if guest.is_leaving:
            return None
        if guest.first is None:
            return guest.link.codec.receive(data)
        guest.first.receive(data)
        speech = guest.first.speech
        if speech == "unknown":
            return None
        if speech == "own":
            data, guest.first = bytes(guest.first.held), None
            return guest.link.codec.receive(data)
        text, answer = REFUSALS[speech]
        self._refusals.note(speech, text)
        guest.is_leaving, guest.end_s = True, self._steady() + LINGER_S
        self._send(guest, answer)
        return None

    def _send(self, guest: Guest, data: bytes) -> None:
        try:
            guest.link.stream.send(data)  # the first bytes of a connection always fit
            if guest.is_leaving:
                guest.link.stream.shutdown(socket.SHUT_WR)
        except OSError:  # it went again
            self._end(guest)

    def _end(self, guest: Guest) -> None:
        guest.link.stream.close()
        if guest in self._guests:
            self._guests.remove(guest)
