"""Which server on which zenoh network, and how a session gets there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uwclient.errors import UwError


@dataclass(frozen=True)
class ZenohPlace:
    """Which server, and how its network is reached."""

    server: str
    connect: tuple[str, ...]
    prefix: str
    mode: str
    config: Mapping[str, object]
    encoding: str

    @property
    def root(self) -> str:
        """First levels of the server's keys."""
        return f"{self.prefix}/{self.server}"

    @property
    def address(self) -> str:
        """For people."""
        return f"zenoh {self.root} ({', '.join(self.connect) or 'multicast'})"


def session_config(zenoh: Any, place: ZenohPlace) -> Any:
    """Return the configuration of a session; raises UwError for a wrong setting."""
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
