"""The state of a client, without input and output and without a clock. Both clients are thin shells around it."""

from __future__ import annotations

import math
import os
import ssl
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar, cast

from uwclient import verbs
from uwclient.checks import command_value
from uwclient.core import Reply, Wire
from uwclient.errors import CallRefused, ConnectionLost, ProtocolError, Timeout, UwError
from uwclient.ports import NANOSECONDS, Ack, Description, Event, Progress, Sample, Subscription, matches
from uwclient.verbs import Verb
from uwclient.wire import RequestId

T = TypeVar("T")

INBOX_SAMPLES = 4096
FIRST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 2.0
POLL_S = 0.02
"""Pause between two requests of the simulation time in `wait_until`, wall s."""

OnProgress = Callable[[Progress], object]


@dataclass(frozen=True)
class Settings:
    """Where and how to connect.

    Attributes:
        host, port: address of the server for TCP.
        name: name of the client; None for none.
        token: token of the server; None for none.
        encoding: "json" or "msgpack".
        timeout: default time limit, wall s.
        reconnect: whether to renew a lost connection.
        via: where the server is, for people, if the connection is not TCP.
        tls: context of TLS; None for no encryption.
    """

    host: str
    port: int
    name: str | None
    token: str | None = field(repr=False)
    encoding: str
    timeout: float
    reconnect: bool
    via: str = ""
    tls: ssl.SSLContext | None = None

    def with_token_from_environment(self) -> Settings:
        """Return these settings with the token of UWSERVER_TOKEN if none was given."""
        return self if self.token is not None else replace(self, token=os.environ.get("UWSERVER_TOKEN") or None)

    @property
    def address(self) -> str:
        """Where the server is, for people."""
        return self.via or f"{self.host}:{self.port}"


def pauses() -> Iterator[float]:
    """Yield the pauses between attempts to connect, wall s, which double from 0.1 to 2."""
    pause = FIRST_PAUSE_S
    while True:
        yield pause
        pause = min(2 * pause, LONGEST_PAUSE_S)


class Pending(Generic[T]):
    """A request that waits for its reply. `data` is to be written; `done` says that it has a reply, or will never have one."""

    def __init__(self, verb: Verb[T], identity: RequestId, data: bytes, on_progress: OnProgress | None) -> None:
        self.verb = verb
        self.id = identity
        self.data = data
        self.on_progress = on_progress
        self.done = False
        self._result: object = None
        self._error: UwError | None = None

    def finish(self, result: object = None, error: UwError | None = None) -> None:
        """Record the outcome."""
        self._result, self._error, self.done = result, error, True

    def value(self) -> T:
        """Return the parsed result, or raise the error."""
        if self._error is not None:
            raise self._error
        return self.verb.parse(self._result)


class Session:
    """State of one client over any number of consecutive connections.

    Attributes:
        description: the last complete answer to `describe`.
        events: the last 256 events, oldest first.
        refusals: the last 256 failures of notifications (`send_nowait`), oldest first.
        dropped: number of unread samples that were thrown away because more than 4096 waited.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.description = Description()
        self.events: deque[Event] = deque(maxlen=256)
        self.refusals: deque[CallRefused] = deque(maxlen=256)
        self.dropped = 0
        self._wire = Wire(settings.encoding)
        self._pending: dict[RequestId, Pending[object]] = {}
        self._subscriptions: dict[str, Verb[Subscription]] = {}
        self._inbox: deque[Sample] = deque()
        self._latest: dict[str, Sample] = {}
        self._stale = False
        self._lost_subscriptions: list[CallRefused] = []

    # Requests

    def request(self, verb: Verb[T], on_progress: OnProgress | None = None) -> Pending[T]:
        """Register a request. Raises CallRefused if its params cannot be sent."""
        identity, data = self._wire.request(verb.method, verb.params)
        pending = Pending(verb, identity, data, on_progress)
        self._pending[identity] = cast("Pending[object]", pending)
        return pending

    def give_up(self, pending: Pending[T]) -> bytes:
        """Forget a request; return the bytes that tell the server to stop it, or b"" if there is nothing to stop."""
        self._pending.pop(pending.id, None)
        if pending.done or not pending.verb.cancellable:
            return b""
        # A reply to an id for which nobody waits is ignored. The failure of a notification would be reported.
        return self._wire.request("cancel", {"id": pending.id})[1]

    def notification(self, verb: Verb[T]) -> bytes:
        """Return the bytes of a request that gets no reply."""
        return self._wire.notification(verb.method, verb.params)

    def command(self, port: str, fields: Mapping[str, object]) -> Verb[Ack]:
        """Return a command that was checked against the description. Raises CallRefused."""
        return verbs.command(port, command_value(self.description.ports, port, fields))

    def call(self, service: str, args: Mapping[str, object]) -> Verb[object]:
        """Return the call of a service."""
        return verbs.call(service, args, self.description.services.get(service))

    # Bytes in

    def receive(self, data: bytes) -> list[tuple[OnProgress, Progress]]:
        """Take in bytes, and return the calls for progress to make after everything in `data` is in place.

        Raises:
            ProtocolError: the bytes are not from a uwserver; the connection must be ended.
        """
        due: list[tuple[OnProgress, Progress]] = []
        for message in self._wire.receive(data):
            if isinstance(message, Sample):
                self._keep(message)
            elif isinstance(message, Reply):
                self._resolve(message)
            elif isinstance(message, Event):
                self.events.append(message)
                self._stale = self._stale or message.event == "ports_changed"
            else:
                pending = self._pending.get(message.id)
                if pending is not None and pending.on_progress is not None:
                    due.append((pending.on_progress, message))
        return due

    def _keep(self, sample: Sample) -> None:
        if len(self._inbox) >= INBOX_SAMPLES:
            self._inbox.popleft()
            self.dropped += 1
        self._inbox.append(sample)
        self._latest[sample.port] = sample

    def _resolve(self, reply: Reply) -> None:
        if reply.id is None:
            if reply.error is not None:
                self.refusals.append(reply.error)
            return
        pending = self._pending.pop(reply.id, None)
        if pending is not None:
            pending.finish(reply.result, reply.error)

    # Connection

    def restart(self) -> None:
        """Prepare for a new connection."""
        self._wire.restart()

    def lost(self, reason: str, fault: ProtocolError | None = None) -> None:
        """Let every unanswered request fail because the connection ended; the errors say whether the requests may have been applied."""
        for pending in self._pending.values():
            pending.finish(error=fault or self._loss(pending.verb, reason))
        self._pending.clear()

    def _loss(self, verb: Verb[object], reason: str) -> ConnectionLost:
        fate = (
            "it may or may not have been applied: look before you repeat it"
            if verb.changes
            else "it changes nothing and can be repeated"
        )
        return ConnectionLost(
            f"the connection to {self.settings.address} was lost ({reason}) before {verb.title} was answered; {fate}",
            code="connection_lost",
            where=self.settings.address,
        )

    def unsent(self, why: str) -> ConnectionLost:
        """Return the error of an operation of which nothing was sent."""
        return ConnectionLost(f"{why}; nothing was sent", code="connection_lost", where=self.settings.address)

    def unreachable(self, reason: object) -> ConnectionLost:
        """Return the error for a server that did not answer within the timeout."""
        settings = self.settings
        if isinstance(reason, ssl.SSLCertVerificationError):
            text = (
                f"the server at {settings.address} shows a certificate that is not trusted here ({reason.verify_message}): give its file "
                f'with tls=uwclient.tls_context(ca="server.pem"), on the command line --ca server.pem'
            )
            return ConnectionLost(text, code="untrusted", where=settings.address)
        hint = "the host and port it printed (port=..., on the command line --port)"
        if settings.via:
            hint = "its name and endpoint (server=, connect=; on the command line --server, --connect)"
        return ConnectionLost(
            f"no uwserver answers at {settings.address} ({reason}; tried for {settings.timeout:g} s): start one with "
            f"`uwserver run`, or give {hint}",
            code="unreachable",
            where=settings.address,
        )

    def late(self, verb: Verb[T], timeout: float) -> Timeout:
        """Return the error for an answer that did not come in time."""
        return Timeout(f"{verb.title}: no answer within {timeout:g} s", code="timeout", where=self.settings.address)

    # Greeting

    def hello(self) -> Verb[dict[str, object]]:
        """Return the first request of a connection."""
        return verbs.hello(self.settings.name, self.settings.token)

    @property
    def stale(self) -> bool:
        """Whether ports have changed since the last complete `describe`."""
        return self._stale

    def described(self, description: Description) -> None:
        """Take over the answer to a complete `describe`."""
        self.description = description
        self._stale = False

    # Subscriptions and samples

    def subscribed(self, verb: Verb[Subscription]) -> None:
        """Remember a subscription, to renew it after a reconnection."""
        self._subscriptions[cast(str, verb.params["pattern"])] = verb

    def unsubscribed(self, pattern: str) -> None:
        """Forget a subscription."""
        self._subscriptions.pop(pattern, None)

    def subscriptions(self) -> Sequence[Verb[Subscription]]:
        """Return the subscriptions to renew on a new connection."""
        return list(self._subscriptions.values())

    def subscription_refused(self, verb: Verb[Subscription], error: CallRefused) -> None:
        """Remember that the renewal of a subscription was refused, so that the next operation reports it."""
        self.unsubscribed(cast(str, verb.params["pattern"]))
        self._lost_subscriptions.append(
            CallRefused(
                f"after the reconnection the server refused to {verb.title}: {error.message}",
                code=error.code,
                where=error.where,
            )
        )

    def raise_lost_subscription(self) -> None:
        """Raise CallRefused for a subscription that was lost in a reconnection."""
        if self._lost_subscriptions:
            raise self._lost_subscriptions.pop(0)

    def require_subscription(self, port: str | None) -> None:
        """Raise CallRefused if no sample of the port can come, because no subscription matches it."""
        self.raise_lost_subscription()
        patterns = list(self._subscriptions)
        if any(port is None or matches(pattern, port) for pattern in patterns):
            return
        raise CallRefused(
            f"nothing is subscribed that covers {port or 'any port'} (subscribed: {', '.join(patterns) or 'nothing'}); "
            "call subscribe() first",
            code="not_subscribed",
            where=port or "",
        )

    def take(self, port: str | None) -> Sample | None:
        """Remove and return the oldest unread sample, of one port if it is given, or None if there is none."""
        for index, sample in enumerate(self._inbox):
            if port is None or sample.port == port:
                del self._inbox[index]
                return sample
        return None

    def latest(self, port: str) -> Sample | None:
        """Return the newest sample of a port that has arrived. It stays unread for `take`."""
        return self._latest.get(port)


def subscribe_options(
    rate_hz: float | None, fields: Sequence[str] | None, delivery: str | None, pictures: str | None = None
) -> dict[str, object]:
    """Return the options of `subscribe` that were given."""
    chosen: dict[str, float | str | list[str] | None] = {
        "rate_hz": rate_hz,
        "fields": list(fields) if fields is not None else None,
        "delivery": delivery,
        "pictures": pictures,
    }
    return {name: value for name, value in chosen.items() if value is not None}


def time_reached(status: Mapping[str, object], t_s: float) -> bool:
    """Tell whether a status is at or after the simulation time `t_s`, up to rounding of it, as ``world/run_until`` does."""
    slack_ns = max(1, math.ceil(2 * math.ulp(t_s) * NANOSECONDS))
    return cast(int, status["t_ns"]) >= round(t_s * NANOSECONDS) - slack_ns


def time_s(status: Mapping[str, object]) -> float:
    """Return the simulation time of a status, s."""
    return cast(int, status["t_ns"]) / NANOSECONDS


def is_paused(status: Mapping[str, object]) -> bool:
    """Tell whether a status is that of a world that waits until it is stepped."""
    return status.get("paused") is True or status.get("mode") == "paused"
