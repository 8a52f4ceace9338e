"""TCP peers of MORSE's two kinds: requests on one port, and a stream for each component."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from uwserver.adapter import Connection, Conversation, Lines, Peers, RateMeter, Undecodable, decode
from uwserver.ports import Fault, Refused, Reply
from uwserver_adapters.morse.components import Component
from uwserver_adapters.morse.config import MorseConfig
from uwserver_adapters.morse.grammar import Malformed, RequestDecoder, answer
from uwserver_adapters.morse.session import Session, Stage

STREAM_LINE = 1 << 18
"""Longest command, bytes."""
TELL_S = 1.0
"""Wall time between two faults that a stream is told: it may say one a tick."""


class Requests(Connection):
    """A client of the request channel.

    Args:
        stage: what all clients share.
        config: limits.
        peers: clients.
        name: of this one.
    """

    def __init__(self, stage: Stage, config: MorseConfig, peers: Peers[Any], name: str) -> None:
        super().__init__(peers)
        self._config = config
        self._stats = stage.context.stats
        self._decoder = RequestDecoder()
        self._session = Session(stage, name, self._send, config.max_unanswered)
        self._rate = RateMeter(config.max_requests_per_s)

    def refused(self, fault: Fault) -> bytes:
        """What one client too many gets."""
        return answer("-", "FAILED", fault.text)

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._decoder.receive(data)

    def step(self) -> bool:
        """Take the next request."""
        event = self._decoder.next_event()
        if event is None:
            return False
        if not self._rate.take(self.loop.time()):
            text = f"more than {self._config.max_requests_per_s} requests a second: max_requests_per_s"
            event = Malformed(event.id, text)
        self._session.take(event)
        return True

    def quiet_until(self) -> float:
        """A client that floods is not read until its second is over."""
        return self._rate.end if self._rate.is_flooded(self.loop.time()) else 0.0

    def half_closed(self) -> None:
        """On TCP, who has gone looks like who only listens on: what would take long is ended, the rest is still answered."""
        self._session.end_calls()

    @property
    def is_owed(self) -> bool:
        """Answers are to come."""
        return self._session.waiting > 0

    def closed(self) -> None:
        """The client went: nobody waits for its calls."""
        self._session.close()

    def _send(self, line: bytes) -> None:
        if self.is_closing:
            return
        if self.waiting > self._config.queue_bytes:
            self._stats.last_error = "a client of requests did not read its answers and was disconnected"
            self.abort()
            return
        self._stats.bytes_sent += len(line)
        self.write(line)
        self.finish_if_done()


class Stream(Connection):
    """Somebody at the stream of a component: hears its samples, or commands it.

    Args:
        stage: what all clients share.
        component: whose stream this is.
        config: limits.
        peers: of all streams.
        name: of this one.
        enter, leave: tell that it listens, and that it went.
        carry_out: a command, on behalf of a conversation; may raise `Refused`.
    """

    def __init__(
        self, stage: Stage, component: Component, config: MorseConfig, peers: Peers[Any], name: str,
        enter: Callable[[Stream], None], leave: Callable[[Stream], None],
        carry_out: Callable[[Conversation, Component, dict[str, object], Callable[[Reply], None]], None],
    ) -> None:  # fmt: skip
        super().__init__(peers)
        self.component = component
        self._config = config
        self._stats = stage.context.stats
        self._lines = Lines(STREAM_LINE)
        self._conversation = Conversation(stage.context, name)
        self._rate = RateMeter(config.max_requests_per_s)
        self._enter = enter
        self._leave = leave
        self._carry_out = carry_out
        self._told = -TELL_S
        self._has_entered = False

    def opened(self) -> None:
        """It listens from now on."""
        self._has_entered = True
        self._enter(self)

    def closed(self) -> None:
        """It went. What it commanded stands until the actuator's time-out."""
        self._conversation.close()
        if self._has_entered:
            self._leave(self)

    def tell(self, line: bytes) -> None:
        """Samples; left out while the peer does not read."""
        if self.is_closing:
            return
        if self.waiting > self._config.queue_bytes:
            self._stats.dropped += 1
            return
        self._stats.samples_sent += 1
        self._stats.bytes_sent += len(line)
        self.write(line)

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._lines.receive(data)

    def step(self) -> bool:
        """Carry out the next line."""
        try:
            line = self._lines.next_line()
            if line is None:
                return False
            if not self._rate.take(self.loop.time()):
                raise Refused(
                    "overload", f"more than {self._config.max_requests_per_s} lines a second: max_requests_per_s"
                )
            if self.component.direction == "OUT":
                raise Refused("denied", f"{self.component.name} is a sensor: its stream takes nothing")
            said = decode(line, "json")
            if not isinstance(said, dict):
                raise Refused("bad_argument", "a command is a JSON object, {...}")
            self._carry_out(self._conversation, self.component, said, self._answered)
        except Undecodable as error:
            self._complain(Fault("parse_error", str(error)))
        except Refused as refused:
            self._complain(refused.fault)
        return True

    def quiet_until(self) -> float:
        """Who floods is not read until its second is over."""
        return self._rate.end if self._rate.is_flooded(self.loop.time()) else 0.0

    def _answered(self, reply: Reply) -> None:
        if reply.fault is not None:
            self._complain(reply.fault)

    def _complain(self, fault: Fault) -> None:
        """A stream has no answers; a line with one key, `error`, tells what was not carried out."""
        self._stats.errors += 1
        self._stats.last_error = f"{self.component.name}: {fault.text}"
        now = self.loop.time()
        if now - self._told >= TELL_S and not self.is_closing:
            self._told = now
            self.write(msgspec.json.encode({"error": fault.text, "code": fault.code}) + b"\n")
