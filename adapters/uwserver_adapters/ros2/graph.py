"""The naming of rmw_zenoh, without a session: keys of topics and services, liveliness tokens, identities, attachments.

Facts from the design document of ros2/rmw_zenoh, releases of 2024-12 and later (humble 0.1.2, jazzy 0.2.4); docs/how-to/ros2.md says what was tried.

The naming of zenoh-bridge-ros2dds is here too: plain keys, and the tokens by which bridges announce endpoints to each other. Its facts are from
zenoh-plugin-ros2dds (`liveliness_mgt.rs`, `route_service_cli.rs`, state of 2026-08).
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple

from uwserver_adapters.ros.messages.types import dds_name

EMPTY = "%"
"""Stands for an empty part of a token, and for each slash within a part."""
ROOT = "@ros2_lv"
Entity = Literal["MP", "MS", "SS", "SC"]
"""Kinds of endpoints: publisher, subscription, service, client."""

RELIABLE = "1:2:1,10:,:,:,,"
"""Reliable, volatile, keep the last ten. Every field is written, as the meaning of an empty field has changed between releases."""
LATCHED = "1:1:1,1:,:,:,,"
"""Reliable, transient local, keep the last one."""
BEST_EFFORT = "2:2:1,1:,:,:,,"
"""Best effort, volatile, keep the last one: such a subscriber matches every publisher."""
SERVICE = RELIABLE

_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
SLASH = "§"
"""Stands for a slash within a part of a token."""
_QOS = {RELIABLE: ":1:0:0,10", LATCHED: ":1:1:0,1", BEST_EFFORT: ":0:0:0,1"}
"""No key, then reliability, durability, history and its depth, as numbers of DDS."""
_ACTION = "/_action/"


class Names(NamedTuple):
    """The names of a node's keys and tokens.

    Attributes:
        domain: ROS_DOMAIN_ID.
        zid: zid of the session.
        node: name of the node.
    """

    domain: int
    zid: str
    node: str

    @property
    def is_plain(self) -> bool:
        """Whether messages and requests travel without attachments."""
        return False

    def key(self, name: str, type_name: str, type_hash: str) -> str:
        """Return the key of a topic's messages, or of a service's requests."""
        return f"{self.domain}/{name.strip('/')}/{dds_name(type_name)}/{type_hash}"

    def node_token(self) -> str:
        """Return the token that announces the node."""
        return f"{ROOT}/{self.domain}/{self.zid}/0/0/NN/{EMPTY}/{EMPTY}/{self.node}"

    def token(self, number: int, kind: Entity, name: str, type_name: str, type_hash: str, qos: str) -> str:
        """Return the token that announces an endpoint; `number` is unique in the session."""
        topic = name.replace("/", EMPTY)
        return f"{ROOT}/{self.domain}/{self.zid}/0/{number}/{kind}/{EMPTY}/{EMPTY}/{self.node}/{topic}/{dds_name(type_name)}/{type_hash}/{qos}"

    @property
    def tokens(self) -> str:
        """Key expression of all tokens of the domain."""
        return f"{ROOT}/{self.domain}/**"

    def parsed(self, token: str) -> Endpoint | None:
        """Return the endpoint of another node's token, with its type in ROS' spelling; None for other tokens."""
        endpoint = parsed_token(token)
        return None if endpoint is None else endpoint._replace(type=ros_type(endpoint.type))


class Endpoint(NamedTuple):
    """An endpoint of another node."""

    zid: str
    kind: str
    node: str
    name: str
    type: str
    hash: str


def parsed_token(token: str) -> Endpoint | None:
    """Return the endpoint of a token; None for the token of a node and for other texts. Parts that newer releases append are ignored."""
    parts = token.split("/")
    if len(parts) < 13 or parts[0] != ROOT or parts[5] not in ("MP", "MS", "SS", "SC"):
        return None
    namespace = parts[7].replace(EMPTY, "/").rstrip("/")
    name = parts[9].replace(EMPTY, "/")
    return Endpoint(parts[2], parts[5], f"{namespace}/{parts[8]}", name, parts[10], parts[11])


def ros_type(dds_type: str) -> str:
    """Return ``package/msg/Name`` for the DDS name of a type; the text itself where it is no such name."""
    parts = dds_type.split("::")
    return f"{parts[0]}/{parts[1]}/{parts[3].removesuffix('_')}" if len(parts) == 4 and parts[2] == "dds_" else dds_type


def gid(token: str) -> bytes:
    """Return an endpoint's identity: XXH3-128 of its token, the lower 64 bits first, each half little endian."""
    import xxhash

    made: bytes = xxhash.xxh3_128(token.encode()).intdigest().to_bytes(_GID_BYTES, "little")
    return made


class Attachment(NamedTuple):
    """The attachment of a message.

    Attributes:
        sequence: number of the message among those of its sender, from 1; a reply has that of its request.
        stamp_ns: wall time at which it was sent, ns since 1970.
        gid: identity of its sender; a reply has that of the client.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def packed(self) -> bytes:
        """Return its 33 bytes: two i64, the length of the identity, the identity."""
        return _ATTACHMENT.pack(self.sequence, self.stamp_ns, _GID_BYTES, self.gid)


def attachment(data: bytes | None) -> Attachment | None:
    """Return the attachment in these bytes; None where they are none."""
    if data is None or len(data) != _ATTACHMENT.size:
        return None
    sequence, stamp_ns, size, its = _ATTACHMENT.unpack(data)
    return Attachment(sequence, stamp_ns, its) if size == _GID_BYTES else None


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
