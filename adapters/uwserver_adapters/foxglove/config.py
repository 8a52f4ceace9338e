"""The adapter's table in a scenario."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from uwserver.adapter import AdapterTable, is_loopback
from uwserver.table import Name, Positive

_Count = Annotated[int, Meta(ge=1)]


class FoxgloveConfig(AdapterTable, tag="foxglove", kw_only=True, frozen=True):
    """Attributes:
    bind: address to listen at; anything but loopback needs a token.
    port: TCP port; the default is where Foxglove looks; 0 takes a free one.
    token: clients show it as the path of the address (ws://host:8765/TOKEN), the only place where they can; default: the environment's
        UWSERVER_TOKEN where bind is not loopback. If there is none then, a token is generated and printed.
    read_only: clients may only watch: they cannot command, call services that change something, or set parameters.
    exact_poses: show clients the true poses of vehicles, which are ground truth; default: on loopback.
    allowed_origins: pages that may connect and command, as for `sockets`; by default none may.
    watching_origins: pages that may connect and watch, and control a recording that is played, but change nothing else. Default: Foxglove in a
        browser, the desktop programs, and pages of this machine.
    allowed_hosts: names of this server that clients may use, besides its addresses and localhost; "*" for any.
    tls_cert, tls_key, tls_client_ca: as for `sockets`; the address then begins with wss.
    frames_hz: most poses and times in a second of wall time.
    max_clients: most clients at a time.
    max_requests_per_s: most requests of one client; it is not read for a while after more.
    max_subscriptions: most subscriptions of one client.
    max_unanswered: most commands and calls of one client that wait for the world.
    queue_messages, queue_bytes: most messages and bytes that wait for a slow client. Above them samples are dropped; if other messages alone
        are too many, the client is disconnected.
    """

    bind: Name = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 8765
    token: Name | None = None
    read_only: bool = False
    exact_poses: bool | UnsetType = UNSET
    allowed_origins: tuple[Name, ...] = ()
    watching_origins: tuple[Name, ...] = (
        "https://app.foxglove.dev",
        "file://",
        "http://localhost:*",
        "http://127.0.0.1:*",
    )
    allowed_hosts: tuple[Name, ...] = ()
    tls_cert: Name | None = None
    tls_key: Name | None = None
    tls_client_ca: Name | None = None
    frames_hz: Annotated[float, Meta(gt=0, le=120)] = 30.0
    max_clients: _Count = 32
    max_requests_per_s: _Count = 1000
    max_subscriptions: _Count = 1024
    max_unanswered: _Count = 256
    queue_messages: _Count = 1024
    queue_bytes: _Count = 16 << 20
    hello_timeout_s: Positive = 10.0

    @property
    def shows_poses(self) -> bool:
        """Whether poses are shown: `exact_poses`, or its default."""
        return is_loopback(self.bind) if isinstance(self.exact_poses, UnsetType) else self.exact_poses
