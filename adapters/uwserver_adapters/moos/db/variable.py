"""The state of a database: variables, clients, and the registrations of clients for variables and for patterns of names.

In a pattern ``*`` is any number of characters, and ``?`` is one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

from uwserver_adapters.moos import wire
from uwserver_adapters.moos.clock import Latency
from uwserver_adapters.moos.wire import MoosMessage

MARKED = 64
"""Work of a comparison with a question mark in the pattern: 20 us with the longest names."""


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
        latency: latency of its heartbeats.
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


def fits(key: str, source: str, pattern: str, app: str) -> bool:
    """Return whether the patterns match a variable and the client that wrote it last."""
    return glob(pattern, key) and glob(app, source)


def work(pattern: str, app: str = "") -> int:
    """Return the cost of a comparison, about, in units of a third of a microsecond."""
    return 1 + sum(each.count("*") + MARKED * ("?" in each) for each in (pattern, app))


def is_pattern(text: str) -> bool:
    """Return whether a text may match more than one name."""
    return "*" in text or "?" in text


def _has_parts(parts: list[str], text: str) -> bool:
    """Return whether a text consists of these parts in their order, with anything between them."""
    if len(parts) == 1:
        return text == parts[0]
    start, *middle, end = parts
    at, limit = len(start), len(text) - len(end)
    if at > limit or not text.startswith(start) or not text.endswith(end):
        return False
    for part in middle:
        found = text.find(part, at, limit)
        if found < 0:
            return False
        at = found + len(part)
    return True


class _Automaton(NamedTuple):
    """A pattern as an automaton. A state is how many characters of the pattern, without stars, are matched; sets of states are bits of a number.

    Attributes:
        advance: character -> states from which it leads to the next state.
        advance_any: the same for a character that the pattern does not contain.
        stay: states with a star.
        end: the last state.
    """

    advance: dict[str, int]
    advance_any: int
    stay: int
    end: int


@lru_cache(maxsize=256)
def _automaton(pattern: str) -> _Automaton:
    advance_any = stay = 0
    advance: dict[str, int] = {}
    state = 1
    for character in pattern:
        if character == "*":
            stay |= state
            continue
        if character == "?":
            advance_any |= state
        else:
            advance[character] = advance.get(character, 0) | state
        state <<= 1
    return _Automaton({c: states | advance_any for c, states in advance.items()}, advance_any, stay, state)


def glob(pattern: str, text: str) -> bool:
    """Return whether a text matches a pattern.

    Nothing is tried twice: all states that are possible advance together, so each character costs the same.
    """
    if "?" not in pattern:  # nearly all patterns
        return _has_parts(pattern.split("*"), text)
    advance, advance_any, stay, end = _automaton(pattern)
    states = 1
    for character in text:
        states = (states & advance.get(character, advance_any)) << 1 | states & stay
        if not states:
            return False
    return states & end != 0
