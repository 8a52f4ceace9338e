"""The `web` adapter: listens, and stops in order. The parts that pages need are loaded with the first connection."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Collection, Sequence
from typing import TYPE_CHECKING

from uwserver.adapter import (
    AdapterBase,
    AdapterContext,
    CannotListen,
    Decimations,
    Peer,
    Peers,
    TcpListener,
    address_text,
    host_here,
    is_loopback,
    known_token,
    serve_tcp,
    serving,
    token_for,
)
from uwserver.ports import Event, Sample
from uwserver_adapters.web.config import WebConfig

if TYPE_CHECKING:
    from uwserver_adapters.web.connection import Front


class WebAdapter(AdapterBase[WebConfig]):
    """Serves the web view on one TCP port. It is its own `Subscriber`.

    Attributes:
        peers: all connections.
    """

    Config = WebConfig

    def __init__(self, config: WebConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        # A token for watching protects nothing while a page without any token may do everything.
        self._token = token_for(known_token(config.token), config.needs_token)
        self.peers: Peers[Peer] = Peers(
            config.max_pages, self.refusals, context.stats, strangers=config.max_strangers, key="max_pages"
        )
        self._front: Front | None = None

    @property
    def token(self) -> str | None:
        """Token that pages must show; None where none is needed."""
        return self._token.text

    @property
    def front(self) -> Front:
        """Everything that serves pages, made at the first use."""
        if self._front is None:
            from uwserver_adapters.web.connection import Front

            self._front = Front(self.config, self.context, self.token, self.peers)
        return self._front

    def _greet(self) -> asyncio.Protocol:
        return self.front.greet()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: the port cannot be bound.
        """
        async with self._listening() as server:
            address = self._address(server.port)
            try:
                with serving(self.context, self, address, ready):
                    reason = (
                        "has a view_token"
                        if is_loopback(self.config.bind)
                        else f"listens at {self.config.bind}, which other machines can reach"
                    )
                    self._token.announce(self.context, reason, f"Open\n    {address}#token={self.token}")
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                if self._front is not None:
                    await self._front.close()

    def _address(self, port: int) -> str:
        scheme = "http" if self.config.tls_cert is None else "https"
        return f"{scheme}://{address_text(host_here(self.config.bind), port)}/"

    @contextlib.asynccontextmanager
    async def _listening(self) -> AsyncIterator[TcpListener]:
        """Listen at the port, or at the first free one of several."""
        config = self.config
        tls = config.tls()
        async with contextlib.AsyncExitStack() as stack:
            for port in config.ports:
                listening = serve_tcp(
                    self._greet,
                    self.peers,
                    config.bind,
                    port,
                    tls=tls,
                    handshake_s=config.hello_timeout_s,
                )
                try:
                    server = await stack.enter_async_context(listening)
                    break
                except CannotListen:
                    if port == config.ports[-1]:
                        raise
            yield server

    # -- samples and events ---------------------------------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> Collection[str]:
        """Ports that pages read."""
        return () if self._front is None else self._front.pages.subscriptions

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Pass the samples of a tick to the pages."""
        if self._front is not None:
            self._front.pages.put_samples(samples)

    @property
    def decimations(self) -> Decimations:
        """Ports of which pages do not need all samples."""
        return {} if self._front is None else self._front.pages.decimations

    def send_samples(self) -> None:
        """Send the samples of the last ticks together."""
        if self._front is not None:
            self._front.pages.send_samples()

    def put_event(self, event: Event) -> None:
        """Tell every page of an event."""
        if self._front is not None:
            self._front.pages.put_event(event)
