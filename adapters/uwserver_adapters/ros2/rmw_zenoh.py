"""The zenoh transport: a session whose keys, tokens and attachments are those of rmw_zenoh, or of zenoh-bridge-ros2dds."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from functools import partial
from typing import Any, NamedTuple

import zenoh
from zenoh import ext

from uwserver.adapter import AdapterStats, Inbox, Refusals, Worker
from uwserver_adapters.ros.messages.types import Types
from uwserver_adapters.ros2.carrier import WAITING_BYTES, Heard, Respond
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.ros2.graph import (
    BEST_EFFORT,
    LATCHED,
    RELIABLE,
    SERVICE,
    Attachment,
    BridgeNames,
    Names,
    attachment,
    gid,
)
from uwserver_adapters.zenoh_session.session import Lane, direct

NODES = 10_000
"""Most tokens of other nodes that are remembered."""
_EMPTY = b"\0\1\0\0\0"
"""A request without fields, in CDR."""
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


class _Came(NamedTuple):
    """What zenoh's threads hand over to the loop: `take`, and its arguments."""

    take: Callable[..., None]
    data: bytes
    sender: str
    respond: tuple[Respond, ...]


class _Writer:
    """Publishes one topic. Implements `uwserver_adapters.ros2.carrier.Writer`."""

    def __init__(self, carrier: ZenohCarrier, topic: str, type_name: str, latched: bool, heard: Heard) -> None:
        self._carrier, self._topic, self._heard = carrier, topic, heard
        self._sequence = 0
        self._lane = Lane(carrier.sender, carrier.stats)
        self.is_heard = False
        qos = LATCHED if latched else RELIABLE
        key, self._undeclare, self._gid = carrier.declare("MP", topic, type_name, qos)
        self._watched, self._publisher = carrier.publisher(key, latched)
        self._listener = self._watched.declare_matching_listener(direct(self._matches))
        carrier.writers[topic] = self
        self.refresh_matching()

    def _matches(self, status: Any) -> None:
        """Note whether somebody subscribes now. Called on a zenoh thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._carrier.loop.call_soon_threadsafe(self._set_heard, status.matching)

    def refresh_matching(self) -> None:
        """Ask whether somebody subscribes: zenoh tells its listeners a little after it knows."""
        status: Any = self._watched.matching_status
        if status.matching:
            self._set_heard(True)

    def _set_heard(self, is_heard: bool) -> None:
        # A writer that was closed meanwhile is not told any more.
        if self.is_heard != is_heard and self._carrier.writers.get(self._topic) is self:
            self.is_heard = is_heard
            self._carrier.loop.call_soon(self._heard, self._topic, is_heard)

    def put(self, data: bytes) -> bool:
        """Send a message; return whether it is not dropped here. zenoh drops it where the queue of a slow peer is full."""
        self._sequence += 1
        attached = Attachment(self._sequence, wall_ns(), self._gid).packed()
        return self._lane.put(len(data), partial(self._publisher.put, data, attachment=attached))

    def close(self) -> None:
        """End the topic."""
        self._carrier.writers.pop(self._topic, None)
        self._undeclare()
        self._publisher.undeclare()
        if self._watched is not self._publisher:
            self._watched.undeclare()


class ZenohCarrier:
    """Implements `uwserver_adapters.ros2.carrier.Carrier`.

    Args:
        session: the session, which is open.
        config: config of the adapter.
        types: message types of the distribution.
        sender: a thread for what may block.
        stats, refusals: those of the adapter.

    Attributes:
        loop: that of the adapter.
        sender, stats: as given.
        writers: what publishes each topic.
    """

    def __init__(
        self, session: zenoh.Session, config: Ros2Config, types: Types, sender: Worker, stats: AdapterStats,
        refusals: Refusals,
    ) -> None:  # fmt: skip
        self.loop = asyncio.get_running_loop()
        self.sender, self.stats = sender, stats
        self.writers: dict[str, _Writer] = {}
        self._session, self._types, self._refusals = session, types, refusals
        zid = str(session.zid())
        is_bridge = config.transport == "bridge"
        self._names: Names | BridgeNames = BridgeNames(zid) if is_bridge else Names(config.its_domain, zid, config.node)
        self._number = 0
        self._own: dict[tuple[str, str], tuple[str, str]] = {}
        self._others: dict[str, str] = {}
        self._inbox: Inbox[_Came] = Inbox(
            lambda came: came.take(came.data, came.sender, *came.respond), config.queue_requests, self._drop,
            lambda came: len(came.data), WAITING_BYTES,
        )  # fmt: skip
        self._tokens: Inbox[tuple[str, bool]] = Inbox(self._token, NODES, self._drop)
        self._liveliness = session.liveliness()
        self._node = self._liveliness.declare_token(self._names.node_token())
        self._liveliness.declare_subscriber(self._names.tokens, direct(self._token_said), history=True)

    # -- the graph --------------------------------------------------------------------------------------------------------------------------

    def declare(self, kind: Any, name: str, type_name: str, qos: str) -> tuple[str, Callable[[], object], bytes]:
        """Declare a new endpoint; return its key, what takes back its token, and its identity."""
        self._number += 1
        its_hash = self._types.hash(type_name)
        token = self._names.token(self._number, kind, name, type_name, its_hash, qos)
        self._own["service" if kind == "SS" else "topic", name] = (type_name, "" if self._names.is_plain else its_hash)
        undeclare = self._liveliness.declare_token(token).undeclare if token else lambda: None
        return self._names.key(name, type_name, its_hash), undeclare, gid(token)

    def _token_said(self, sample: zenoh.Sample) -> None:
        """Hand over that another endpoint came or went. Called on a zenoh thread."""
        self._tokens.put((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    def _token(self, said: tuple[str, bool]) -> None:
        token, is_there = said
        endpoint = self._names.parsed(token)
        if endpoint is None or endpoint.zid == self._names.zid:
            return
        if not is_there:
            self._others.pop(token, None)
        elif token not in self._others and len(self._others) < NODES:
            self._others[token] = endpoint.zid
            own = self._own.get(("service" if endpoint.kind in ("SS", "SC") else "topic", endpoint.name))
            if own is not None and own != (endpoint.type, endpoint.hash):
                self._refusals.note(
                    "type",
                    f"{endpoint.node} has {endpoint.name} as {endpoint.type} {endpoint.hash[:16]}, it is {own[0]} {own[1][:16]} here, so they "
                    "cannot connect: set ros_distro to that of the node, and build its messages anew",
                )
        self.stats.peers = len(set(self._others.values()))

    # -- topics -----------------------------------------------------------------------------------------------------------------------------

    def publisher(self, key: str, latched: bool) -> tuple[zenoh.Publisher, Any]:
        """Return a publisher that knows whether somebody subscribes, and the one that sends.

        They differ for a latched topic: what keeps the last message for late subscribers cannot tell whether there are any.
        """
        drop, remote = zenoh.CongestionControl.DROP, zenoh.Locality.REMOTE
        plain = self._session.declare_publisher(key, congestion_control=drop, allowed_destination=remote)
        if not latched:
            return plain, plain
        keeps = ext.declare_advanced_publisher(
            self._session, key, cache=ext.CacheConfig(1), publisher_detection=True,
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5), congestion_control=drop,
        )  # fmt: skip
        return plain, keeps

    def advertise(self, topic: str, type_name: str, latched: bool, heard: Heard) -> _Writer:
        """See `Carrier`."""
        return _Writer(self, topic, type_name, latched, heard)

    def refresh(self) -> None:
        """Find subscribers of which zenoh has not told yet."""
        for writer in list(self.writers.values()):
            if not writer.is_heard:
                writer.refresh_matching()

    def listen(self, topic: str, type_name: str, take: Callable[[bytes, str], None]) -> Callable[[], None]:
        """See `Carrier`."""
        key, undeclare, _ = self.declare("MS", topic, type_name, BEST_EFFORT)
        most = self._types.most_bytes(type_name)

        def came(sample: zenoh.Sample) -> None:
            attached = _attachment(sample.attachment)
            self._inbox.put(_Came(take, _bytes(sample.payload, most), _sender(attached), ()))

        subscriber = self._session.declare_subscriber(key, direct(came), allowed_origin=zenoh.Locality.REMOTE)
        return _ends(undeclare, subscriber)

    def serve(self, service: str, type_name: str, take: Callable[[bytes, str, Respond], None]) -> Callable[[], None]:
        """See `Carrier`."""
        key, undeclare, _ = self.declare("SS", service, type_name, SERVICE)
        most, is_plain = self._types.most_bytes(f"{type_name}_Request"), self._names.is_plain

        def came(query: zenoh.Query) -> None:
            attached, payload = _attachment(query.attachment), query.payload
            if not is_plain and (attached is None or payload is None):
                query.drop()  # it is no client of ROS and could not read the answer
                return
            data = _EMPTY if payload is None else _bytes(payload, most)
            respond = partial(self._respond, query, key, None if is_plain else attached)
            self._inbox.put(_Came(take, data, _sender(attached), (respond,)))

        # A client asks only queryables that answer for the whole key.
        queryable = self._session.declare_queryable(key, direct(came), complete=True)
        return _ends(undeclare, queryable)

    def _respond(self, query: zenoh.Query, key: str, asked: Attachment | None, data: bytes) -> None:
        """Answer with sequence and identity of the request, by which its client recognises the answer; a bridge needs none."""
        attached = None if asked is None else asked._replace(stamp_ns=wall_ns()).packed()

        def work() -> None:
            query.reply(key, data, attachment=attached)
            query.drop()

        self.sender.send(work)

    def _drop(self, _: object) -> None:
        """Count what is dropped because too much waits for the loop. Called on a zenoh thread."""
        self.stats.dropped += 1

    def close(self) -> None:
        """Take back the token of the node."""
        self._node.undeclare()


def _ends(undeclare: Callable[[], object], entity: Any) -> Callable[[], None]:
    def end() -> None:
        undeclare()
        entity.undeclare()

    return end


def wall_ns() -> int:
    """Return the wall time at which a message is sent, ns since 1970, exact to a microsecond. Measurements have simulation time."""
    return (datetime.now(timezone.utc) - _EPOCH) // timedelta(microseconds=1) * 1000


def _bytes(payload: zenoh.ZBytes, most: int) -> bytes:
    """Return the bytes of a payload; of one that is too large only its excess matters, and is not copied."""
    return bytes(most + 1) if len(payload) > most else payload.to_bytes()


def _attachment(attached: zenoh.ZBytes | None) -> Attachment | None:
    return attachment(None if attached is None else attached.to_bytes())


def _sender(attached: Attachment | None) -> str:
    return "" if attached is None else attached.gid.hex()[:8]
