"""The adapter `morse`: the socket protocol of the simulator MORSE, for pymorse, old scripts, and ArduPilot's MORSE backend."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Collection, Sequence
from functools import partial

from uwserver.adapter import (
    AdapterBase,
    AdapterContext,
    CannotListen,
    Peers,
    TcpListener,
    address_text,
    serve_tcp,
    serving,
)
from uwserver.ports import Event, Json, Sample
from uwserver_adapters.morse.autopilot import Autopilot
from uwserver_adapters.morse.config import MorseConfig
from uwserver_adapters.morse.connections import Requests, Stream
from uwserver_adapters.morse.stage import Component, Stage, check_names

TRIES = 64
"""Ports that are tried for a stream while those before are in use."""
WATCH_S = 0.2
"""Wall time between two looks for new components, which need streams."""


class MorseAdapter(AdapterBase[MorseConfig]):
    """Serves requests on one port, and a stream for each component.

    Attributes:
        stage: what all clients share.
    """

    Config = MorseConfig

    def __init__(self, config: MorseConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self.stage = Stage(context, config.component_of)
        self._peers: Peers[Requests | Stream] = Peers(config.max_clients, self.refusals, context.stats)
        self._autopilot: Autopilot | None = None
        self._count = 0
        self._next_port = config.stream_port

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: an address cannot be had, or it is not loopback and the table does not allow that.
            CannotServe: the table names what is not there.
        """
        config, context = self.config, self.context
        config.check_bind("MORSE's protocol")
        check_names(config.component_of, context.ports)
        async with contextlib.AsyncExitStack() as stack:
            server = await stack.enter_async_context(
                serve_tcp(self._requests, self._peers, config.bind, config.port, rival="MORSE")
            )
            await self._listen(stack)
            if config.ardupilot is not None:
                self._autopilot = Autopilot(config.ardupilot, config, context)
                await stack.enter_async_context(self._autopilot.serving())
            with serving(context, self, address_text(config.bind, server.port), ready):
                while True:
                    await asyncio.sleep(WATCH_S)
                    await self._listen(stack)

    # -- streams --------------------------------------------------------------------------------------------------------------------------

    async def _listen(self, stack: contextlib.AsyncExitStack) -> None:
        """Open a stream for each component that has none yet."""
        ports = self.stage.stream_ports
        for name in list(self.stage.components):
            if name not in ports:
                ports[name] = (await self._listener(stack, name)).port
        streams: dict[str, Json] = {**ports}
        self.context.stats.details["streams"] = streams

    async def _listener(self, stack: contextlib.AsyncExitStack, name: str) -> TcpListener:
        make = partial(self._stream, name)
        for attempt in range(TRIES):
            port = self._next_port
            if port:
                self._next_port += 1
            try:
                return await stack.enter_async_context(
                    serve_tcp(make, self._peers, self.config.bind, port, key="stream_port", rival="MORSE")
                )
            except CannotListen:
                if attempt == TRIES - 1:
                    raise
        raise AssertionError("unreachable")

    def _requests(self) -> Requests:
        return Requests(self.stage, self.config, self._peers, self._name("client"))

    def _stream(self, name: str) -> Stream:
        # The component of a removed vehicle is gone, but its port still listens.
        component = self.stage.components.get(name) or Component(name, "gone", None, "port", (), "")
        return Stream(self.stage, component, self.config, self._peers, self._name(name))

    def _name(self, of: str) -> str:
        self._count += 1
        return f"{of}#{self._count}"

    # -- uwserver.adapter.Subscriber ------------------------------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports that streams and autopilot need."""
        return {*self.stage.subscriptions, *(self._autopilot.subscriptions if self._autopilot is not None else ())}

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send samples of a tick."""
        self.stage.put_samples(samples)
        if self._autopilot is not None:
            self._autopilot.put_samples(samples)

    def put_event(self, event: Event) -> None:
        """Follow vehicles that come and go, and a reset."""
        if event.event in ("ports_changed", "reset"):
            self.stage.refresh()
            self.context.subscriptions_changed()
