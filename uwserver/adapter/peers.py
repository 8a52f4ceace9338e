"""The peers of an adapter and their limits.

Peers that have shown that they speak the protocol are admitted; strangers have places of their own. A connection whose protocol has not begun is no
peer yet, but takes a stranger's place. Peers that ask too often, or for too much, wait.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
from collections import Counter
from collections.abc import Awaitable, Iterator
from typing import Generic, Protocol, TypeVar

from uwserver.adapter.base import Refusals
from uwserver.adapter.contract import AdapterStats
from uwserver.ports import Fault

T = TypeVar("T")

WINDOW_S = 1.0
"""Wall time over which requests are counted."""

STRANGERS = 64
"""Peers of an adapter that may be connected without being admitted."""
CLOSING_S = 0.2
"""Wall time in which peers may take what was written before the adapter ends."""


class RateMeter:
    """Counts the requests of one client.

    Args:
        most: requests that are allowed in a window.
        window_s: wall time of a window; default `WINDOW_S`.

    Attributes:
        count: requests in this window.
        end: loop time at which the window ends.
    """

    def __init__(self, most: int, window_s: float | None = None) -> None:
        self.most = most
        self._window_s = WINDOW_S if window_s is None else window_s
        self.count = 0
        self.end = 0.0

    def take(self, now: float, weight: int = 1) -> bool:
        """Count a request, which may weigh as much as several; return whether it is still allowed."""
        if now >= self.end:
            self.end = now + self._window_s
            self.count = 0
        self.count += weight
        return self.count <= self.most

    def is_full(self, now: float) -> bool:
        """Tell whether one more request would be too many in this window, for callers that let it wait instead of refusing it."""
        return self.count >= self.most and now < self.end

    def is_flooded(self, now: float) -> bool:
        """Tell whether more requests came than are allowed in this window."""
        return self.count > self.most and now < self.end


class TurnTimes:
    """Gives peers that have used up their turn the time of their next one: one after the other, with a rest before each.

    While the loop works, the simulation waits for the interpreter. With the rests the simulation has it most of the time, however many peers
    flood the server.
    """

    def __init__(self) -> None:
        self._next = 0.0

    def after(self, now: float, turn_s: float, rest_s: float) -> float:
        """Return the loop time at which a peer whose turn ends now has the next one.

        Args:
            now: loop time.
            turn_s: length of a turn.
            rest_s: length of the rest before a turn.
        """
        at = max(self._next, now + rest_s)
        self._next = at + turn_s + rest_s
        return at


async def within(seconds: float, what: Awaitable[T], text: str) -> T:
    """Wait for a result, but no longer than so many seconds. `asyncio.wait_for` would lose a cancellation that comes together with the result.

    Raises:
        TimeoutError: it took too long; the error begins with `text`. It is an `OSError`, like other losses of a peer.
    """
    task = asyncio.ensure_future(what)
    try:
        await asyncio.wait({task}, timeout=seconds)
    finally:
        if not task.done():
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
    if task.cancelled():
        raise TimeoutError(f"{text} in {seconds:g} s")
    return task.result()


class Arrival(Protocol):
    """A connection whose protocol has not begun, as in a TLS handshake."""

    def abort(self) -> None:
        """End the connection at once."""


class Peer(Arrival, Protocol):
    """A client of any transport, as far as an adapter counts and ends it.

    Attributes:
        is_half_open: whether the peer has ended its side, so that it only listens, and may be long dead.
    """

    is_half_open: bool

    def close(self) -> None:
        """End the connection once the peer has taken what waits for it."""


P = TypeVar("P", bound=Peer)


def host_of(address: object) -> str:
    """Return the host of a socket's address, by which peers are counted. An IPv6 network counts as one, because one owner has its 2^64 addresses."""
    if not isinstance(address, tuple) or not address:
        return ""
    text = str(address[0])
    try:
        ip = ipaddress.ip_address(text.partition("%")[0])
    except ValueError:
        return text
    if isinstance(ip, ipaddress.IPv4Address):
        return text
    if ip.ipv4_mapped is not None:
        return str(ip.ipv4_mapped)
    return text if ip.is_loopback else str(ipaddress.ip_network((ip, 64), strict=False))


def _is_here(host: str) -> bool:
    return host in ("", "::1") or host.startswith("127.")


class Peers(Generic[P]):
    """All peers of one adapter. Its length counts them, and a loop over it meets them: no arrivals.

    Strangers never take the place of an admitted peer. When there are too many strangers, the oldest one of the host with the most strangers
    is closed.

    Args:
        most: number of peers that may be admitted.
        refusals: reports peers that are refused.
        stats: counters whose `peers` is kept up to date; None if the adapter counts by itself.
        most_per_host: number of peers that may be admitted from one host, except from this machine. Default: `most`.
        strangers: number of strangers that may be connected besides.
        key: key of the adapter's table that sets `most`.

    Attributes:
        most, refusals: as given.
        turns: times of the next turns of peers that have more to do than fits into one turn.
    """

    def __init__(
        self,
        most: int,
        refusals: Refusals,
        stats: AdapterStats | None = None,
        *,
        most_per_host: int | None = None,
        strangers: int = STRANGERS,
        key: str = "max_clients",
    ) -> None:
        self.most = most
        self.refusals = refusals
        self.turns = TurnTimes()
        self._stats = stats
        self._most_per_host = most if most_per_host is None else most_per_host
        self._most_strangers = strangers
        self._key = key
        self._peers: dict[Arrival, P] = {}
        self._admitted: dict[Arrival, str] = {}
        self._strangers: dict[Arrival, str] = {}
        self._leaving: dict[Arrival, None] = {}
        self._hosts: Counter[str] = Counter()
        self._all_gone = asyncio.Event()

    def __iter__(self) -> Iterator[P]:
        return iter([*self._peers.values()])

    def __len__(self) -> int:
        return len(self._peers)

    def arrive(self, arrival: Arrival, host: str = "") -> None:
        """Give a connection whose protocol has not begun a stranger's place, until it leaves."""
        self._strangers[arrival] = host
        if len(self._strangers) > self._most_strangers:
            ((busiest, _),) = Counter(self._strangers.values()).most_common(1)
            text = f"more than {self._most_strangers} peers have said nothing valid yet: the oldest is closed"
            self.refusals.note("strangers", text)
            self._end(next(other for other, its in self._strangers.items() if its == busiest))
        self._count()

    def enter(self, peer: P, host: str = "") -> None:
        """Count a new peer, as a stranger."""
        self._peers[peer] = peer
        self.arrive(peer, host)

    def admit(self, peer: P) -> Fault | None:
        """Admit a stranger that has shown that it speaks the protocol. If there is no place, return the fault to send to it.

        A peer that only listens, and may be long dead, makes way.
        """
        host = self._strangers.get(peer, "")
        if not _is_here(host) and self._hosts[host] >= self._most_per_host:
            text = f"{self._most_per_host} clients of your host are connected: close some, or raise max_clients_per_host of the adapter"
            return self._refused(text)
        if len(self._admitted) >= self.most:
            idle = next((other for other in self if other in self._admitted and other.is_half_open), None)
            if idle is None:
                return self._refused(
                    f"{self.most} clients are connected: close some, or raise {self._key} of the adapter"
                )
            self._end(idle)
        self._strangers.pop(peer, None)
        self._admitted[peer] = host
        self._hosts[host] += 1
        self._count()
        return None

    def leave(self, peer: Arrival) -> None:
        """Forget a peer whose connection has ended, or an arrival."""
        self._peers.pop(peer, None)
        self._leaving.pop(peer, None)
        self._give_up(peer)
        self._count()
        if not self._everyone():
            self._all_gone.set()

    def _everyone(self) -> list[Arrival]:
        return [*self._admitted, *self._strangers, *self._leaving]

    def _end(self, peer: Arrival) -> None:
        """End a peer that makes way. Its place is free at once, although its connection takes a moment to end."""
        self._give_up(peer)
        self._leaving[peer] = None
        peer.abort()

    def _give_up(self, peer: Arrival) -> None:
        self._strangers.pop(peer, None)
        host = self._admitted.pop(peer, None)
        if host is not None:
            self._hosts -= Counter((host,))

    def _refused(self, text: str) -> Fault:
        self.refusals.note("max_clients", text)
        return Fault("overload", text)

    def _count(self) -> None:
        if self._stats is not None:
            self._stats.peers = len(self)

    async def close(self) -> None:
        """End all connections; return when they have ended."""
        for arrival in self._everyone():
            if arrival not in self._peers:
                arrival.abort()
        for peer in self:
            peer.close()
        try:
            if self._everyone():
                self._all_gone.clear()
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._all_gone.wait(), CLOSING_S)
        finally:
            for left in self._everyone():
                left.abort()
        # An aborted transport ends in the next turn of the loop.
        if self._everyone():
            self._all_gone.clear()
            await self._all_gone.wait()
