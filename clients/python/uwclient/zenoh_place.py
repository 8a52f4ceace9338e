"""The place of a server in a zenoh network, and the configuration of a session that reaches it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uwclient.errors import UwError


@dataclass(frozen=True)
class ZenohPlace:
    """The place of a server, and how its network is reached.

    Attributes:
        server: name of the server in the keys.
        connect: endpoints of servers or routers; () searches by multicast.
        prefix: first levels of the keys.
        mode: mode of the session, "peer" or "client".
        config: zenoh settings by path.
        encoding: "json" or "msgpack".
    """

    server: str
    connect: tuple[str, ...]
    prefix: str
    mode: str
    config: Mapping[str, object]
    encoding: str

    @property
    def root(self) -> str:
        """The first levels of the keys of the server."""
        return f"{self.prefix}/{self.server}"

    @property
    def address(self) -> str:
        """The place as text for people."""
        return f"zenoh {self.root} ({', '.join(self.connect) or 'multicast'})"


def session_config(zenoh: Any, place: ZenohPlace) -> Any:
    """Return the configuration of a session. Raises UwError if a setting is wrong."""
    config = zenoh.Config()
    settings: dict[str, object] = {
        "mode": place.mode,
        "listen/endpoints": [],
        "connect/endpoints": list(place.connect),
        "scouting/multicast/enabled": not place.connect,
        "transport/shared_memory/enabled": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        **place.config,
    }
    for path, value in settings.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            text = f'zenoh refuses the setting "{path}": {str(error).split(" at /")[0]}'
            raise UwError(text, code="bad_argument", where=path) from None
    return config
