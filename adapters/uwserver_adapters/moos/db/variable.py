"""What a database keeps: variables, who is there, and where writes of a variable go."""

from __future__ import annotations

from collections.abc import Callable

from uwserver_adapters.moos import wire
from uwserver_adapters.moos.clock import Latency
from uwserver_adapters.moos.wire import Message


class Letter:
    """A message on its way to many: encoded once.

    Attributes:
        message: that.
        line: the same as text; "" before the first who hears lines makes it.
    """

    __slots__ = ("_data", "line", "message")

    def __init__(self, message: Message) -> None:
        self.message = message
        self.line = ""
        self._data: bytes | None = None

    @property
    def data(self) -> bytes:
        """The encoded message."""
        if self._data is None:
            self._data = wire.encode(self.message)
        return self._data


class Client:
    """One client.

    Attributes:
        deliver: takes its mail.
        filters: its wildcard registrations, each with its interval.
        hears: variables that it is registered for.
        writes: variables that it has written.
        latency: of its heartbeats.
    """

    def __init__(self, deliver: Callable[[Letter], None]) -> None:
        self.deliver = deliver
        self.filters: dict[tuple[str, str], float] = {}
        self.hears: dict[str, None] = {}
        self.writes: dict[str, None] = {}
        self.latency = Latency()

    def leave(self) -> None:
        """It is gone: what still comes is thrown away."""
        self.deliver = _throw_away


class Subscription:
    """Whose a write of a variable is, how often at most, and when the last was delivered (by the steady clock)."""

    __slots__ = ("client", "interval", "last")

    def __init__(self, client: Client, interval: float) -> None:
        self.client = client
        self.interval = interval
        self.last = -1e300


class Variable:
    """One variable.

    Attributes:
        letter: its last value; None before the first.
        written: MOOS time of that by our clock.
        last: the same by the steady clock.
        writes: how many.
        frequency: mean number of writes in a MOOS second.
        subscribers: by name.
    """

    def __init__(self) -> None:
        self.letter: Letter | None = None
        self.written = self.last = 0.0
        self.writes = 0
        self.frequency = 0.0
        self.subscribers: dict[str, Subscription] = {}

    @property
    def kind(self) -> str:
        """D, S or B; "" before the first write."""
        return self.letter.message.kind if self.letter is not None else ""

    def clear(self) -> int:
        """Forget value and type; returns how many bytes the value had."""
        kept = 0 if self.letter is None else len(self.letter.message.data)
        self.letter = None
        self.writes, self.written, self.frequency = 0, 0.0, 0.0
        return kept

    def hears(self, name: str, client: Client) -> bool:
        """Whether this client hears it, and not one that had its name before."""
        there = self.subscribers.get(name)
        return there is not None and there.client is client

    def drop(self, name: str, client: Client) -> None:
        """This client hears it no more."""
        if self.hears(name, client):
            del self.subscribers[name]


def _throw_away(letter: Letter) -> None:
    """Nobody is there any more."""
