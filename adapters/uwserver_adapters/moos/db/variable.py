"""The state of a database: variables, clients, and the registrations of clients for variables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from uwserver_adapters.moos import wire
from uwserver_adapters.moos.clock import Latency
from uwserver_adapters.moos.wire import MoosMessage


class Letter:
    """A message on its way to many clients; it is encoded once.

    Attributes:
        message: the message.
        line: the same as a line of text; "" until the first client that reads lines makes it.
    """

    def __init__(self, message: MoosMessage) -> None:
        self.message = message
        self.line = ""

    @cached_property
    def data(self) -> bytes:
        """The encoded message."""
        return wire.encode(self.message)


@dataclass(eq=False)
class Client:
    """One client.

    Attributes:
        deliver: takes its mail.
        filters: (pattern of variables, pattern of clients) -> interval, of its wildcard registrations.
        hears: names of the variables for which it is registered; the values mean nothing.
        writes: names of the variables that it has written, likewise.
        latency: of its heartbeats.
    """

    deliver: Callable[[Letter], None]
    filters: dict[tuple[str, str], float] = field(default_factory=dict)
    hears: dict[str, None] = field(default_factory=dict)
    writes: dict[str, None] = field(default_factory=dict)
    latency: Latency = field(default_factory=Latency)


@dataclass(eq=False, slots=True)
class Subscription:
    """The registration of a client for a variable.

    Attributes:
        client: the client.
        interval: least MOOS time between two deliveries, s; 0 for all writes.
        last: when the last write was delivered, by the steady clock.
    """

    client: Client
    interval: float
    last: float = -1e300


@dataclass(eq=False)
class Variable:
    """One variable.

    Attributes:
        letter: its last value; None before the first.
        written: MOOS time of the last write, by our clock.
        last: the same by the steady clock.
        writes: number of writes.
        frequency: mean number of writes in a MOOS second.
        subscribers: name of a client -> its registration.
    """

    letter: Letter | None = None
    written: float = 0.0
    last: float = 0.0
    writes: int = 0
    frequency: float = 0.0
    subscribers: dict[str, Subscription] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """Type of the value: D, S or B; "" before the first write."""
        return self.letter.message.kind if self.letter is not None else ""

    @property
    def source(self) -> str:
        """Client that wrote the last value; "" before the first write."""
        return self.letter.message.src if self.letter is not None else ""

    @property
    def size(self) -> int:
        """Bytes of the value."""
        return len(self.letter.message.data) if self.letter is not None else 0

    def hears(self, name: str, client: Client) -> bool:
        """Return whether this client is registered, and not an earlier one of the same name."""
        there = self.subscribers.get(name)
        return there is not None and there.client is client
