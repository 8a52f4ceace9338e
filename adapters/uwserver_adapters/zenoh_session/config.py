"""The adapter's table in a scenario, and what it means for a zenoh session. Imports no zenoh: a scenario is checked without it."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from msgspec import Meta, field

from uwserver.adapter import AdapterTable, EncodingName
from uwserver.table import Name, Positive

Endpoint = Annotated[str, Meta(pattern=r"^[a-z0-9_]+/.+$")]

KNOWN_ENDPOINT = "tcp/127.0.0.1:7447"
FREE_ENDPOINT = "tcp/127.0.0.1:0"


class ZenohConfig(AdapterTable, tag="zenoh", kw_only=True, frozen=True):
    """Attributes:
    mode: peer; client of a router; or router, so that clients need no other one.
    listen: endpoints such as "tcp/0.0.0.0:7447"; default: "tcp/127.0.0.1:7447", where zenoh's clients look (a peer with `connect`:
        a free loopback port; a client: none). Port 0 (tcp, tls) takes a free one.
    connect: endpoints of routers or peers; tried again for ever. Default: none; of a client without `scouting` "tcp/127.0.0.1:7447".
    scouting: find each other by multicast, which reaches the whole local network; default: off (or as `config_file` says).
    encoding: of samples, events, and answers to requests without a payload.
    server: name in the keys; default: the server's own. Must be the only one of that name in the network.
    prefix: first levels of all keys.
    call_timeout_s: wall time after which the long-running call of an unnamed caller is cancelled, as zenoh tells nobody that it went.
    queue_requests: commands and calls that may wait for the loop; more are dropped and counted.
    config_file: zenoh configuration (JSON5 or YAML) to begin with: TLS, access control, and all else.
    config: single zenoh settings by their path, over everything else: "transport/link/tls/root_ca_certificate" = "ca.pem".
    """

    mode: Literal["peer", "client", "router"] = "peer"
    listen: tuple[Endpoint, ...] | None = None
    connect: tuple[Endpoint, ...] = ()
    scouting: bool | None = None
    encoding: EncodingName = "json"
    server: Name | None = None
    prefix: Name = "uw"
    call_timeout_s: Positive = 10.0
    queue_requests: Annotated[int, Meta(ge=1)] = 4096
    config_file: Name | None = None
    config: dict[str, Any] = field(default_factory=dict)

    def needs(self) -> Mapping[str, str]:
        """The package of zenoh itself."""
        return {"zenoh": "uwserver"}


def endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Where the session listens, with free ports in the place of TCP port 0."""
    listen = config.listen
    if listen is None:
        peer = FREE_ENDPOINT if config.connect or config.scouting else KNOWN_ENDPOINT
        listen = {"peer": (peer,), "router": (KNOWN_ENDPOINT,), "client": ()}[config.mode]
    return tuple(map(_with_free_port, listen))


def settings(config: ZenohConfig, listen: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Path and JSON of each zenoh setting, in the order in which they are made. Without `config_file` all of them, else those that were given."""
    scouting = config.scouting
    if scouting is None and config.config_file is None:
        scouting = False
    connect = config.connect
    if config.mode == "client" and not connect and not scouting:
        connect = (KNOWN_ENDPOINT,)
    ours: dict[str, object] = {
        "mode": config.mode,
        # Shared memory would leave a watchdog thread and segments behind.
        "transport/shared_memory/enabled": False,
        # A sample that finds the queue full is dropped soon: to wait would stop the loop. Not at once: the fragments of a large one need
        # the moment (us) in which the queue is emptied.
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 50,
        # Room for a megabyte of samples, the most zenoh allows: a busy tick or a 1 MB sample is no reason to drop.
        "transport/link/tx/queue/size/data": 16,
        # Closing a session waits for handshakes with peers that do not speak: for ten seconds, were it not for these. For slow
        # links `config` can allow more.
        "transport/unicast/accept_timeout": 700,
        "transport/unicast/open_timeout": 700,
        # Within two seconds after a router is back (zenoh's own default is up to four).
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    if config.listen is not None or config.config_file is None:
        ours["listen/endpoints"] = list(listen)
    if config.connect or config.config_file is None:
        ours["connect/endpoints"] = list(connect)
    if scouting is not None:
        ours["scouting/multicast/enabled"] = scouting
    for path, value in (*ours.items(), *_leaves(config.config)):
        yield path, json.dumps(value)


def is_exposed(config: ZenohConfig, listen: tuple[str, ...]) -> bool:
    """Whether others than this machine can reach it though nothing restricts them (as far as this table tells)."""
    local = ("127.", "localhost", "[::1]")
    reachable = any(not _host(endpoint).startswith(local) for endpoint in listen)
    guarded = config.config_file is not None or any(
        path.split("/")[0] == "access_control" or "/tls" in path or "/auth" in path
        for path, _ in _leaves(config.config)
    )
    return reachable and not guarded


def _leaves(table: Mapping[str, Any], under: str = "") -> Iterator[tuple[str, Any]]:
    """Nested tables are paths, too; zenoh sets leaf by leaf."""
    for name, value in table.items():
        path = f"{under}{name}".strip("/")
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{path}/")
        else:
            yield path, value


def _host(endpoint: str) -> str:
    return endpoint.partition("/")[2]


def _with_free_port(endpoint: str) -> str:
    address, mark, rest = endpoint.partition("#")
    if not (address.startswith(("tcp/", "tls/")) and address.endswith(":0")):
        return endpoint
    protocol, _, place = address.partition("/")
    host = place[: -len(":0")]
    # zenoh would take a free port, too, but has no way to tell which.
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    with socket.socket(family) as probe:
        probe.bind((host.strip("[]"), 0))
        return f"{protocol}/{host}:{probe.getsockname()[1]}{mark}{rest}"
