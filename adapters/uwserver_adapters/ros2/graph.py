"""The words of rmw_zenoh, without a session: keys of topics and services, liveliness tokens, identities, attachments.

Facts from the design document of ros2/rmw_zenoh, releases of 2024-12 and later (humble 0.1.2, jazzy 0.2.4); docs/how-to/ros2.md says what was tried.
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple

from uwserver_adapters.ros.messages.types import dds_name

EMPTY = "%"
"""An empty part of a token; it also stands for each slash within a part."""
ROOT = "@ros2_lv"
Entity = Literal["MP", "MS", "SS", "SC"]
"""Publisher, subscription, service, client."""

RELIABLE = "1:2:1,10:,:,:,,"
"""Reliable, volatile, the last ten; every field written, as what an empty one means has changed between releases."""
LATCHED = "1:1:1,1:,:,:,,"
"""Reliable, transient local, the last one."""
BEST_EFFORT = "2:2:1,1:,:,:,,"
"""Best effort, volatile, the last one: takes what every publisher sends."""
SERVICE = RELIABLE

_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16


class Names(NamedTuple):
    """What a node's words begin with.

    Attributes:
        domain: ROS_DOMAIN_ID.
        zid: of the session.
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
        """The key on which a topic's messages, or a service's requests, travel."""
        return f"{self.domain}/{name.strip('/')}/{dds_name(type_name)}/{type_hash}"

    def node_token(self) -> str:
        """Says that the node is there."""
        return f"{ROOT}/{self.domain}/{self.zid}/0/0/NN/{EMPTY}/{EMPTY}/{self.node}"

    def token(self, number: int, kind: Entity, name: str, type_name: str, type_hash: str, qos: str) -> str:
        """Says that the node has an endpoint; `number` is its own among all of the session."""
        topic = name.replace("/", EMPTY)
        return f"{ROOT}/{self.domain}/{self.zid}/0/{number}/{kind}/{EMPTY}/{EMPTY}/{self.node}/{topic}/{dds_name(type_name)}/{type_hash}/{qos}"

    @property
    def tokens(self) -> str:
        """All tokens of the domain."""
        return f"{ROOT}/{self.domain}/**"

    def parsed(self, token: str) -> Endpoint | None:
        """What another node's token says, with the type in ROS' words."""
        endpoint = parsed_token(token)
        return None if endpoint is None else endpoint._replace(type=ros_type(endpoint.type))


class Endpoint(NamedTuple):
    """What another node's token says."""

    zid: str
    kind: str
    node: str
    name: str
    type: str
    hash: str


def parsed_token(token: str) -> Endpoint | None:
    """The endpoint of a token; None for one of a node, and for what is none. Parts that newer releases append are passed over."""
    parts = token.split("/")
    if len(parts) < 13 or parts[0] != ROOT or parts[5] not in ("MP", "MS", "SS", "SC"):
        return None
    namespace = parts[7].replace(EMPTY, "/").rstrip("/")
    name = parts[9].replace(EMPTY, "/")
    return Endpoint(parts[2], parts[5], f"{namespace}/{parts[8]}", name, parts[10], parts[11])


def ros_type(dds_type: str) -> str:
    """``package/msg/Name`` of DDS' name of a type; the text itself where it is none."""
    parts = dds_type.split("::")
    return f"{parts[0]}/{parts[1]}/{parts[3].removesuffix('_')}" if len(parts) == 4 and parts[2] == "dds_" else dds_type


def gid(token: str) -> bytes:
    """An endpoint's identity: XXH3-128 of its token, the lower 64 bits first, each little endian."""
    import xxhash

    made: bytes = xxhash.xxh3_128(token.encode()).intdigest().to_bytes(_GID_BYTES, "little")
    return made


class Attachment(NamedTuple):
    """What travels with each message.

    Attributes:
        sequence: counts what its sender sent, from 1; of a reply that of the request.
        stamp_ns: wall time at which it was sent, ns since 1970.
        gid: of its sender; of a reply that of the client.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def packed(self) -> bytes:
        """33 bytes: two i64, the length of the identity, the identity."""
        return _ATTACHMENT.pack(self.sequence, self.stamp_ns, _GID_BYTES, self.gid)


def attachment(data: bytes | None) -> Attachment | None:
    """What came with a message; None where it is none."""
    if data is None or len(data) != _ATTACHMENT.size:
        return None
    sequence, stamp_ns, size, its = _ATTACHMENT.unpack(data)
    return Attachment(sequence, stamp_ns, its) if size == _GID_BYTES else None
