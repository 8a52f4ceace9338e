"""Accepts connections to PX4's simulator port, and lets in only those that speak its MAVLink. Runs on the simulation thread."""

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
"""Bytes read at a time. An autopilot sends about 100 in a step, and bytes that are no MAVLink are slow to decode."""
GUESTS = 4
"""Connections that have not sent a message yet. A new one closes the oldest."""
GREETING_S = 5.0
"""Wall time in which a connection must send its first message."""
LINGER_S = 1.0
"""Wall time in which a refused peer can read the reason."""
PATIENCE_S = 1.0
"""Wall time for which outputs of a disarmed autopilot are waited for: in some of its modes it sends none while nothing moves. An armed one is
waited for without limit."""
PAUSE_S = 1.0
"""Wall time without accepting connections after this process has run out of file descriptors."""


class Connection:
    """A connection, which is a guest until it has shown that it is an autopilot's.

    Args:
        stream: non-blocking socket.
        guest_until_s: wall time at which a guest is closed.

    Attributes:
        stream: as given.
        codec: decodes and encodes its messages.
        unsent: bytes that it has not taken yet.
        bad_in_a_row: messages and pieces since the last one that was understood.
        controls, is_fresh: its last actuator outputs, and whether no tick has used them.
        told_s: wall time at which the last sensor messages were sent to it.
        guest_until_s: as given.
        first: its first bytes, until they show what protocol it speaks.
        is_leaving: it was refused, and only the reason is still sent.
    """

    def __init__(self, stream: socket.socket, guest_until_s: float) -> None:
        self.stream = stream
        self.codec = codec.Codec()
        self.unsent = b""
        self.bad_in_a_row = 0
        self.controls: codec.Controls | None = None
        self.is_fresh = False
        self.told_s = math.inf
        self.guest_until_s = guest_until_s
        self.first: FirstBytes | None = FirstBytes()
        self.is_leaving = False

    @property
    def is_locked(self) -> bool:
        """Whether the next tick waits for outputs. It does not before the first outputs, nor for an autopilot built without lock-step."""
        return self.controls is not None and self.controls.is_lockstep

    @property
    def patience_end(self) -> float:
        """Wall time until which outputs are waited for, s."""
        return math.inf if self.controls is not None and self.controls.is_armed else self.told_s + PATIENCE_S


class Door:
    """Keeps guests until they have shown what they are, without disturbing the autopilot that is connected.

    Args:
        listener: non-blocking listening TCP socket; the caller closes it.
        refusals: counts and logs refused peers.
        steady: returns wall time, s.
    """

    def __init__(self, listener: socket.socket, refusals: Refusals, steady: Callable[[], float]) -> None:
        self._listener = listener
        self._refusals = refusals
        self._steady = steady
        self._guests: list[Connection] = []
        self._accepts_at = 0.0

    def register(self, poll: select.poll) -> None:
        """Register the sockets that must be waited for."""
        if self._steady() >= self._accepts_at:
            poll.register(self._listener, select.POLLIN)
        for guest in self._guests:
            poll.register(guest.stream, select.POLLIN)

    def take(self, ready: Container[int]) -> tuple[Connection, Sequence[codec.Event], int] | None:
        """Read what has come.

        Args:
            ready: file descriptors with something to read.

        Returns:
            A connection that is an autopilot's, its first messages, and how many bytes or messages before were not understood.
        """
        now = self._steady()
        for guest in list(self._guests):
            events = self._heard(guest) if guest.stream.fileno() in ready else []
            if any(not isinstance(event, codec.Interval) for event in events):
                self._guests.remove(guest)
                bad, guest.codec.bad = guest.codec.bad, 0
                return guest, events, bad
            if now >= guest.guest_until_s:
                if guest.first is None:
                    text = "a peer speaks MAVLink, but not as an autopilot: ground stations find PX4 at UDP 14550, not here"
                    self._refusals.note("no autopilot", text)
                self._end(guest)
        if self._listener.fileno() in ready:
            self._accept(now)
        return None

    def close(self) -> None:
        """Close all guests."""
        for guest in list(self._guests):
            self._end(guest)

    def _accept(self, now: float) -> None:
        try:
            stream, _ = self._listener.accept()
        except OSError as error:  # no file descriptors are left, or the peer has gone
            if error.errno in NO_DESCRIPTORS:
                self._accepts_at = now + PAUSE_S
                note_no_descriptors(error, self._refusals)
            return
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if len(self._guests) >= GUESTS:
            self._refusals.note(
                "strangers", "too many connections have not sent a MAVLink message: the oldest one is closed"
            )
            self._end(self._guests[0])
        guest = Connection(stream, now + GREETING_S)
        self._guests.append(guest)
        self._send(guest, guest.codec.heartbeat())

    def _heard(self, guest: Connection) -> list[codec.Event]:
        """Return the messages that a guest's next bytes complete. A guest that speaks another protocol gets an answer that says so."""
        try:
            data = guest.stream.recv(READ)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._end(guest)
            return []
        if guest.is_leaving:
            return []
        if guest.first is None:
            return guest.codec.receive(data)
        guest.first.receive(data)
        speech = guest.first.speech
        if speech == "own":
            data, guest.first = bytes(guest.first.held), None
            return guest.codec.receive(data)
        if speech != "unknown":
            text, answer = REFUSALS[speech]
            self._refusals.note(speech, text)
            guest.is_leaving, guest.guest_until_s = True, self._steady() + LINGER_S
            self._send(guest, answer)
        return []

    def _send(self, guest: Connection, data: bytes) -> None:
        try:
            guest.stream.send(data)  # the first bytes of a connection always fit
            if guest.is_leaving:
                guest.stream.shutdown(socket.SHUT_WR)
        except OSError:  # the peer has gone
            self._end(guest)

    def _end(self, guest: Connection) -> None:
        guest.stream.close()
        if guest in self._guests:
            self._guests.remove(guest)
