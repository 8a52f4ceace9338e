"""One TCP peer of many. Its input is handled in turns, it is told why its connection ends, and it costs a bounded amount of memory.

Whatever a peer sends, it takes at most `TURN_S` of the loop before others have their turn.
"""

from __future__ import annotations

import asyncio
import logging
import math
from typing import Any, cast

from uwserver.adapter.contract import AdapterStats
from uwserver.adapter.conversation import Conversation
from uwserver.adapter.foreign import REFUSALS, FirstBytes
from uwserver.adapter.peers import Peers, RateMeter, host_of
from uwserver.ports import Fault

log = logging.getLogger(__name__)

TURN_S = 0.001
"""Wall time after which the other peers have their turn."""
REST_S = 0.002
"""Wall time between two turns of a peer that has more to do, so that all peers get at most a third of the time."""
LINGER_S = 1.0
"""Wall time in which a peer may read the last text."""
HIGH_WATER = 1 << 16
"""Bytes in the transport above which `pause_writing` is called."""


class Connection(asyncio.Protocol):
    """A TCP peer. A derived class implements `receive` and `step`, which say what bytes mean, and may implement `opened`, `closed` and others.

    Args:
        peers: the peers of the adapter.
        first_message_s: wall time in which the derived class must admit the peer (`admit`). With `math.inf` the peer may wait among the
            strangers until another peer needs the place. By default every peer is admitted when it connects.
        stats: counters of the adapter, for `send_sample` and `send_answer`.
        requests_per_s: requests of the peer in a second that the derived class counts with ``self._rate.take``. If more come, nothing more is
            read from the peer until the second is over. By default requests are not counted.
        queue_bytes: bytes that may wait for the peer. Above that, samples are dropped, and a peer that does not read its answers is disconnected.
        conversation: the commands and calls of the peer. It ends with the connection, and its long-running calls end when the peer sends nothing
            more: on TCP a peer that has gone looks like one that only listens.

    Attributes:
        host: host of the peer, see `host_of`.
        is_stranger: whether the peer is not admitted yet.
        is_half_open: whether the peer sends nothing more, but may still read (``echo ... | nc -N``).
        peers, loop, transport: the given peers, the running loop, and the transport once it is connected.
        is_closing: whether the connection is ending; then nothing is read or written any more.
        is_working: whether a turn of this peer is being taken.
    """

    def __init__(
        self,
        peers: Peers[Any],
        first_message_s: float | None = None,
        *,
        stats: AdapterStats | None = None,
        requests_per_s: int = 0,
        queue_bytes: int = HIGH_WATER,
        conversation: Conversation | None = None,
    ) -> None:
        self.host = ""
        self.is_stranger = True
        self.is_half_open = False
        self.is_closing = False
        self.is_working = False
        self.peers = peers
        self.loop = asyncio.get_running_loop()
        self.transport: asyncio.Transport
        self._first: FirstBytes | None = FirstBytes()
        self._first_message_s = first_message_s
        self._stats = stats or AdapterStats()
        self._rate = RateMeter(requests_per_s)
        self._queue_bytes = queue_bytes
        self._asked = conversation
        self._deadline: asyncio.TimerHandle | None = None
        self._turn: asyncio.Handle | None = None
        self._linger: asyncio.TimerHandle | None = None

    # -- for derived classes --------------------------------------------------------------------------------------------------------

    def opened(self) -> None:
        """Called when the peer has connected and there is room for it."""

    def takes_http(self, head: bytes) -> bool:
        """Tell whether a peer that begins with this HTTP request is served; by default it is refused."""
        return False

    def receive(self, data: bytes) -> None:
        """Store received bytes, which come in pieces of any size."""
        raise NotImplementedError

    def step(self) -> bool:
        """Handle the next message of the stored bytes; return False if there is none."""
        raise NotImplementedError

    def quiet_until(self) -> float:
        """Return the loop time until which nothing more is read from a peer that floods, or 0.0 to read on. Called when all messages are handled."""
        return self._rate.end if self._rate.is_flooded(self.loop.time()) else 0.0

    def after_turn(self) -> None:
        """Called after each turn, so that everything that was written in it can be sent together."""

    def half_closed(self) -> None:
        """Called when the peer has ended its side of the connection. By default it ends the long-running calls of the peer's conversation."""
        if self._asked is not None:
            self._asked.half_close()

    @property
    def has_pending_output(self) -> bool:
        """Whether the peer may still get something although it asks for nothing more. By default: an answer of its conversation."""
        return self._asked is not None and self._asked.in_flight.count > 0

    def missed(self) -> None:
        """Refuse a peer that was not admitted in time."""
        text = f"nothing valid came within {self._first_message_s:g} s"
        self.peers.refusals.note("timeout", text)
        self.farewell(self.refused(Fault("timeout", text)))

    def refused(self, fault: Fault) -> bytes:
        """Return what a peer is sent if there is no place for it, or if it was not admitted in time."""
        return f"{fault.text}\n".encode()

    def stop(self) -> None:
        """Called when the connection begins to end. From now on nothing is taken from the peer or sent to it."""

    def closed(self) -> None:
        """Called when the connection has ended, also if it was never `opened`."""

    def admit(self) -> bool:
        """Give a place to a peer that has shown that it speaks this protocol. If there is none, tell it so, end the connection and return False."""
        if not self.is_stranger:
            return True
        fault = self.peers.admit(self)
        if fault is not None:
            self.farewell(self.refused(fault))
            return False
        self.is_stranger = False
        self._stop_deadline()
        return True

    # -- writing and ending ---------------------------------------------------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """Bytes that wait to be sent to the peer."""
        return self.transport.get_write_buffer_size()

    def write(self, data: bytes) -> None:
        """Send bytes, unless the connection is ending. If the peer has ended it, the transport knows that a turn before this object does."""
        if not self.is_closing and not self.transport.is_closing():
            self.transport.write(data)

    def send_sample(self, data: bytes) -> None:
        """Send a sample, and count it. It is dropped if too much waits for the peer."""
        if self.is_closing:
            return
        if self.waiting > self._queue_bytes:
            self._stats.dropped += 1
            return
        self._stats.samples_sent += 1
        self._stats.bytes_sent += len(data)
        self.write(data)

    def send_answer(self, data: bytes, who: str) -> None:
        """Send an answer. A peer that does not read its answers is disconnected; `who` names it in the status."""
        if self.is_closing:
            return
        if self.waiting > self._queue_bytes:
            self._stats.last_error = f"{who} did not read its answers and was disconnected"
            self.abort()
            return
        self._stats.bytes_sent += len(data)
        self.write(data)

    def close(self) -> None:
        """Close the connection once the peer has taken what waits for it."""
        if not self.is_closing:
            self._begin_closing()
            self.transport.close()

    def farewell(self, last: bytes, linger_s: float | None = None) -> None:
        """End the connection with a last text, and leave the peer some time to read it.

        If the socket were closed at once, one more byte from the peer would reset the connection, and destroy the text on its way.

        Args:
            last: the text.
            linger_s: wall time to leave; default `LINGER_S`.
        """
        if self.is_closing:
            return
        self.transport.write(last)
        self._begin_closing(linger_s)
        if not self.transport.can_write_eof():  # TLS
            self.transport.close()
            return
        try:
            self.transport.write_eof()
        except OSError:  # the peer has reset the connection, which the loop has not seen yet
            self.transport.abort()
            return
        self.transport.resume_reading()  # to see the peer's end; what it sends is thrown away

    def abort(self) -> None:
        """Close the connection at once."""
        self.is_closing = True
        self.transport.abort()

    def go_on(self) -> None:
        """Continue with the next message in a turn of its own, after something held `step` up."""
        if self._turn is None and not self.is_working and not self.is_closing:
            self._turn = self.loop.call_soon(self._work)

    def finish_if_done(self) -> None:
        """Close the connection if the peer asks for nothing more and is owed nothing."""
        if self.is_half_open and not self.is_closing and self._turn is None and not self.has_pending_output:
            self.close()

    def _begin_closing(self, linger_s: float | None = None) -> None:
        self.is_closing = True
        self._stop_turns()
        self._stop_deadline()
        self.stop()
        # Without a limit, a peer that reads nothing would keep its connection, and memory of the server, for ever.
        self._linger = self.loop.call_later(LINGER_S if linger_s is None else linger_s, self.transport.abort)

    def _stop_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _stop_turns(self) -> None:
        if self._turn is not None:
            self._turn.cancel()
            self._turn = None

    # -- asyncio --------------------------------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin the connection, or refuse it if there is no place for the peer."""
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(HIGH_WATER)
        peer = self.transport.get_extra_info("peername")
        self.host = host_of(peer)
        self.peers.enter(self, self.host)
        if peer is None:  # the peer has reset the connection since it was accepted
            self.abort()
            return
        if self._first_message_s is None:
            if not self.admit():
                return
        elif self._first_message_s < math.inf:
            self._deadline = self.loop.call_later(self._first_message_s, self.missed)
        self.opened()

    def connection_lost(self, error: Exception | None) -> None:
        """Clean up after the connection has ended for any reason."""
        self.is_closing = True
        self._stop_turns()
        self._stop_deadline()
        if self._linger is not None:
            self._linger.cancel()
        try:
            if self._asked is not None:
                self._asked.close()
            self.closed()
        finally:
            self.peers.leave(self)

    def eof_received(self) -> bool:
        """Note that the peer sends nothing more; return whether the connection stays open."""
        if self.is_closing:
            return False
        self.is_half_open = True
        self.half_closed()
        self.finish_if_done()
        return True

    def data_received(self, data: bytes) -> None:
        """Take bytes in pieces of any size."""
        if self._first is not None and not self.is_closing:
            data = self._recognised(self._first, data)
        if data and not self.is_closing:
            self.receive(data)
            if self._turn is None:
                self._work()

    def _recognised(self, first: FirstBytes, data: bytes) -> bytes:
        """Return the first bytes once they show that they may be of our protocol. A peer that speaks another protocol is refused unread."""
        first.receive(data)
        if first.speech == "unknown":
            return b""
        self._first = None
        head = bytes(first.held)
        if first.speech == "own" or (first.speech == "http" and self.takes_http(head)):
            return head
        text, answer = REFUSALS[first.speech]
        self.peers.refusals.note(first.speech, text)
        self.farewell(answer)
        return b""

    def _work(self) -> None:
        """Handle stored input for one turn."""
        self._turn = None
        self.is_working = True
        try:
            self._take_turn()
        except Exception:  # a fault of ours must not end the adapter, nor leave a peer that is never read again
            log.exception("a connection ends by a fault of the adapter")
            self.abort()
        finally:
            self.is_working = False
        self.after_turn()
        self.finish_if_done()

    def _take_turn(self) -> None:
        step, now = self.step, self.loop.time
        end = now() + TURN_S
        while not self.is_closing:
            if not step():
                self._read_on()
                return
            if now() >= end and not self.is_closing:
                self.transport.pause_reading()
                self._turn = self.loop.call_at(self.peers.turns.after(now(), TURN_S, REST_S), self._work)
                return

    def _read_on(self) -> None:
        if self.is_closing:
            return
        until = self.quiet_until()
        if until:
            self.transport.pause_reading()
            self._turn = self.loop.call_at(until, self._work)
        elif not self.is_half_open:
            self.transport.resume_reading()
