"""All that pages meet, made when the first of them knocks: until then a web view costs an open port."""

from __future__ import annotations

from uwserver.adapter import AdapterContext, Peer, Peers
from uwserver_adapters.native.session import Allowance
from uwserver_adapters.web.config import WebConfig
from uwserver_adapters.web.connection import WebConnection
from uwserver_adapters.web.files import Files, page_folder
from uwserver_adapters.web.pages import Pages
from uwserver_adapters.web.service import WebService
from uwserver_adapters.web.site import Site


class Front:
    """The parts of a web view.

    Args:
        config, context: of the adapter.
        token: that pages must show; None where none is needed.
        peers: all connections.

    Attributes:
        service: the native protocol of pages.
        pages: those that are there.
        site: what can be asked by HTTP.
    """

    def __init__(self, config: WebConfig, context: AdapterContext, token: str | None, peers: Peers[Peer]) -> None:
        self._config, self._peers = config, peers
        allowance = Allowance(config.max_subscriptions, config.max_unanswered)
        self.service = WebService(
            context,
            (token, config.view_token),
            config.read_only,
            allowance,
            config.max_requests_per_s,
            peers.refusals,
        )
        leases = self.service.rights.leases
        self.pages = Pages(context, self.service.fanout, leases, config.frames_hz, config.shows_poses)
        self.service.pages = self.pages
        self.site = Site(context, config, Files(page_folder()), self.service, peers.refusals)

    def greet(self) -> WebConnection:
        """A connection for who knocks."""
        return WebConnection(self.service, self.site, self._config, self._peers)

    async def close(self) -> None:
        """Nothing is sent any more."""
        self.pages.close()
        await self.pages.pictures.close()
        await self.service.fanout.close()
        await self.site.close()
