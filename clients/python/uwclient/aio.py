"""The asyncio client, with the methods of `uwclient.sync.Client` as coroutines. One task reads the connection."""

from __future__ import annotations

import asyncio
import contextlib
import math
import ssl
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from functools import partial
from types import TracebackType
from typing import TypeVar

from uwclient import verbs
from uwclient.base import SessionView
from uwclient.errors import CallRefused, ConnectionLost, ProtocolError, Timeout
from uwclient.link import AsyncDial, AsyncLink, dial_stream
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


class AsyncClient(SessionView):
    """A connection to a uwserver. Make one with `await AsyncClient.connect(...)` or `connect_zenoh_async` in a running loop.

    Any number of tasks may use it at once. Timeouts, reconnection and errors are those of `Client`. If the task that waits for a call or a
    step is cancelled, the call or step is cancelled on the server too.
    """

    def __init__(self, settings: Settings, dial: AsyncDial) -> None:
        super().__init__(settings)
        self._dial = dial
        self._link: AsyncLink | None = None
        self._reading: asyncio.Task[None] | None = None
        self._connecting = asyncio.Lock()
        self._news = asyncio.Event()

    @classmethod
    async def connect(
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
    ) -> AsyncClient:
        """Connect, trying again until `timeout`. Arguments and errors are those of `Client.connect`."""
        settings = Settings(host, port, name, token, encoding, timeout, reconnect, tls=tls)
        return await cls.over(partial(dial_stream, host, port, tls), settings.with_token_from_environment())

    @classmethod
    async def over(cls, dial: AsyncDial, settings: Settings) -> AsyncClient:
        """Connect through the link that `dial` makes, as `connect` does through TCP."""
        client = cls(settings, dial)
        await client._open(time.monotonic() + settings.timeout)
        return client

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """End the connection. Every later operation raises ConnectionLost."""
        self._closed = True
        await self._disconnect("the client was closed")

    async def describe(self, pattern: str = "**") -> Description:
        """Ask for the matching ports and the services. Without a pattern, `ports` and `services` are updated."""
        description = await self._run(verbs.describe(pattern))
        if pattern == "**":
            self._session.described(description)
        return description

    # Samples

    async def subscribe(
        self,
        pattern: str,
        *,
        rate_hz: float | None = None,
        fields: Sequence[str] | None = None,
        delivery: str | None = None,
        pictures: str | None = None,
    ) -> Subscription:
        """Ask for the samples of every matching port. Arguments are those of `Client.subscribe`."""
        verb = verbs.subscribe(pattern, subscribe_options(rate_hz, fields, delivery, pictures))
        subscription = await self._run(verb)
        self._session.subscribed(verb)
        return subscription

    async def unsubscribe(self, pattern: str) -> int:
        """End the subscriptions that were made with this pattern, and return how many there were."""
        self._session.unsubscribed(pattern)
        return await self._run(verbs.unsubscribe(pattern))

    async def read(self, port: str | None = None, timeout: float | None = None) -> Sample:
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
                await self._ensure(deadline)
            else:
                await self._wait(deadline)

    def latest(self, port: str) -> Sample | None:
        """Return the newest sample of a port that has arrived, or None before the first."""
        return self._session.latest(port)

    async def samples(self, port: str | None = None) -> AsyncIterator[Sample]:
        """Iterate over samples as they come, of one port if it is given, until the client is closed. It waits without limit."""
        while not self._closed:
            try:
                sample = await self.read(port, math.inf)
            except ConnectionLost:
                if self._closed:
                    return
                raise
            yield sample

    def __aiter__(self) -> AsyncIterator[Sample]:
        return self.samples()

    # Commands and calls

    async def send(self, port: str, value: Mapping[str, object] | None = None, /, **fields: object) -> Ack:
        """Command an actuator and wait for the tick at which it is applied; see `Client.send`."""
        verb = await self._command(port, {**(value or {}), **fields})
        return await self._run(verb)

    async def send_nowait(self, port: str, value: Mapping[str, object] | None = None, /, **fields: object) -> None:
        """Command an actuator without waiting for an answer. Refusals of the server are in `refusals`."""
        verb = await self._command(port, {**(value or {}), **fields})
        deadline = time.monotonic() + self._timeout
        await self._ensure(deadline)
        await self._write(self._session.notification(verb), deadline)

    async def call(
        self,
        service: str,
        args: Mapping[str, object] | None = None,
        /,
        *,
        on_progress: OnProgress | None = None,
        timeout: float | None = None,
        **more: object,
    ) -> object:
        """Call a service and return its value; see `Client.call`. `on_progress` is a plain function."""
        return await self._run(self._session.call(service, {**(args or {}), **more}), timeout, on_progress)

    async def cancel(self, request: RequestId) -> bool:
        """Cancel an unfinished call or step of this client by the id in its Progress. It then fails with `preempted`."""
        return await self._run(verbs.cancel(request))

    async def step(self, n: int = 1, timeout: float | None = None) -> Ack:
        """Run n ticks of a paused world, or grant n ticks in lockstep. Without a timeout it waits without limit."""
        return await self._run(verbs.step(n), timeout)

    async def pause(self) -> Ack:
        """Stop the simulation time."""
        return await self._run(verbs.acknowledged("world/pause"))

    async def resume(self) -> Ack:
        """Let the simulation time run on."""
        return await self._run(verbs.acknowledged("world/resume"))

    async def reset(self) -> Ack:
        """Reset the world to the start of the scenario."""
        return await self._run(verbs.acknowledged("world/reset"))

    async def status(self) -> dict[str, object]:
        """Return the value of world/status, which always has `tick` and `t_ns`."""
        return await self._run(verbs.status())

    async def wait_until(self, t_s: float, timeout: float | None = None) -> float:
        """Wait until the simulation time reaches `t_s` seconds; see `Client.wait_until`."""
        limit = math.inf if timeout is None else timeout
        deadline = time.monotonic() + limit
        asked = False
        while True:
            status = await self.status()
            if time_reached(status, t_s):
                return time_s(status)
            left = deadline - time.monotonic()
            if left <= 0:
                raise Timeout(f"the simulation did not reach {t_s:g} s within {limit:g} s", code="timeout")
            if is_paused(status) and not asked:
                asked = True
                await self._run(verbs.run_until(t_s, self.services.get("world/run_until")), left)
            else:
                await asyncio.sleep(min(POLL_S, left))

    # The shell around the session

    async def _command(self, port: str, fields: Mapping[str, object]) -> Verb[Ack]:
        if self._session.stale or port not in self.ports:
            await self.describe()
        return self._session.command(port, fields)

    async def _run(self, verb: Verb[T], timeout: float | None = None, on_progress: OnProgress | None = None) -> T:
        limit = math.inf if timeout is None and verb.waits else self._limit(timeout)[0]
        deadline = time.monotonic() + limit
        await self._ensure(deadline)
        return await self._exchange(verb, limit, deadline, on_progress)

    async def _exchange(self, verb: Verb[T], limit: float, deadline: float, on_progress: OnProgress | None = None) -> T:
        pending = self._session.request(verb, on_progress)
        try:
            await self._write(pending.data, deadline)
            while not pending.done:
                if time.monotonic() >= deadline:
                    raise self._session.late(verb, limit)
                await self._wait(deadline)
        finally:
            self._give_up(pending)
        return pending.value()

    def _give_up(self, pending: Pending[T]) -> None:
        data = self._session.give_up(pending)
        if data and self._link is not None:
            self._link.write(data)

    async def _wait(self, deadline: float) -> None:
        """Wait for anything to arrive or the connection to end, until `deadline` at most."""
        # Cleared in the same step of the loop in which the caller has looked, so that nothing is missed.
        self._news.clear()
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._news.wait(), _left(deadline))

    async def _ensure(self, deadline: float) -> None:
        async with self._connecting:
            if self._closed:
                raise self._session.unsent("the client is closed")
            if self._link is None:
                if not self._session.settings.reconnect:
                    raise self._session.unsent("the connection was lost and reconnect is off")
                await self._open(min(deadline, time.monotonic() + self._timeout))
                self.reconnects += 1
            self._session.raise_lost_subscription()

    async def _open(self, deadline: float) -> None:
        for pause in pauses():
            try:
                await self._attempt(deadline)
                return
            except (OSError, ConnectionLost, Timeout, asyncio.TimeoutError) as error:
                reason = error
            if isinstance(reason, ssl.SSLCertVerificationError):
                raise self._session.unreachable(reason) from reason
            if time.monotonic() + pause >= deadline:
                raise self._session.unreachable(reason) from reason
            await asyncio.sleep(pause)

    async def _attempt(self, deadline: float) -> None:
        left = max(deadline - time.monotonic(), 0.001)
        self._link = link = await self._dial(left)
        self._session.restart()
        self._reading = asyncio.ensure_future(self._read(link))
        try:
            await self._exchange(self._session.hello(), left, deadline)
            self._session.described(await self._exchange(verbs.describe(), left, deadline))
            for verb in self._session.subscriptions():
                try:
                    await self._exchange(verb, left, deadline)
                except CallRefused as error:
                    self._session.subscription_refused(verb, error)
        except BaseException:
            await self._disconnect("the greeting failed")
            raise

    async def _read(self, link: AsyncLink) -> None:
        reason, fault = "the server ended it", None
        try:
            while data := await link.read():
                for on_progress, progress in self._session.receive(data):
                    # Through the loop, so that an exception in it is reported there, and does not end this task.
                    asyncio.get_running_loop().call_soon(on_progress, progress)
                self._news.set()
        except OSError as error:
            reason = str(error) or "it failed"
        except ProtocolError as error:
            reason, fault = error.message, error
        if self._link is link:
            self._forget_connection(reason, fault)

    def _forget_connection(self, reason: str, fault: ProtocolError | None = None) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
        self._session.lost(reason, fault)
        self._news.set()

    async def _disconnect(self, reason: str) -> None:
        link, reading = self._link, self._reading
        self._reading = None
        self._forget_connection(reason)
        if reading is not None:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
        if link is not None:
            await link.wait_closed()

    async def _write(self, data: bytes, deadline: float) -> None:
        """Write `data`, and wait while too much is unsent. A loss of the connection is reported through the session."""
        if self._link is None:
            self._session.lost("it was closed")
            return
        self._link.write(data)
        try:
            await asyncio.wait_for(self._link.drain(), _left(deadline))
        except asyncio.TimeoutError:  # before OSError, of which it is a subclass from Python 3.11 on
            self._forget_connection("the server takes no more data")
        except OSError as error:
            self._forget_connection(str(error) or "it failed")


def _left(deadline: float) -> float | None:
    """Return the time until the deadline for `wait_for`, s; None to wait for ever."""
    return None if math.isinf(deadline) else max(deadline - time.monotonic(), 0.0)
