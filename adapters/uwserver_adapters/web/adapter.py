"""The `web` adapter: listens, and stops in order. The parts that pages need are loaded with the first connection."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Collection, Sequence
from typing import TYPE_CHECKING

from uwserver.adapter import (
    TOKEN_VARIABLE,
    AdapterContext,
    CannotListen,
    Listener,
    Peer,
    Peers,
    Refusals,
    Thinned,
    address_text,
    is_loopback,
    known_token,
    serve_tcp,
    serving,
    tls_context,
    token_for,
)
from uwserver.ports import Event, Sample
from uwserver_adapters.web.config import WebConfig

if TYPE_CHECKING:
    from uwserver_adapters.web.front import Front

log = logging.getLogger(__name__)


class WebAdapter:
    """Serves the web view on one TCP port. It is its own `Subscriber`.

    Attributes:
        peers: all connections.
    """

    Config = WebConfig

    def __init__(self, config: WebConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        # A token for watching protects nothing while a page without any token may do everything.
        self._token = token_for(known_token(config.token), config.needs_token)
        refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        self.peers: Peers[Peer] = Peers(
            config.max_pages, refusals, context.stats, strangers=config.max_strangers, key="max_pages"
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
            from uwserver_adapters.web.front import Front

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
                    if self._token.is_new:
                        log.warning(
                            "%s %s, and no token was set (token, or %s): one was generated for this run. Open\n    %s#token=%s",
                            self.context.name, self._reason(), TOKEN_VARIABLE, address, self.token,
                        )  # fmt: skip
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                if self._front is not None:
                    await self._front.close()

    def _reason(self) -> str:
        """Return why a token is needed."""
        return "has a view_token" if is_loopback(self.config.bind) else "can be reached from elsewhere"

    def _address(self, port: int) -> str:
        scheme = "http" if self.config.tls_cert is None else "https"
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.config.bind, self.config.bind)
        return f"{scheme}://{address_text(host, port)}/"

    @contextlib.asynccontextmanager
    async def _listening(self) -> AsyncIterator[Listener]:
        """Listen at the port, or at the first free one of several."""
        config = self.config
        tls = tls_context(config.tls_cert, config.tls_key, config.tls_client_ca)
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
    def wanted(self) -> Collection[str]:
        """Ports that pages read."""
        return () if self._front is None else self._front.pages.wanted

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Pass the samples of a tick to the pages."""
        if self._front is not None:
            self._front.pages.put_samples(samples)

    @property
    def thinned(self) -> Thinned:
        """Ports of which pages do not need all samples."""
        return {} if self._front is None else self._front.pages.thinned

    def send_samples(self) -> None:
        """Send the samples of the last ticks together."""
        if self._front is not None:
            self._front.pages.send_samples()

    def put_event(self, event: Event) -> None:
        """Tell every page of an event."""
        if self._front is not None:
            self._front.pages.put_event(event)
