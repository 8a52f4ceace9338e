"""This node in the graph: its registration at the master, the node API, its subscribers, and the publishers that it hears.

The node makes connections of two kinds itself: calls of the master and other nodes, and subscriptions to topics that command vehicles.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable, Sequence
from typing import Any, Protocol
from urllib.parse import urlsplit

from uwserver.adapter import AdapterContext, Conversation, RateMeter, Refusals, may_connect, within
from uwserver.ports import Refused, Reply
from uwserver_adapters.ros.feed import Feed, OutgoingMessage, command
from uwserver_adapters.ros.messages import BadMessage, Facts, Types
from uwserver_adapters.ros1 import wire, xmlrpc
from uwserver_adapters.ros1.config import Ros1Config

CALL_S = 5.0
"""Wall time in which another node must answer."""
RETRY_S = 1.0
"""Wall time before a publisher is tried again."""
CHECK_S = 1.0
"""Wall time between two checks whether the master still knows this node."""
LEAVE_S = 0.5
"""Wall time to unregister at the master when this node ends."""
ROSOUT = "/rosout"
LOG = "rosgraph_msgs/msg/Log"
PUBLISHERS = 256
"""Most publishers of one topic that are heard."""
WARN = 4
TELL_S = 1.0
"""Wall time between two messages of /rosout."""


def place_of(uri: str) -> tuple[str, int, str]:
    """Return host, port and path of the address of a node.

    Raises:
        Refused: it is no such address.
    """
    try:
        parts = urlsplit(uri)
        port = parts.port
    except ValueError as error:
        raise Refused("bad_argument", f'"{uri[:100]}" is no address of a node: {error}') from None
    if parts.scheme != "http" or not parts.hostname or port is None:
        raise Refused("bad_argument", f'"{uri[:100]}" is no address of a node: http://host:port/')
    return parts.hostname, port, parts.path or "/"


async def ask(uri: str, method: str, *args: Any) -> Any:
    """Call a method of a node's API and return its value.

    Raises:
        Refused: the node answers that the call failed, or its answer is wrong.
        OSError: the node is not there, or does not answer in time.
    """
    host, port, path = place_of(uri)
    return await within(CALL_S, _asked(host, port, path, method, args), f"{uri} did not answer")


async def _asked(host: str, port: int, path: str, method: str, args: Sequence[Any]) -> Any:
    reader, writer = await asyncio.open_connection(host, port)
    try:
        writer.write(xmlrpc.request(f"{host}:{port}", path, method, args))
        answer = xmlrpc.Answer()
        while not answer.is_whole and (piece := await reader.read(1 << 16)):
            answer.receive(piece)
        body = answer.body()
        while body.parse_slice():
            await asyncio.sleep(0)  # let others have their turn
        return xmlrpc.result(body)
    finally:
        writer.transport.abort()


class Subscription:
    """The connection to one publisher of a topic. It is made again whenever it breaks, until `close`.

    Args:
        uri: address of the publisher's API.
        topic, type_name, md5, text: those of the messages; the type in ROS 1's spelling.
        node: name of this node.
        allowed: hosts besides this machine to which it may connect.
        most_per_s: most messages that are taken in a second.
        take: gets each message.
        complain: gets texts of faults.

    Attributes:
        uri: as given.
        is_connected: whether the publisher has answered.
    """

    def __init__(
        self, uri: str, topic: str, type_name: str, md5: str, text: str, node: str, allowed: Sequence[str], most_per_s: int,
        take: Callable[[bytes], None], complain: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.uri = uri
        self.is_connected = False
        self._topic, self._node, self._allowed = topic, node, allowed
        self._header = wire.header({
            "callerid": node, "topic": topic, "type": type_name, "md5sum": md5, "tcp_nodelay": "1", "message_definition": text,
        })  # fmt: skip
        self._rate = RateMeter(most_per_s)
        self._take, self._complain = take, complain
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        """End the connection."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            try:
                await self._hear()
            except (Refused, OSError) as error:
                self._complain(f"{self._topic} from {self.uri}: {str(error) or type(error).__name__}")
            await asyncio.sleep(RETRY_S)

    async def _hear(self) -> None:
        self._check(place_of(self.uri)[0])
        given = await ask(self.uri, "requestTopic", self._node, self._topic, [["TCPROS"]])
        if not (
            isinstance(given, list) and len(given) == 3 and isinstance(given[1], str) and isinstance(given[2], int)
        ):
            raise Refused("internal", "it offers no TCPROS")
        self._check(given[1])
        connecting = asyncio.open_connection(given[1], given[2], limit=1 << 16)
        reader, writer = await within(CALL_S, connecting, "it could not be reached")
        try:
            writer.write(self._header)
            await self._read(reader)
        finally:
            self.is_connected = False
            writer.transport.abort()

    def _check(self, host: str) -> None:
        if not may_connect(host, self._allowed):
            text = f'it names the host "{host[:100]}": say allowed_hosts = ["{host[:100]}"] if that is one of yours'
            raise Refused("denied", text)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        blocks = wire.Blocks()
        now = asyncio.get_running_loop().time
        while piece := await reader.read(1 << 14):
            blocks.receive(piece)
            while (block := blocks.next_block()) is not None:
                if not self.is_connected:
                    fields = wire.fields_of(block)
                    if "error" in fields:
                        raise Refused("denied", fields["error"][:200])
                    self.is_connected = True
                    blocks.limit = wire.MESSAGE_LIMIT
                    continue
                self._take(block)
                if not self._rate.take(now()):  # too many: read on when the second is over
                    await asyncio.sleep(max(self._rate.end - now(), 0.0))
                await asyncio.sleep(0)  # let others have their turn
        if not self.is_connected:
            raise OSError("it closed the connection without an answer")


log = logging.getLogger(__name__)


Registration = tuple[str, str, str]
"""Kind (Publisher, Subscriber, Service), name, and type."""


class Listener(Protocol):
    """A subscriber of a topic.

    Attributes:
        caller: name of its node.
    """

    caller: str

    def send_message(self, raw: bytes) -> None:
        """Send it the ROS 1 bytes of a message."""


class Node:
    """The node, as its adapter and those who connect see it.

    Args:
        context: the world.
        config: config of the adapter.
        refusals: counts what is refused.

    Attributes:
        context, config: as given.
        types: message types of ROS 1.
        feed: topics and services of the world.
        master: address of the master.
        uris: addresses of its API and of its services; set before `run`.
        tcpros: host and port of its topics; set before `run`.
    """

    def __init__(self, context: AdapterContext, config: Ros1Config, refusals: Refusals) -> None:
        self.context, self.config = context, config
        self.types = Types("noetic")
        self.uris = ("", "")
        self.tcpros: tuple[str, int] = ("", 0)
        self.master = config.master or os.environ.get("ROS_MASTER_URI") or "http://127.0.0.1:11311"
        facts = Facts(geoid_m=config.geoid_m, truth=config.truth, tf=config.tf)
        self._changed = asyncio.Event()
        self.feed = Feed(context, refusals, self.types, facts, self._deliver, config.clock_hz, self._changed.set)
        self._refusals = refusals
        self._conversation = Conversation(context, config.node.strip("/") or "ros1")
        self._listeners: dict[str, set[Listener]] = {}
        self._publishers: dict[str, dict[str, Subscription]] = {}
        self._named: dict[str, list[str]] = {}
        self._registered: set[Registration] = set()
        self._rosout_at = -TELL_S
        self._api: dict[str, Callable[..., tuple[int, str, Any]]] = {
            "requestTopic": self._request_topic,
            "publisherUpdate": self._publisher_update,
            "paramUpdate": lambda caller, key, value: (1, "", 0),
            "getPid": lambda caller: (1, "", os.getpid()),
            "getMasterUri": lambda caller: (1, "", self.master),
            "getBusInfo": self._bus_info,
            "getBusStats": lambda caller: (1, "", [[], [], []]),
            "getPublications": lambda caller: (1, "", [[t, short_name(kind)] for t, kind in self.feed.topics.items()]),
            "getSubscriptions": lambda caller: (
                1,
                "",
                [[each.name, short_name(each.type)] for each in self.feed.catalogue.command_topics.values()],
            ),
            "shutdown": lambda caller, reason="": (0, "a node of this graph does not end the simulation", 0),
        }

    def _deliver(self, topic: str, outgoing: OutgoingMessage) -> None:
        listeners = self._listeners.get(topic)
        if not listeners or outgoing.raw is None:
            return
        self.context.stats.encoded += 1
        for listener in tuple(listeners):
            listener.send_message(outgoing.raw)

    # -- for those who connect ------------------------------------------------------------------------------------------------------------

    def topics(self) -> dict[str, str]:
        """Return all topics that this node publishes -> type."""
        return {**self.feed.topics, ROSOUT: LOG}

    def hear(self, topic: str, subscriber: Listener) -> OutgoingMessage | None:
        """Add a subscriber; return the newest message where late subscribers get it."""
        self._listeners.setdefault(topic, set()).add(subscriber)
        return None if topic == ROSOUT else self.feed.hear(topic)

    def leave(self, topic: str, subscriber: Listener) -> None:
        """Remove a subscriber."""
        listeners = self._listeners.get(topic, set())
        listeners.discard(subscriber)
        if not listeners:
            self._listeners.pop(topic, None)
        if topic != ROSOUT:
            self.feed.leave(topic)

    def carry_out(self, call: xmlrpc.Call) -> tuple[int, str, Any]:
        """Carry out a call of the slave API (wiki.ros.org/ROS/Slave_API); return its code, text and value."""
        method = self._api.get(call.method)
        if method is None:
            return -1, f"no method {call.method[:80]}", 0
        try:
            return method(*call.args)
        except TypeError:
            return -1, f"wrong arguments for {call.method}", 0

    def _request_topic(self, caller: object, topic: object, protocols: object) -> tuple[int, str, Any]:
        if not isinstance(topic, str) or topic not in self.topics():
            return 0, f"this node does not publish {str(topic)[:200]}", 0
        offered = protocols if isinstance(protocols, list) else []
        if not any(isinstance(each, list) and each[:1] == ["TCPROS"] for each in offered):
            return 0, "this node speaks TCPROS only", 0
        return 1, "ready", ["TCPROS", *self.tcpros]

    def _publisher_update(self, caller: object, topic: object, uris: object) -> tuple[int, str, Any]:
        if isinstance(topic, str) and isinstance(uris, list) and topic in self.feed.catalogue.command_topics:
            self._named[topic] = [uri for uri in uris if isinstance(uri, str)][:PUBLISHERS]
            self._changed.set()
        return 1, "", 0

    def _bus_info(self, caller: object) -> tuple[int, str, Any]:
        heard = [
            [0, peer.caller, "o", "TCPROS", topic, True, ""]
            for topic, peers in self._listeners.items()
            for peer in peers
        ]
        hears = [
            [0, link.uri, "i", "TCPROS", topic, link.is_connected, ""]
            for topic, links in self._publishers.items()
            for link in links.values()
        ]
        return 1, "", heard + hears

    # -- commands of others ---------------------------------------------------------------------------------------------------------------

    def _command(self, topic: str, data: bytes) -> None:
        """Take a message of a publisher."""
        command_topic = self.feed.catalogue.command_topics.get(topic)
        if command_topic is None:
            return

        def answered(reply: Reply) -> None:
            if reply.fault is not None:
                self.complain(f"{topic}: {reply.fault.text}")

        try:
            value = command_topic.value(
                self.types.from_ros1(data, command_topic.type, self.types.most_bytes(command_topic.type))
            )
            command(self._conversation, command_topic, value, answered)
        except (BadMessage, Refused) as error:
            self.complain(f"{topic}: {error}")

    def complain(self, text: str) -> None:
        """Count what was not taken of another node, and publish it on /rosout at most once a second, as topics have no answers."""
        self._refusals.note_error("not taken", text)
        now = asyncio.get_running_loop().time()
        if now - self._rosout_at >= TELL_S and ROSOUT in self._listeners:
            self._rosout_at = now
            header = self.types.header(self.feed.catalogue.facts.epoch_ns + self.feed.t_ns, "")
            made = self.types.make(LOG, header=header, level=WARN, name=self.config.node, msg=text)
            self._deliver(ROSOUT, self.feed.outgoing(LOG, made))

    # -- the master -----------------------------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Stay registered at the master, which may come and go, until cancelled."""
        last = ""
        while True:
            try:
                await self._register()
                if last:
                    log.info("%s is registered at %s", self.context.name, self.master)
                last = ""
                self.context.stats.state = "running"
            except (OSError, Refused) as error:
                self._registered.clear()
                text = f"no ROS master at {self.master}: {error}"
                self.context.stats.last_error = text
                if not last:
                    log.warning("%s: %s; it is looked for every second (roscore starts one)", self.context.name, text)
                last = text
            await self._follow()
            self._changed.clear()
            with contextlib.suppress(OSError):
                await within(CHECK_S, self._changed.wait(), "nothing has changed")

    async def _register(self) -> None:
        """Register what is new at the master, and unregister what has gone.

        A master that does not know this node was restarted: everything is registered again.
        """
        node, (api, services) = self.config.node, self.uris
        try:
            known = await ask(self.master, "lookupNode", node, node)
        except Refused:
            known = None
        if known != api:
            self._registered.clear()
            if self.config.sim_time:
                await ask(self.master, "setParam", node, "/use_sim_time", True)
        catalogue = self.feed.catalogue
        wanted: set[Registration] = {("Publisher", topic, type_name) for topic, type_name in self.topics().items()}
        wanted |= {
            ("Subscriber", command_topic.name, command_topic.type)
            for command_topic in catalogue.command_topics.values()
        }
        wanted |= {("Service", offer.name, offer.type) for offer in catalogue.offers.values()}
        for each in sorted(self._registered - wanted):
            await self._unregister(each)
        for kind, name, type_name in sorted(wanted - self._registered):
            if kind == "Service":
                await ask(self.master, "registerService", node, name, services, api)
            else:
                found = await ask(self.master, f"register{kind}", node, name, short_name(type_name), api)
                if kind == "Subscriber" and isinstance(found, list):
                    self._named[name] = [uri for uri in found if isinstance(uri, str) and uri != api][:PUBLISHERS]
            self._registered.add((kind, name, type_name))

    async def _unregister(self, each: Registration) -> None:
        kind, name, _ = each
        self._registered.discard(each)
        if kind == "Subscriber":
            self._named.pop(name, None)
        await ask(self.master, f"unregister{kind}", self.config.node, name, self.uris[1 if kind == "Service" else 0])

    async def leave_graph(self) -> None:
        """Unregister at the master as far as it answers, and end all links."""
        with contextlib.suppress(OSError, Refused):
            await within(LEAVE_S, self._unregister_all(), "the master did not answer")
        for links in self._publishers.values():
            for link in links.values():
                await link.close()
        self._conversation.close()

    async def _unregister_all(self) -> None:
        for each in sorted(self._registered):
            await self._unregister(each)

    async def _follow(self) -> None:
        """Hear the publishers that the master names, and no others."""
        command_topics = self.feed.catalogue.command_topics
        for topic in [*self._publishers, *self._named]:
            named = self._named.get(topic, []) if topic in command_topics else []
            links = self._publishers.setdefault(topic, {})
            for uri in [uri for uri in links if uri not in named]:
                await links.pop(uri).close()
            for uri in named:
                if uri not in links:
                    links[uri] = self._subscription(topic, command_topics[topic].type, uri)
            if not links:
                del self._publishers[topic]

    def _subscription(self, topic: str, type_name: str, uri: str) -> Subscription:
        config, types = self.config, self.types
        allowed = (*config.allowed_hosts, place_of(self.master)[0])
        return Subscription(
            uri, topic, short_name(type_name), types.md5(type_name), types.text(type_name), config.node, allowed,
            config.max_requests_per_s, lambda data: self._command(topic, data), self.complain,
        )  # fmt: skip


def short_name(type_name: str) -> str:
    """Return ROS 1's spelling of ``package/msg/Name``."""
    package, _, name = type_name.split("/")
    return f"{package}/{name}"
