"""TCP clients of MORSE's two kinds: requests on one port, and a stream for each component."""

from __future__ import annotations

from typing import Any

import msgspec

from uwserver.adapter import Connection, Conversation, Lines, Peers, Undecodable, decode
from uwserver.ports import Fault, Refused, Reply
from uwserver_adapters.morse.config import MorseConfig
from uwserver_adapters.morse.grammar import Malformed, RequestDecoder, answer
from uwserver_adapters.morse.session import Session
from uwserver_adapters.morse.stage import Component, Stage

STREAM_LINE = 1 << 18
"""Longest command, bytes."""
TELL_S = 1.0
"""Wall time between two faults that a stream is told, as each command of each tick may have one."""


class Requests(Connection):
    """A client of the request channel.

    Args:
        stage: what all clients share.
        config: limits.
        peers: clients.
        name: name of this client.
    """

    def __init__(self, stage: Stage, config: MorseConfig, peers: Peers[Any], name: str) -> None:
        self._session = Session(stage, name, self._send, config.max_unanswered)
        super().__init__(
            peers,
            stats=stage.context.stats,
            requests_per_s=config.max_requests_per_s,
            queue_bytes=config.queue_bytes,
            conversation=self._session.conversation,
        )
        self._decoder = RequestDecoder()

    def refused(self, fault: Fault) -> bytes:
        """Return the line for a client that finds no place."""
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
            text = f"more than {self._rate.most} requests a second: max_requests_per_s"
            event = Malformed(event.id, text)
        self._session.take(event)
        return True

    def _send(self, line: bytes) -> None:
        self.send_answer(line, "a client of requests")
        self.finish_if_done()


class Stream(Connection):
    """A client of the stream of a component: it hears samples, or commands.

    Args:
        stage: what all clients share.
        component: the component.
        config: limits.
        peers: clients of all streams.
        name: name of this client.
    """

    def __init__(self, stage: Stage, component: Component, config: MorseConfig, peers: Peers[Any], name: str) -> None:
        super().__init__(
            peers,
            stats=stage.context.stats,
            requests_per_s=config.max_requests_per_s,
            queue_bytes=config.queue_bytes,
        )
        self._stage = stage
        self._component = component
        self._lines = Lines(STREAM_LINE)
        self._conversation = Conversation(stage.context, name)
        self._told = -TELL_S
        self._has_entered = False

    def opened(self) -> None:
        """Begin to listen."""
        self._has_entered = True
        self._stage.enter(self._component.name, self.send_sample)

    def closed(self) -> None:
        """Stop listening. What the client commanded stands until the actuator's time-out."""
        self._conversation.close()
        if self._has_entered:
            self._stage.leave(self._component.name, self.send_sample)

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
                text = f"more than {self._rate.most} lines a second: max_requests_per_s"
                raise Refused("overload", text)
            if self._component.direction == "OUT":
                raise Refused("denied", f"{self._component.name} is a sensor: its stream takes nothing")
            said = decode(line, "json")
            if not isinstance(said, dict):
                raise Refused("bad_argument", "a command is a JSON object, {...}")
            self._stage.carry_out(self._conversation, self._component, said, self._answered)
        except Undecodable as error:
            self._complain(Fault("parse_error", str(error)))
        except Refused as refused:
            self._complain(refused.fault)
        return True

    def _answered(self, reply: Reply) -> None:
        if reply.fault is not None:
            self._complain(reply.fault)

    def _complain(self, fault: Fault) -> None:
        """Tell the client what was not carried out, by a line with the key `error`: a stream has no answers."""
        self._stats.count_error(f"{self._component.name}: {fault.text}")
        now = self.loop.time()
        if now - self._told >= TELL_S and not self.is_closing:
            self._told = now
            self.write(msgspec.json.encode({"error": fault.text, "code": fault.code}) + b"\n")
