"""The naming of rmw_zenoh, without a session: keys of topics and services, liveliness tokens, identities, attachments.

Facts from the design document of ros2/rmw_zenoh, releases of 2024-12 and later (humble 0.1.2, jazzy 0.2.4); docs/how-to/ros2.md says what was tried.
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


class Names(NamedTuple):
    """The names of a node's keys and tokens.

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
