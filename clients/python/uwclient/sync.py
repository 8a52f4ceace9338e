"""The blocking client. It has no thread: it takes in samples and events while it waits, and at the start of every operation."""

from __future__ import annotations

import math
import ssl
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from types import TracebackType
from typing import TypeVar

from uwclient import verbs
from uwclient.base import SessionView
from uwclient.errors import CallRefused, ConnectionLost, ProtocolError, Timeout
from uwclient.link import Dial, Link, dial_tcp
from uwclient.ports import Ack, Description, Sample, Subscription
from uwclient.session import (
    POLL_S,
    OnProgress,
    Pending,
    Settings,
    is_paused,
    pauses,
    subscribe_options,
    time_reached,
    time_s,
)
from uwclient.verbs import Verb
from uwclient.wire import RequestId

T = TypeVar("T")

_DRAIN_CHUNKS = 128


class Client(SessionView):
    """A connection to a uwserver. Make one with `Client.connect`, and use it from one thread.

    Every `timeout` is in wall seconds; the default is the timeout of the client, and `math.inf` waits for ever. A lost connection is renewed by
    the next operation, together with the subscriptions; `reconnects` counts that.
    """

    def __init__(self, settings: Settings, dial: Dial) -> None:
        super().__init__(settings)
        self._dial = dial
        self._link: Link | None = None

    @classmethod
    def connect(
        cls,
        host: str = "127.0.0.1",
        port: int = 7600,
        *,
        name: str | None = None,
        token: str | None = None,
        encoding: str = "json",
        timeout: float = 5.0,
        reconnect: bool = True,
        tls: ssl.SSLContext | None = None,
    ) -> Client:
        """Connect, trying again until `timeout`, because the server may start later than the client.

        Args:
            host: name or address of the server.
            port: TCP port of the server.
            name: name of this client, which it needs to take part in a lockstep barrier.
            token: token of the server; default: the environment variable UWSERVER_TOKEN.
            encoding: "json", or "msgpack" (needs the msgpack package).
            timeout: wall s, for connecting and for every operation without a timeout of its own.
            reconnect: whether to renew a lost connection.
            tls: a context to encrypt the connection, such as `uwclient.tls_context(ca="server.pem")`.

        Raises:
            ConnectionLost: nobody answers.
            CallRefused: wrong token (`denied`) or version.
            ProtocolError: another program answers there.
        """
        settings = Settings(host, port, name, token, encoding, timeout, reconnect, tls=tls)
        return cls.over(partial(dial_tcp, host, port, tls), settings.with_token_from_environment())

    @classmethod
    def over(cls, dial: Dial, settings: Settings) -> Client:
        """Connect through the link that `dial` makes, as `connect` does through TCP."""
        client = cls(settings, dial)
        client._open(time.monotonic() + settings.timeout)
        return client

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the connection. Every later operation raises ConnectionLost."""
        self._closed = True
        self._disconnect("the client was closed")

    def describe(self, pattern: str = "**") -> Description:
        """Ask for the matching ports and the services. Without a pattern, `ports` and `services` are updated."""
        description = self._run(verbs.describe(pattern))
        if pattern == "**":
            self._session.described(description)
        return description

    # Samples

    def subscribe(
        self,
        pattern: str,
        *,
        rate_hz: float | None = None,
        fields: Sequence[str] | None = None,
        delivery: str | None = None,
        pictures: str | None = None,
    ) -> Subscription:
        """Ask for the samples of every matching port; `*` is one level, `**` is any number of levels.

        Args:
            pattern: a pattern such as "rov/imu", "rov/*" or "**".
            rate_hz: largest rate of each port in simulation time.
            fields: names of the fields to send; default: all.
            delivery: "latest", "ring" (the default of the server) or "reliable".
            pictures: "raw" (the default of the server), or "jpeg" to get the field of a picture as the bytes of a JPEG. Not over zenoh.

        Raises:
            CallRefused: `unknown_port` for a pattern without wildcard that matches nothing.
        """
        verb = verbs.subscribe(pattern, subscribe_options(rate_hz, fields, delivery, pictures))
        subscription = self._run(verb)
        self._session.subscribed(verb)
        return subscription

    def unsubscribe(self, pattern: str) -> int:
        """End the subscriptions that were made with this pattern, and return how many there were."""
        self._session.unsubscribed(pattern)
        return self._run(verbs.unsubscribe(pattern))

    def read(self, port: str | None = None, timeout: float | None = None) -> Sample:
        """Return the next unread sample, of one port if it is given. Raises Timeout, or CallRefused if nothing is subscribed."""
        limit, deadline = self._limit(timeout)
        while True:
            sample = self._session.take(port)
            if sample is not None:
                return sample
            self._session.require_subscription(port)
            if time.monotonic() >= deadline:
                raise Timeout(f"no sample of {port or 'any port'} within {limit:g} s", code="timeout", where=port or "")
            if self._link is None:
                self._ensure(deadline)
            else:
                self._pump(deadline)

    def latest(self, port: str) -> Sample | None:
        """Return the newest sample of a port that has arrived, or None before the first, without waiting."""
        if self._link is not None:
            self._drain()
        return self._session.latest(port)

    def samples(self, port: str | None = None) -> Iterator[Sample]:
        """Iterate over samples as they come, of one port if it is given, until the client is closed. It waits without limit."""
        while not self._closed:
            yield self.read(port, math.inf)

    def __iter__(self) -> Iterator[Sample]:
        return self.samples()

    # Commands and calls

    def send(self, port: str, value: Mapping[str, object] | None = None, /, **fields: object) -> Ack:
        """Command an actuator, and wait for the tick at which the command is applied: `send("rov/thrusters", u=[...])`.

        A world that is paused or waits in lockstep accepts the command at once; it acts from the next step on.

        Raises:
            CallRefused: the port, a field or a shape is wrong, a number is not finite (checked here) or out of range (checked by the server).
            ConnectionLost: the connection was lost; the text says whether the command may have been applied.
        """
        return self._run(self._command(port, {**(value or {}), **fields}))

    def send_nowait(self, port: str, value: Mapping[str, object] | None = None, /, **fields: object) -> None:
        """Command an actuator without waiting. Refusals of the server are in `refusals`."""
        verb = self._command(port, {**(value or {}), **fields})
        deadline = time.monotonic() + self._timeout
        self._ensure(deadline)
        data = self._session.notification(verb)
        if not self._write(data, deadline):
            raise ConnectionLost(
                f"the connection to {self._session.settings.address} was lost while sending; {verb.title} may or may "
                "not have been applied",
                code="connection_lost",
                where=port,
            )

    def call(
        self,
        service: str,
        args: Mapping[str, object] | None = None,
        /,
        *,
        on_progress: OnProgress | None = None,
        timeout: float | None = None,
        **more: object,
    ) -> object:
        """Call a service and return its value: `call("world/set_speed", speed=2.0)`.

        The call of a long-running service has no time limit unless `timeout` is given. A Timeout or Ctrl-C cancels the call. `on_progress` is
        called with a Progress; it may call `cancel(progress.id)`.
        """
        return self._run(self._session.call(service, {**(args or {}), **more}), timeout, on_progress)

    def cancel(self, request: RequestId) -> bool:
        """Cancel an unfinished call or step of this client by the id in its Progress. It then fails with `preempted`."""
        return self._run(verbs.cancel(request))

    def step(self, n: int = 1, timeout: float | None = None) -> Ack:
        """Run n ticks of a paused world, or grant n ticks in lockstep. Without a timeout it waits without limit."""
        return self._run(verbs.step(n), timeout)

    def pause(self) -> Ack:
        """Stop the simulation time."""
        return self._run(verbs.acknowledged("world/pause"))

    def resume(self) -> Ack:
        """Let the simulation time run on."""
        return self._run(verbs.acknowledged("world/resume"))

    def reset(self) -> Ack:
        """Reset the world to the start of the scenario."""
        return self._run(verbs.acknowledged("world/reset"))

    def status(self) -> dict[str, object]:
        """Return the value of world/status, which always has `tick` and `t_ns`."""
        return self._run(verbs.status())

    def wait_until(self, t_s: float, timeout: float | None = None) -> float:
        """Wait until the simulation time reaches `t_s` seconds. A paused world is run up to that time.

        Returns:
            The simulation time then, s.

        Raises:
            Timeout: it took longer than `timeout`; the default is no limit.
        """
        limit = math.inf if timeout is None else timeout
        deadline = time.monotonic() + limit
        asked = False
        while True:
            status = self.status()
            if time_reached(status, t_s):
                return time_s(status)
            left = deadline - time.monotonic()
            if left <= 0:
                raise Timeout(f"the simulation did not reach {t_s:g} s within {limit:g} s", code="timeout")
            if is_paused(status) and not asked:
                asked = True
                self._run(verbs.run_until(t_s, self.services.get("world/run_until")), left)
            else:
                self._idle(min(POLL_S, left))

    # The shell around the session

    def _command(self, port: str, fields: Mapping[str, object]) -> Verb[Ack]:
        if self._link is not None:
            self._drain()
        if self._session.stale or port not in self.ports:
            self.describe()
        return self._session.command(port, fields)

    def _run(self, verb: Verb[T], timeout: float | None = None, on_progress: OnProgress | None = None) -> T:
        limit = math.inf if timeout is None and verb.waits else self._limit(timeout)[0]
        deadline = time.monotonic() + limit
        self._ensure(deadline)
        return self._exchange(verb, limit, deadline, on_progress)

    def _exchange(self, verb: Verb[T], limit: float, deadline: float, on_progress: OnProgress | None = None) -> T:
        pending = self._session.request(verb, on_progress)
        try:
            self._write(pending.data, deadline)
            while not pending.done:
                if time.monotonic() >= deadline:
                    raise self._session.late(verb, limit)
                self._pump(deadline)
        finally:
            self._give_up(pending)
        return pending.value()

    def _give_up(self, pending: Pending[T]) -> None:
        data = self._session.give_up(pending)
        if data and self._link is not None:
            self._write(data, time.monotonic() + self._timeout)

    def _ensure(self, deadline: float) -> None:
        if self._closed:
            raise self._session.unsent("the client is closed")
        if self._link is not None:
            # Notices an end of the connection by the server before a request is risked.
            self._drain()
        if self._link is None:
            if not self._session.settings.reconnect:
                raise self._session.unsent("the connection was lost and reconnect is off")
            self._open(min(deadline, time.monotonic() + self._timeout))
            self.reconnects += 1
        self._session.raise_lost_subscription()

    def _open(self, deadline: float) -> None:
        for pause in pauses():
            try:
                self._attempt(deadline)
                return
            except (OSError, ConnectionLost, Timeout) as error:
                reason = error
            if isinstance(reason, ssl.SSLCertVerificationError):
                raise self._session.unreachable(reason) from reason
            if time.monotonic() + pause >= deadline:
                raise self._session.unreachable(reason) from reason
            time.sleep(pause)

    def _attempt(self, deadline: float) -> None:
        left = max(deadline - time.monotonic(), 0.001)
        self._link = self._dial(left)
        self._session.restart()
        try:
            self._exchange(self._session.hello(), left, deadline)
            self._session.described(self._exchange(verbs.describe(), left, deadline))
            for verb in self._session.subscriptions():
                try:
                    self._exchange(verb, left, deadline)
                except CallRefused as error:
                    self._session.subscription_refused(verb, error)
        except BaseException:
            self._disconnect("the greeting failed")
            raise

    def _disconnect(self, reason: str, fault: ProtocolError | None = None) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
        self._session.lost(reason, fault)

    def _write(self, data: bytes, deadline: float) -> bool:
        """Send all of `data`; return False if the connection was lost. A half-sent message ends the connection."""
        if self._link is None:
            self._session.lost("it was closed")
            return False
        try:
            self._link.send(data, _left(deadline))
        except OSError as error:
            self._disconnect(str(error) or "it failed")
            return False
        except BaseException:
            self._disconnect("sending was interrupted")
            raise
        return True

    def _pump(self, deadline: float) -> bool:
        """Take in one chunk, and wait for it until `deadline` at most; return False if nothing came."""
        if self._link is None:
            return False
        try:
            data = self._link.receive(_left(deadline))
        except OSError as error:
            self._disconnect(str(error) or "it failed")
            return False
        if data is None:
            return False
        if not data:
            self._disconnect("the server ended it")
            return False
        try:
            due = self._session.receive(data)
        except ProtocolError as error:
            self._disconnect(error.message, error)
            return False
        for on_progress, progress in due:
            on_progress(progress)
        return True

    def _drain(self) -> None:
        """Take in what has arrived, without waiting. It is bounded, because a fast server could go on for ever."""
        for _ in range(_DRAIN_CHUNKS):
            if not self._pump(0.0):
                return

    def _idle(self, seconds: float) -> None:
        """Let wall time pass, and take in samples."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if not self._pump(deadline) and self._link is None:
                time.sleep(max(deadline - time.monotonic(), 0.0))


def _left(deadline: float) -> float | None:
    """Return the time that a link may take, s: None to wait for ever, 0 not to wait."""
    return None if math.isinf(deadline) else max(deadline - time.monotonic(), 0.0)
