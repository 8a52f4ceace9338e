"""The `web` adapter: listens, and ends in order."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import secrets
from collections.abc import AsyncIterator

from uwserver.adapter import (
    AdapterContext,
    CannotListen,
    Listener,
    Peer,
    Peers,
    address_text,
    is_loopback,
    serve_tcp,
    serving,
    tls_context,
)
from uwserver_adapters.native.session import Allowance
from uwserver_adapters.web.config import WebConfig
from uwserver_adapters.web.connection import WebConnection
from uwserver_adapters.web.files import Files, page_folder
from uwserver_adapters.web.pages import Pages
from uwserver_adapters.web.service import WebService
from uwserver_adapters.web.site import Site

log = logging.getLogger(__name__)

TOKEN_VARIABLE = "UWSERVER_TOKEN"


class WebAdapter:
    """Serves the web view on one TCP port.

    Attributes:
        service: the native protocol of pages.
        pages: those that are there.
        site: what can be asked by HTTP.
        peers: all connections.
    """

    Config = WebConfig

    def __init__(self, config: WebConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context
        token = config.token or os.environ.get(TOKEN_VARIABLE) or None
        self._token_is_new = token is None and not is_loopback(config.bind)
        if self._token_is_new:
            token = secrets.token_hex(24)
        allowance = Allowance(config.max_subscriptions, config.max_unanswered)
        self.service = WebService(
            context, (token, config.view_token), config.read_only, allowance, config.max_requests_per_s
        )
        rights = self.service.rights
        self.pages = Pages(context, self.service.fanout, rights.leases, config.frames_hz, config.shows_poses)
        self.service.pages = self.pages
        refusals = self.service.refusals
        self.site = Site(context, config, Files(page_folder()), self.service, refusals)
        self.peers: Peers[Peer] = Peers(config.max_pages, refusals, context.stats, strangers=config.max_strangers)

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: see there.
        """
        async with self._listening() as server:
            scheme = "http" if self.config.tls_cert is None else "https"
            bind = self.config.bind
            host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(bind, bind)
            fragment = f"#token={self.service.token}" if self._token_is_new else ""
            address = f"{scheme}://{address_text(host, server.port)}/"
            try:
                with serving(self.context, self.pages, address, ready):
                    if self._token_is_new:
                        log.warning(
                            "%s can be reached from outside at %s, and no token was set (token, or %s): one was made for this run. Open\n    %s%s",
                            self.context.name, bind, TOKEN_VARIABLE, address, fragment,
                        )  # fmt: skip
                    await asyncio.get_running_loop().create_future()  # until cancelled
            finally:
                server.close()
                self.pages.close()
                await self.site.close()

    @contextlib.asynccontextmanager
    async def _listening(self) -> AsyncIterator[Listener]:
        """The port, or the first free one of several."""
        config = self.config
        tls = tls_context(config.tls_cert, config.tls_key, config.tls_client_ca)
        async with contextlib.AsyncExitStack() as stack:
            for port in config.ports:
                listening = serve_tcp(
                    self._greet, self.peers, config.bind, port, tls=tls, handshake_s=config.hello_timeout_s
                )
                try:
                    server = await stack.enter_async_context(listening)
                    break
                except CannotListen as error:
                    if port == config.ports[-1] or "in use" not in str(error):
                        raise
            yield server

    def _greet(self) -> WebConnection:
        return WebConnection(self.service, self.site, self.config, self.peers)
