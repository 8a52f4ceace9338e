"""The table of the adapter `web` in a scenario."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from uwserver.adapter import is_loopback
from uwserver.table import Count, Name, PortNumber
from uwserver_adapters.native.outbox import OutboxTable

FIRST_PORT = 7680
PORTS = 20
"""Number of ports that are tried, from the first on."""


class WebConfig(OutboxTable, tag="web", kw_only=True, frozen=True):
    """Attributes:
    required: whether the server ends when the view cannot start.
    port: TCP port; 0 takes a free one; default: 7680, or the next free one.
    token: token that pages must show; default: the environment's UWSERVER_TOKEN, or one that is generated and logged if one is needed.
    view_token: a page that shows this token instead may only watch; a token is needed then.
    read_only: all pages may only watch.
    exact_poses: show pages the true poses of vehicles, which are ground truth; default: on loopback.
    allowed_hosts: names by which browsers may address this server, besides its addresses and localhost; "*" for any.
    allowed_origins: other pages that may connect to the live data: an origin ("http://localhost:8000"), an origin with ":*" for any port, or "*"
        for all; by default none may.
    frame_ancestors: origins of pages that may show the view in a frame; default: none.
    tls_cert: certificate (PEM); with it, the address is https. A relative path starts from the folder in which the server was started.
    frames_hz: most states that are sent per second of wall time.
    max_pages: pages at a time.
    max_strangers: other connections at a time, for files or not admitted yet; a new one closes the oldest.
    max_requests_per_s: requests of one page per second; more are refused.
    max_unanswered: commands and calls of one page that wait for the world.
    max_subscriptions: subscriptions of one page.
    hello_timeout_s: wall time in which a request must be complete, and a token shown.
    """

    required: bool = False
    port: PortNumber | UnsetType = UNSET
    view_token: Name | None = None
    read_only: bool = False
    exact_poses: bool | UnsetType = UNSET
    frame_ancestors: tuple[Name, ...] = ()
    frames_hz: Annotated[float, Meta(gt=0, le=120)] = 30.0
    max_pages: Count = 50
    max_strangers: Count = 256
    max_requests_per_s: Count = 2000
    max_unanswered: Count = 256
    max_subscriptions: Count = 256
    queue_samples: Count = 256
    queue_bytes: Count = 4 << 20

    @property
    def ports(self) -> tuple[int, ...]:
        """Ports to try, in this order."""
        if isinstance(self.port, UnsetType):
            return tuple(range(FIRST_PORT, FIRST_PORT + PORTS))
        return (self.port,)

    @property
    def needs_token(self) -> bool:
        """Whether a token is generated when none is given."""
        return self.view_token is not None or not is_loopback(self.bind)

    @property
    def shows_poses(self) -> bool:
        """Whether pages see true poses: `exact_poses`, or its default."""
        return is_loopback(self.bind) if isinstance(self.exact_poses, UnsetType) else self.exact_poses
