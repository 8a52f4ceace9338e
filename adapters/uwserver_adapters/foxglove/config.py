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
    port: TCP port, where Foxglove looks by default; 0 takes a free one.
    token: clients show it as the path of the address (ws://host:8765/TOKEN), for they can send no other; default: the environment's
        UWSERVER_TOKEN where bind is not loopback; one is made and told where there is none then.
    read_only: clients may only watch: no commands, no services that change something, no parameters set.
    exact_poses: clients see where vehicles really are, which is ground truth; default: on loopback.
    allowed_origins: pages that may connect and command, as for `sockets`; by default none may.
    watching_origins: pages that may connect and watch, and steer a recording that is played, but change nothing else. Default: Foxglove in a
        browser, the desktop programs, and pages of this machine.
    allowed_hosts: names by which this server may be asked, beside its addresses and localhost; "*" for any.
    tls_cert, tls_key, tls_client_ca: as for `sockets`; the address is wss then.
    frames_hz: poses and times a second of wall time, at most.
    max_clients: at a time.
    max_requests_per_s: of one client; more are refused.
    max_subscriptions: of one client.
    max_unanswered: commands and calls of one client that wait for the world.
    queue_messages, queue_bytes: that wait for a slow client; of samples the oldest is dropped then, of all else it is too slow and is sent away.
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
        """`exact_poses`, or its default."""
        return is_loopback(self.bind) if isinstance(self.exact_poses, UnsetType) else self.exact_poses
