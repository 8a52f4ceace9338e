"""Those who connect to this node: callers of its API, subscribers of its topics, clients of its services."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uwserver.adapter import Connection, Conversation, Peers, did_you_mean
from uwserver.ports import Fault, Refused
from uwserver_adapters.ros.feed import call
from uwserver_adapters.ros.messages import BadMessage, Offer
from uwserver_adapters.ros1 import wire, xmlrpc
from uwserver_adapters.ros1.node import Node, short_name

CALLS_PER_S = 1000
"""Most calls of one caller of the API in a second."""
BYTES_A_CALL = 512
"""A longer call counts as several: parsing it takes as long."""


class Caller(Connection):
    """A caller of the node's API by XML-RPC.

    Args:
        node: the node.
        peers: all that are connected.
        names: names by which this node may be called.
    """

    def __init__(self, node: Node, peers: Peers[Any], names: tuple[str, ...]) -> None:
        super().__init__(peers, node.config.hello_timeout_s, requests_per_s=CALLS_PER_S)
        self._node = node
        self._requests = xmlrpc.Requests(names)

    def takes_http(self, head: bytes) -> bool:
        """Take every request of HTTP, the only protocol here."""
        return True

    def refused(self, fault: Fault) -> bytes:
        """Return the answer to a caller for whom there is no place, or who said nothing in time."""
        return xmlrpc.http_answer("503 Service Unavailable", fault.text.encode())

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._requests.receive(data)

    def step(self) -> bool:
        """Parse a slice of the next call, and answer it when that was the last one."""
        try:
            call = self._requests.next_call()
        except xmlrpc.BadHttp as bad:
            self.peers.refusals.note("http", bad.fault.text)
            self.farewell(xmlrpc.http_answer(bad.status, bad.fault.text.encode()))
            return False
        if call is None:
            return self._requests.is_parsing
        if not self.admit():
            return False
        self._rate.take(self.loop.time(), 1 + self._requests.size // BYTES_A_CALL)
        self.write(xmlrpc.told(*self._node.carry_out(call)))
        return True


class Peer(Connection):
    """A TCPROS connection: a subscriber of a topic, or a client of a service, as its header says.

    Args:
        node: the node.
        peers: all that are connected.
        name: name of this peer, for the world.

    Attributes:
        caller: name of the peer's node.
        topic: to which it subscribes; "" for none.
    """

    def __init__(self, node: Node, peers: Peers[Any], name: str) -> None:
        config = node.config
        self._conversation = Conversation(node.context, name)
        super().__init__(
            peers,
            config.hello_timeout_s,
            stats=node.context.stats,
            requests_per_s=config.max_requests_per_s,
            queue_bytes=config.queue_bytes,
            conversation=self._conversation,
        )
        self.caller = ""
        self.topic = ""
        self._node = node
        self._blocks = wire.Blocks()
        self._offer: Offer | None = None
        self._persists = False
        self._answering = False
        self._greeted = False

    def refused(self, fault: Fault) -> bytes:
        """Return the header for a peer for which there is no place, or which said nothing in time."""
        return wire.header({"error": fault.text})

    def receive(self, data: bytes) -> None:
        """Store bytes.

        A subscriber has nothing to say after its header. A service client is read also while it waits for an answer, as its end would not
        be noticed otherwise.
        """
        if self.topic:
            return
        self._blocks.receive(data)
        if self._answering and self._blocks.waiting > self._blocks.limit:
            text = f"more than {self._blocks.limit} bytes of calls came before they were answered: wait for the answers"
            self._end(Fault("overload", text))

    def step(self) -> bool:
        """Take the header, or the next request of a service. Only one request is under way, as ROS 1 answers in order."""
        if self._answering or (self._greeted and self._offer is None):
            return False
        try:
            block = self._blocks.next_block()
            if block is None:
                return False
            if self._offer is not None:
                self._ask(self._offer, block)
            else:
                self._greet(wire.fields_of(block))
        except Refused as refused:
            self._end(refused.fault)
        return True

    @property
    def has_pending_output(self) -> bool:
        """Whether an answer is to come."""
        return self._answering

    def closed(self) -> None:
        """End its subscription."""
        if self.topic:
            self._node.leave(self.topic, self)

    # -- the header -----------------------------------------------------------------------------------------------------------------------

    def _greet(self, fields: Mapping[str, str]) -> None:
        self.caller = fields.get("callerid", "")[:256]
        if "topic" in fields:
            self._subscribe(fields)
        elif "service" in fields:
            self._serve(fields)
        else:
            raise Refused("invalid_request", "a header names a topic or a service")

    def _subscribe(self, fields: Mapping[str, str]) -> None:
        node, topic, topics = self._node, fields["topic"], self._node.topics()
        type_name = topics.get(topic)
        if type_name is None:
            hint = did_you_mean(topic[:200], topics)
            raise Refused("unknown_port", f"this node does not publish {topic[:200]}{hint}")
        own = self._same_type(fields, type_name)
        if not self.admit():
            return
        text, latching = node.types.text(type_name), "1" if node.feed.is_latched(topic) else "0"
        about = {"callerid": node.config.node, "topic": topic, "latching": latching, "message_definition": text}
        self.write(wire.header({**about, **own}))
        self._greeted = True
        self.topic = topic
        last = node.hear(topic, self)
        if last is not None and last.raw is not None:
            self.send_message(last.raw)

    def _serve(self, fields: Mapping[str, str]) -> None:
        node, service, offers = self._node, fields["service"], self._node.feed.catalogue.offers
        offer = offers.get(service)
        if offer is None:
            hint = did_you_mean(service[:200], offers)
            raise Refused("unknown_service", f"this node has no service {service[:200]}{hint}")
        own = self._same_type(fields, offer.type)
        if not self.admit():
            return
        types = {"request_type": f"{own['type']}Request", "response_type": f"{own['type']}Response"}
        self.write(wire.header({"callerid": node.config.node, **own, **types}))
        self._greeted = True
        if fields.get("probe") == "1":
            self.close()
            return
        self._offer = offer
        self._persists = fields.get("persistent") == "1"
        self._blocks.limit = wire.MESSAGE_LIMIT

    def _same_type(self, fields: Mapping[str, str], type_name: str) -> dict[str, str]:
        """Return type and MD5 sum for the header.

        Raises:
            Refused: the peer expects others.
        """
        short, md5 = short_name(type_name), self._node.types.md5(type_name)
        said, its_type = fields.get("md5sum", "*"), fields.get("type", "*")
        if said not in ("*", md5) or its_type not in ("*", short, ""):
            text = f"it is of type {short} with md5sum {md5}, not {its_type[:80]} with {said[:40]}"
            raise Refused("version", text)
        return {"type": short, "md5sum": md5}

    # -- messages and answers -------------------------------------------------------------------------------------------------------------

    def send_message(self, raw: bytes) -> None:
        """Send a message; drop it while too much waits for the subscriber."""
        self.send_sample(wire.block(raw))

    def _ask(self, offer: Offer, body: bytes) -> None:
        types, kind = self._node.types, f"{offer.type}_Request"
        if not self._rate.take(self.loop.time()):
            self._answer(None, f"more than {self._rate.most} calls a second: max_requests_per_s")
            return
        try:
            request = types.from_ros1(body, kind, types.most_bytes(kind))
        except BadMessage as bad:
            self._answer(None, str(bad))
            return
        self._answering = True
        call(self._conversation, offer, request, self._answer)

    def _answer(self, response: object | None, text: str) -> None:
        self._answering = False
        if self.is_closing:
            return
        if response is None:
            self._stats.errors += 1
            self.write(wire.answer(False, text.encode()))
        else:
            self.write(wire.answer(True, self._node.types.ros1(response)))
        if self._persists:
            self.go_on()
        else:
            self.close()

    def _end(self, fault: Fault) -> None:
        self.peers.refusals.note(fault.code, fault.text)
        self._stats.errors += 1
        self.farewell(wire.answer(False, fault.text.encode()) if self._greeted else self.refused(fault))
