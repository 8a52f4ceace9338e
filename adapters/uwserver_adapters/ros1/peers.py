"""Who connects to this node: callers of its API, subscribers of its topics, clients of its services."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Protocol

from uwserver.adapter import AdapterContext, Connection, Conversation, Peers, RateMeter, did_you_mean
from uwserver.ports import Fault, Refused
from uwserver_adapters.ros.feed import Told, call
from uwserver_adapters.ros.messages.services import Offer
from uwserver_adapters.ros.messages.types import BadMessage, Types
from uwserver_adapters.ros1 import wire, xmlrpc
from uwserver_adapters.ros1.config import Ros1Config

CALLS_PER_S = 1000
"""Of one caller of the API."""


class Graph(Protocol):
    """The node, as those who connect to it see it."""

    context: AdapterContext
    config: Ros1Config
    types: Types

    def type_of(self, topic: str) -> str:
        """Type of a topic that this node tells; "" for none."""

    def topics(self) -> Collection[str]:
        """All topics that this node tells."""

    def offer(self, service: str) -> Offer | None:
        """A service of this node."""

    def services(self) -> Collection[str]:
        """Names of all services of this node."""

    def is_latched(self, topic: str) -> bool:
        """Whether late comers get the newest message."""

    def hear(self, topic: str, subscriber: Peer) -> Told | None:
        """A subscriber more. Gives what was said last, where that is for late comers too."""

    def leave(self, topic: str, subscriber: Peer) -> None:
        """One fewer."""

    def carry_out(self, call: xmlrpc.Call) -> tuple[int, str, Any]:
        """A call of the API."""


class Caller(Connection):
    """Somebody who calls the node's API by XML-RPC.

    Args:
        graph: the node.
        peers: all that are connected.
        names: by which this node may be called.
    """

    def __init__(self, graph: Graph, peers: Peers[Any], names: tuple[str, ...]) -> None:
        super().__init__(peers, graph.config.hello_timeout_s)
        self._graph = graph
        self._requests = xmlrpc.Requests(names)
        self._rate = RateMeter(CALLS_PER_S)

    def takes_http(self, head: bytes) -> bool:
        """It speaks nothing else."""
        return True

    def refused(self, fault: Fault) -> bytes:
        """What one caller too many gets, or one that said nothing."""
        return xmlrpc.http_answer("503 Service Unavailable", fault.text.encode())

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._requests.receive(data)

    def step(self) -> bool:
        """Answer the next call."""
        try:
            call = self._requests.next_call()
        except xmlrpc.BadHttp as bad:
            self.peers.refusals.note("http", bad.fault.text)
            self.farewell(xmlrpc.http_answer(bad.status, bad.fault.text.encode()))
            return False
        if call is None or not self.admit():
            return False
        self._rate.take(self.loop.time())
        self.write(xmlrpc.told(*self._graph.carry_out(call)))
        return True

    def quiet_until(self) -> float:
        """Who floods is not read until its second is over."""
        return self._rate.end if self._rate.is_flooded(self.loop.time()) else 0.0


class Peer(Connection):
    """A TCPROS connection: a subscriber of a topic, or a client of a service, as its header says.

    Args:
        graph: the node.
        peers: all that are connected.
        name: of this one.
    """

    def __init__(self, graph: Graph, peers: Peers[Any], name: str) -> None:
        super().__init__(peers, graph.config.hello_timeout_s)
        self.caller = ""
        self.topic = ""
        self._graph = graph
        self._name = name
        self._blocks = wire.Blocks()
        self._conversation: Conversation | None = None
        self._offer: Offer | None = None
        self._persists = False
        self._answering = False
        self._greeted = False
        self._rate = RateMeter(graph.config.max_requests_per_s)

    def refused(self, fault: Fault) -> bytes:
        """What one too many gets."""
        return wire.header({"error": fault.text})

    def receive(self, data: bytes) -> None:
        """Store bytes. A subscriber has nothing to say after its header; of a service client it is read on while it waits, as its end could not be
        seen otherwise."""
        if self.topic:
            return
        self._blocks.receive(data)
        if self._answering and self._blocks.waiting > self._blocks.limit:
            text = f"more than {self._blocks.limit} bytes of calls came before they were answered: wait for the answers"
            self._end(Fault("overload", text))

    def step(self) -> bool:
        """Take the header, or the next request of a service: ROS 1 answers in order, so one at a time."""
        if self._answering or (self._greeted and self._offer is None):
            return False
        try:
            block = self._blocks.next_block()
            if block is None:
                return False
            if self._greeted:
                self._ask(block)
            else:
                self._greet(wire.fields_of(block))
        except Refused as refused:
            self._end(refused.fault)
        return True

    def quiet_until(self) -> float:
        """Who floods is not read until its second is over."""
        return self._rate.end if self._rate.is_flooded(self.loop.time()) else 0.0

    def half_closed(self) -> None:
        """On TCP, who has gone looks like who only listens on: what would take long is ended, the rest is still answered."""
        if self._conversation is not None:
            self._conversation.end_calls()

    @property
    def is_owed(self) -> bool:
        """An answer is to come."""
        return self._answering

    def closed(self) -> None:
        """It went: nobody waits for its calls."""
        if self._conversation is not None:
            self._conversation.close()
        if self.topic:
            self._graph.leave(self.topic, self)

    # -- what it wants --------------------------------------------------------------------------------------------------------------------

    def _greet(self, fields: Mapping[str, str]) -> None:
        self.caller = fields.get("callerid", "")[:256]
        if "topic" in fields:
            self._subscribe(fields)
        elif "service" in fields:
            self._serve(fields)
        else:
            raise Refused("invalid_request", "a header names a topic or a service")

    def _subscribe(self, fields: Mapping[str, str]) -> None:
        graph, topic = self._graph, fields["topic"]
        type_name = graph.type_of(topic)
        if not type_name:
            hint = did_you_mean(topic[:200], graph.topics())
            raise Refused("unknown_port", f"this node does not publish {topic[:200]}{hint}")
        own = self._same_type(fields, type_name)
        if not self.admit():
            return
        text = graph.types.text(type_name)
        latching = "1" if graph.is_latched(topic) else "0"
        self.write(
            wire.header(
                {"callerid": graph.config.node, "topic": topic, "latching": latching, "message_definition": text, **own}
            )
        )
        self._greeted = True
        self.topic = topic
        last = graph.hear(topic, self)
        if last is not None and last.raw is not None:
            self.tell(last.raw)

    def _serve(self, fields: Mapping[str, str]) -> None:
        graph, service = self._graph, fields["service"]
        offer = graph.offer(service)
        if offer is None:
            hint = did_you_mean(service[:200], graph.services())
            raise Refused("unknown_service", f"this node has no service {service[:200]}{hint}")
        own = self._same_type(fields, offer.type)
        if not self.admit():
            return
        types = {"request_type": f"{own['type']}Request", "response_type": f"{own['type']}Response"}
        self.write(wire.header({"callerid": graph.config.node, **own, **types}))
        self._greeted = True
        if fields.get("probe") == "1":
            self.close()
            return
        self._offer = offer
        self._persists = fields.get("persistent") == "1"
        self._blocks.limit = wire.MESSAGE_LIMIT
        self._conversation = Conversation(graph.context, self._name)

    def _same_type(self, fields: Mapping[str, str], type_name: str) -> dict[str, str]:
        """Type and sum as both sides have them."""
        short, md5 = short_name(type_name), self._graph.types.md5(type_name)
        said = fields.get("md5sum", "*")
        if said not in ("*", md5) or fields.get("type", "*") not in ("*", short, ""):
            raise Refused(
                "version",
                f"it is of type {short} with md5sum {md5}, not {fields.get('type', '*')[:80]} with {said[:40]}",
            )
        return {"type": short, "md5sum": md5}

    # -- messages and answers -------------------------------------------------------------------------------------------------------------

    def tell(self, raw: bytes) -> None:
        """A message; left out while the subscriber does not read."""
        stats = self._graph.context.stats
        if self.is_closing:
            return
        if self.waiting > self._graph.config.queue_bytes:
            stats.dropped += 1
            return
        stats.samples_sent += 1
        stats.bytes_sent += len(raw) + 4
        self.write(wire.block(raw))

    def _ask(self, body: bytes) -> None:
        offer, types = self._offer, self._graph.types
        assert offer is not None
        assert self._conversation is not None
        if not self._rate.take(self.loop.time()):
            self._answer(None, f"more than {self._rate.most} calls a second: max_requests_per_s")
            return
        kind = f"{offer.type}_Request"
        try:
            request = types.from_ros1(body, kind, types.most_bytes(kind))
        except BadMessage as bad:
            self._answer(None, str(bad))
            return
        self._answering = True
        call(self._conversation, offer, request, self._answer)
        if self.is_half_open:
            self._conversation.end_calls()

    def _answer(self, response: object | None, text: str) -> None:
        self._answering = False
        if self.is_closing:
            return
        if response is None:
            self._graph.context.stats.errors += 1
            self.write(wire.answer(False, text.encode()))
        else:
            self.write(wire.answer(True, self._graph.types.ros1(response)))
        if not self._persists:
            self.close()
        else:
            self.go_on()

    def _end(self, fault: Fault) -> None:
        self.peers.refusals.note(fault.code, fault.text)
        self._graph.context.stats.errors += 1
        self.farewell(wire.answer(False, fault.text.encode()) if self._greeted else wire.header({"error": fault.text}))


def short_name(type_name: str) -> str:
    """ROS 1's spelling of ``package/msg/Name``."""
    package, _, name = type_name.split("/")
    return f"{package}/{name}"
