"""The DDS transport: a participant of CycloneDDS that other vendors take for a node of ROS 2. Messages are written as encoded bytes."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from cyclonedds._clayer import ddspy_write
from cyclonedds.core import Listener
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from uwserver.adapter import AdapterStats, Inbox, Worker
from uwserver_adapters.ros.messages.types import Types
from uwserver_adapters.ros2.carrier import WAITING_BYTES, Heard, Respond
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.ros2.idl import Classes, Raw

LOCALHOST = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery></Domain></CycloneDDS>'
)
"""Settings of CycloneDDS that find only nodes of this machine, as ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST does."""
_INTERFACE = '<NetworkInterface address="{}" multicast="false"/>'
_INTERVAL = "<SPDPInterval>2s</SPDPInterval>"
URI_VARIABLE = "CYCLONEDDS_URI"
BLOCKING_MS = 100
"""Wall time for which a slow reader may hold up a write on the sender's thread, ms."""
TAKEN = 64
"""Most messages that are taken from a reader at once."""
_HEADER = slice(4, 20)
"""Where the header of rmw_cyclonedds stands in a request."""
_GRAPH, _GRAPH_TYPE = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"


def own_address() -> str:
    """Return the address by which others reach this machine; "" where it has none. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address for documentation; any distant one would do
        except OSError:
            return ""
        address = str(probe.getsockname()[0])
    return "" if address.startswith("127.") else address


def localhost(address: str) -> str:
    """Return settings that find all nodes of this machine, whatever their vendor and whichever started first.

    CycloneDDS by default uses one interface and drops what comes by another. Fast DDS asks over the loopback, nodes of rmw_cyclonedds over the
    machine's own address, so both are needed.

    Args:
        address: address of this machine; "" for none.
    """
    places = ["127.0.0.1", *([address] if address else [])]
    interfaces = "".join(_INTERFACE.format(place) for place in reversed(places))
    peers = "".join(f'<Peer address="{place}"/>' for place in places)
    made = LOCALHOST.replace("<General>", f"<General><Interfaces>{interfaces}</Interfaces>")
    # A node that searches the subnet does not ask us: it only hears our next announcement.
    return made.replace('<Peer address="localhost"/>', peers).replace("</Peers>", f"</Peers>{_INTERVAL}")


def endpoint_qos(type_hash: str, depth: int = 10, latched: bool = False, reliable: bool = True, more: str = "") -> Any:
    """Return the QoS of an endpoint.

    It asks for the old data representation: without it other vendors discover us but exchange nothing.

    Args:
        type_hash: RIHS01 hash of the type; other texts are left out.
        depth: depth of the history.
        latched: keep the last message for late subscribers.
        reliable: True for reliable delivery, False for best effort.
        more: further user data.
    """
    waits = Policy.Reliability.Reliable(duration(milliseconds=BLOCKING_MS))
    words = more + (f"typehash={type_hash};" if type_hash.startswith("RIHS01_") else "")
    return Qos(
        waits if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(1 if latched else depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(words.encode()),
    )


class _Writer(NamedTuple):
    """Publishes one topic. Implements `uwserver_adapters.ros2.carrier.Writer`."""

    carrier: DdsCarrier
    entity: Any

    def put(self, data: bytes) -> bool:
        """See `Writer`."""
        return self.carrier.sender.send(partial(write, self.entity, data))

    def close(self) -> None:
        """See `Writer`."""
        self.carrier.drop_entity(self.entity)


def write(entity: Any, data: bytes) -> None:
    """Write encoded bytes, as `DataWriter.write` does after it has encoded an object. The C layer checks them against the type.

    Raises:
        RuntimeError: they are refused.
    """
    result = ddspy_write(entity._ref, data)  # noqa: SLF001  # there is no public way to write bytes
    if result < 0:
        raise RuntimeError(f"CycloneDDS refuses {len(data)} bytes: error {result}")


class DdsCarrier:
    """Implements `uwserver_adapters.ros2.carrier.Carrier`.

    Args:
        config: config of the adapter.
        types: message types of the distribution.
        sender: a thread for what may block.
        stats: stats of the adapter.

    Attributes:
        sender: as given.
    """

    def __init__(self, config: Ros2Config, types: Types, sender: Worker, stats: AdapterStats) -> None:
        self.sender = sender
        self._config, self._types, self._stats = config, types, stats
        self._classes = Classes(types)
        self._loop = asyncio.get_running_loop()
        self._inbox: Inbox[tuple[Callable[[bytes], None], bytes]] = Inbox(
            lambda came: came[0](came[1]), config.queue_requests, self._drop, lambda came: len(came[1]), WAITING_BYTES
        )
        domain = config.its_domain
        given = os.environ.get(URI_VARIABLE, "")
        # A user's CYCLONEDDS_URI may name interfaces: then we name none.
        base = "" if config.discovery != "localhost" else LOCALHOST if given else localhost(own_address())
        uri = ",".join(part for part in (base, given) if part)
        self._domain = Domain(domain, uri) if uri else None
        self._participant = DomainParticipant(domain, Qos(Policy.Userdata(b"enclave=/;")))
        self._topics: dict[str, Any] = {}
        self._writers: list[Any] = []
        self._readers: list[Any] = []
        graph = endpoint_qos(types.hash(_GRAPH_TYPE) if _GRAPH_TYPE in types else "", latched=True)
        self._graph = DataWriter(self._participant, self._topic(_GRAPH, self._classes.of(_GRAPH_TYPE)), qos=graph)
        self._is_changed = True

    def _topic(self, name: str, kind: Any) -> Any:
        if name not in self._topics:
            self._topics[name] = Topic(self._participant, name, kind)
        return self._topics[name]

    # -- the graph --------------------------------------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Publish the node's name and endpoints if they have changed."""
        self._stats.peers = len({str(p) for p in self._graph.get_matched_subscriptions()})
        if not self._is_changed:
            return
        self._is_changed = False
        make = self._types.make
        node = make(
            "rmw_dds_common/msg/NodeEntitiesInfo", node_namespace="/", node_name=self._config.node,
            reader_gid_seq=[self._gid(reader) for reader in self._readers],
            writer_gid_seq=[self._gid(writer) for writer in self._writers],
        )  # fmt: skip
        told = make(_GRAPH_TYPE, gid=self._gid(self._participant), node_entities_info_seq=[node])
        self.sender.send(partial(write, self._graph, self._types.cdr(told)))

    def _gid(self, entity: Any) -> object:
        """Return a Gid of 16 bytes; in humble it has 24, the last of which are zero."""
        import numpy as np

        length = 24 if self._config.ros_distro == "humble" else 16
        data = entity.guid.bytes.ljust(length, b"\0")
        return self._types.make("rmw_dds_common/msg/Gid", data=np.frombuffer(data, np.uint8))

    def drop_entity(self, entity: Any) -> None:
        """End an endpoint after what it still has to send."""
        for entities in (self._writers, self._readers):
            if entity in entities:
                entities.remove(entity)
        self._is_changed = True
        self.sender.send(lambda: entity)  # its last reference waits behind its messages

    # -- topics and services ----------------------------------------------------------------------------------------------------------------

    def advertise(self, topic: str, type_name: str, latched: bool, heard: Heard) -> _Writer:
        """See `Carrier`. The writer is reliable, which matches readers of either kind."""

        def matched(_: object, status: Any) -> None:  # called on a thread of CycloneDDS
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(heard, topic, status.current_count > 0)

        where = self._topic(f"rt{topic}", self._classes.of(type_name))
        qos = endpoint_qos(self._types.hash(type_name), latched=latched)
        entity = DataWriter(self._participant, where, qos=qos, listener=Listener(on_publication_matched=matched))
        self._writers.append(entity)
        self._is_changed = True
        return _Writer(self, entity)

    def listen(self, topic: str, type_name: str, take: Callable[[bytes, str], None]) -> Callable[[], None]:
        """See `Carrier`."""
        return self._read(f"rt{topic}", self._classes.raw(type_name), type_name, False, lambda data: take(data, "dds"))

    def _read(
        self, name: str, kind: Any, type_name: str, reliable: bool, take: Callable[[bytes], None], more: str = ""
    ) -> Callable[[], None]:
        # The 20 bytes are the encapsulation and the header of a request.
        most = self._types.most_bytes(f"{type_name}_Request" if reliable else type_name) + 20

        def came(reader: Any) -> None:  # called on a thread of CycloneDDS
            for sample in reader.take(TAKEN):
                if isinstance(sample, Raw):
                    # What is too long is cut: one byte too many shows it, and its header tells whom to answer.
                    self._inbox.put((take, sample.data[: most + 1]))

        qos = endpoint_qos(self._types.hash(type_name), 10 if reliable else 1, reliable=reliable, more=more)
        entity = DataReader(self._participant, self._topic(name, kind), qos=qos)
        # The listener comes later, as it could be called before the reader is known here. Then what has come until now is taken.
        entity.set_listener(Listener(on_data_available=came))
        came(entity)
        self._readers.append(entity)
        self._is_changed = True
        return lambda: self.drop_entity(entity)

    def serve(self, service: str, type_name: str, take: Callable[[bytes, str, Respond], None]) -> Callable[[], None]:
        """See `Carrier`. As in rmw_cyclonedds a header stands in front of the fields of request and response."""
        request, response = f"{type_name}_Request", f"{type_name}_Response"
        where = self._topic(f"rr{service}Reply", self._classes.of(response, in_service=True))
        writer = DataWriter(self._participant, where, qos=endpoint_qos(self._types.hash(type_name)))
        number = ".".join(f"{byte:02x}" for byte in writer.guid.bytes)
        self._writers.append(writer)

        def asked(data: bytes) -> None:
            header = data[_HEADER]
            if len(header) < 16:
                return

            def respond(body: bytes) -> None:
                self.sender.send(partial(write, writer, body[:4] + header + body[4:]))

            take(data[:4] + data[20:], header[:8].hex(), respond)

        kind = self._classes.raw(request, in_service=True)
        end = self._read(f"rq{service}Request", kind, type_name, True, asked, f"serviceid={number};")

        def ended() -> None:
            end()
            self.drop_entity(writer)

        return ended

    def _drop(self, _: object) -> None:
        """Count what is dropped because too much waits for the loop. Called on a thread of CycloneDDS."""
        self._stats.dropped += 1

    def close(self) -> None:
        """End all entities: each ends with its last reference."""
        for entities in (self._writers, self._readers):
            for entity in entities:
                entity.set_listener(None)
            entities.clear()
        self._topics.clear()
        del self._graph, self._participant, self._domain
