"""The naming of zenoh-bridge-ros2dds, without a session: plain keys, and the tokens by which bridges announce endpoints to each other.

Facts from zenoh-plugin-ros2dds (`liveliness_mgt.rs`, `route_service_cli.rs`, state of 2026-08); docs/how-to/ros2.md says what was tried.
"""

from __future__ import annotations

from typing import NamedTuple

from uwserver_adapters.ros2.graph import BEST_EFFORT, LATCHED, RELIABLE, Endpoint, Entity

SLASH = "§"
"""Stands for a slash within a part of a token."""
ROOT = "@ros2_lv"
_QOS = {RELIABLE: ":1:0:0,10", LATCHED: ":1:1:0,1", BEST_EFFORT: ":0:0:0,1"}
"""No key, then reliability, durability, history and its depth, as numbers of DDS."""
_ACTION = "/_action/"


class BridgeNames(NamedTuple):
    """The names of a session's keys and tokens.

    Attributes:
        zid: id of the session.
    """

    zid: str

    @property
    def is_plain(self) -> bool:
        """Whether messages and requests travel without attachments: yes."""
        return True

    def key(self, name: str, type_name: str, type_hash: str) -> str:
        """Return the key of a topic's messages, or of a service's requests."""
        return name.strip("/")

    def node_token(self) -> str:
        """Return the token that announces a bridge."""
        return f"@/{self.zid}/{ROOT}"

    def token(self, number: int, kind: Entity, name: str, type_name: str, type_hash: str, qos: str) -> str:
        """Return the token that announces an endpoint. An action has a single token: it is "" for all endpoints of an action but one."""
        head, action, part = name.partition(_ACTION)
        if action:
            if part != "send_goal":
                return ""
            return self._token("AS", head, type_name.removesuffix("_SendGoal"))
        token = self._token(kind, name, type_name)
        if kind in ("SS", "SC"):
            return token
        data = f":typehash={type_hash};" if type_hash.startswith("RIHS01_") else ""
        return f"{token}/{_QOS[qos]}{data}"

    def _token(self, kind: str, name: str, type_name: str) -> str:
        ends = (part.strip("/").replace("/", SLASH) for part in (name, type_name))
        return f"@/{self.zid}/{ROOT}/{kind}/{'/'.join(ends)}"

    @property
    def tokens(self) -> str:
        """Key expression of all tokens of bridges."""
        return f"@/*/{ROOT}/**"

    def parsed(self, token: str) -> Endpoint | None:
        """Return the endpoint of another bridge's token; None for other texts. Its hash is empty, as not every bridge tells hashes."""
        parts = token.split("/")
        if len(parts) < 6 or parts[0] != "@" or parts[2] != ROOT or parts[3] not in ("MP", "MS", "SS", "SC"):
            return None
        name, type_name = (part.replace(SLASH, "/") for part in parts[4:6])
        return Endpoint(parts[1], parts[3], "a bridge", f"/{name}", type_name, "")
