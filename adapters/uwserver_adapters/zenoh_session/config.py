"""The adapter's table in a scenario, and the zenoh settings that follow from it. zenoh is not imported, so that a scenario is checked without it."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from msgspec import Meta, field

from uwserver.adapter import AdapterTable, EncodingName
from uwserver.table import Count, Name, Positive

Endpoint = Annotated[str, Meta(pattern=r"^[a-z0-9_]+/.+$")]

KNOWN_ENDPOINT = "tcp/127.0.0.1:7447"
FREE_ENDPOINT = "tcp/127.0.0.1:0"


class ZenohConfig(AdapterTable, tag="zenoh", kw_only=True, frozen=True):
    """Attributes:
    mode: peer; client of a router; or router, which clients can use as theirs.
    listen: endpoints such as "tcp/0.0.0.0:7447"; default: "tcp/127.0.0.1:7447", where zenoh's clients look (a peer with `connect`:
        a free loopback port; a client: none). Port 0 (tcp, tls) takes a free one.
    connect: endpoints of routers or peers, which are tried again for ever. Default: none; for a client without `scouting`
        "tcp/127.0.0.1:7447".
    scouting: find each other by multicast, which reaches the whole local network; default: off (or as `config_file` says).
    encoding: encoding of samples, events, and answers to requests without a payload.
    server: name of this server in the keys; default: the server's own. No other server in the network may have it.
    prefix: first levels of all keys.
    call_timeout_s: wall time after which a long-running call of an unnamed caller is cancelled, s: zenoh does not say when a caller goes.
    queue_requests: most commands and calls that wait for the loop; more are dropped and counted.
    config_file: zenoh configuration (JSON5 or YAML) to start from, for TLS, access control, and everything else.
    config: single zenoh settings by their path, which override everything else: "transport/link/tls/root_ca_certificate" = "ca.pem".
    """

    mode: Literal["peer", "client", "router"] = "peer"
    listen: tuple[Endpoint, ...] | None = None
    connect: tuple[Endpoint, ...] = ()
    scouting: bool | None = None
    encoding: EncodingName = "json"
    server: Name | None = None
    prefix: Name = "uw"
    call_timeout_s: Positive = 10.0
    queue_requests: Count = 4096
    config_file: Name | None = None
    config: dict[str, Any] = field(default_factory=dict)

    def needs(self) -> Mapping[str, str]:
        """See `AdapterTable.needs`."""
        return {"zenoh": "uwserver"}


def endpoints(config: ZenohConfig) -> tuple[str, ...]:
    """Return the endpoints where the session listens, with a free port in place of each TCP port 0.

    Raises:
        OSError: this machine has no such address.
    """
    listen = config.listen
    if listen is None:
        peer = FREE_ENDPOINT if config.connect or config.scouting else KNOWN_ENDPOINT
        listen = {"peer": (peer,), "router": (KNOWN_ENDPOINT,), "client": ()}[config.mode]
    return tuple(map(_with_free_port, listen))


def settings(config: ZenohConfig, listen: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield path and JSON of each zenoh setting, in their order. With a `config_file` it overrides only what the table gives."""
    scouting = config.scouting
    if scouting is None and config.config_file is None:
        scouting = False
    connect = config.connect
    if config.mode == "client" and not connect and not scouting:
        connect = (KNOWN_ENDPOINT,)
    ours: dict[str, object] = {
        "mode": config.mode,
        # Shared memory leaves a watchdog thread and segments behind.
        "transport/shared_memory/enabled": False,
        # A sample that finds the queue full is dropped soon, as waiting would stop the loop. It is not dropped at once: the fragments of a
        # large sample need the moment (us) in which the queue is emptied.
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 50,
        # Room for a megabyte of samples, the most that zenoh allows, so that a busy tick or a sample of 1 MB is not dropped.
        "transport/link/tx/queue/size/data": 16,
        # Closing a session waits for handshakes with silent peers, by default for ten seconds. `config` can allow more for slow links.
        "transport/unicast/accept_timeout": 700,
        "transport/unicast/open_timeout": 700,
        # Connects within two seconds after a router is back (by default it may take four).
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
    """Return whether other machines can reach the session without restriction, as far as this table tells."""
    local = ("127.", "localhost", "[::1]")
    reachable = any(not endpoint.partition("/")[2].startswith(local) for endpoint in listen)
    guarded = config.config_file is not None or any(
        path.split("/")[0] == "access_control" or "/tls" in path or "/auth" in path
        for path, _ in _leaves(config.config)
    )
    return reachable and not guarded


def _leaves(table: Mapping[str, Any], under: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and value of each leaf of nested tables: zenoh is configured leaf by leaf."""
    for name, value in table.items():
        path = f"{under}{name}".strip("/")
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{path}/")
        else:
            yield path, value


def _with_free_port(endpoint: str) -> str:
    address, mark, rest = endpoint.partition("#")
    if not (address.startswith(("tcp/", "tls/")) and address.endswith(":0")):
        return endpoint
    protocol, _, place = address.partition("/")
    host = place[: -len(":0")]
    # zenoh could take a free port too, but does not tell which one.
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    with socket.socket(family) as probe:
        probe.bind((host.strip("[]"), 0))
        return f"{protocol}/{host}:{probe.getsockname()[1]}{mark}{rest}"
