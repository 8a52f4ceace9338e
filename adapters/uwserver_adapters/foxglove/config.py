"""The adapter's table in a scenario."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from uwserver.adapter import TokenTable, is_loopback
from uwserver.table import Count, Name, PortNumber


class FoxgloveConfig(TokenTable, tag="foxglove", kw_only=True, frozen=True):
    """Attributes:
    port: TCP port; the default is where Foxglove looks; 0 takes a free one.
    token: clients show it as the path of the address (ws://host:8765/TOKEN), the only place where they can; default: the environment's
        UWSERVER_TOKEN where bind is not loopback. If there is none then, a token is generated and printed.
    read_only: clients may only watch: they cannot command, call services that change something, or set parameters.
    exact_poses: show clients the true poses of vehicles, which are ground truth; default: on loopback.
    allowed_origins: pages that may connect and command: an origin ("http://localhost:8000"), an origin with ":*" for any port, or "*" for all;
        by default none may.
    watching_origins: pages that may connect and watch, and control a recording that is played, but change nothing else. Default: Foxglove in a
        browser, the desktop programs, and pages of this machine.
    allowed_hosts: names of this server that clients may use, besides its addresses and localhost; "*" for any.
    tls_cert: certificate (PEM); with it, the address begins with wss. A relative path starts from the folder in which the server was started.
    frames_hz: most poses and times in a second of wall time.
    max_clients: most clients at a time.
    max_requests_per_s: most requests of one client; it is not read for a while after more.
    max_subscriptions: most subscriptions of one client.
    max_unanswered: most commands and calls of one client that wait for the world.
    queue_messages, queue_bytes: most messages and bytes that wait for a slow client. Above them samples are dropped; if other messages alone
        are too many, the client is disconnected.
    """

    port: PortNumber = 8765
    read_only: bool = False
    exact_poses: bool | UnsetType = UNSET
    watching_origins: tuple[Name, ...] = (
        "https://app.foxglove.dev",
        "file://",
        "http://localhost:*",
        "http://127.0.0.1:*",
    )
    frames_hz: Annotated[float, Meta(gt=0, le=120)] = 30.0
    max_clients: Count = 32
    max_requests_per_s: Count = 1000
    max_subscriptions: Count = 1024
    max_unanswered: Count = 256
    queue_messages: Count = 1024
    queue_bytes: Count = 16 << 20

    @property
    def shows_poses(self) -> bool:
        """Whether poses are shown: `exact_poses`, or its default."""
        return is_loopback(self.bind) if isinstance(self.exact_poses, UnsetType) else self.exact_poses
