"""Everything that serves pages. It is made with the first connection, so until then a web view costs only an open port."""

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
        config, context: the adapter's table and context.
        token: token that pages must show; None where none is needed.
        peers: all connections.

    Attributes:
        service: the native protocol for pages.
        pages: the open pages.
        site: the answers to HTTP requests.
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
        """Return the protocol for a new connection."""
        return WebConnection(self.service, self.site, self._config, self._peers)

    async def close(self) -> None:
        """Send nothing more, and end all threads and tasks."""
        self.pages.close()
        await self.pages.pictures.close()
        await self.service.fanout.close()
        await self.site.close()
