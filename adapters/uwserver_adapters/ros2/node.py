"""The node: its topics and services on the transport, and the messages and requests between these and the world. Loop thread."""

from __future__ import annotations

import logging
from collections.abc import Callable, Set
from functools import partial

from uwserver.adapter import AdapterContext, Conversation, Refusals
from uwserver.ports import Refused, Reply
from uwserver_adapters.ros.feed import Feed, OutgoingMessage, call, command
from uwserver_adapters.ros.messages import TF_STATIC, BadMessage, Facts, Offer, Types
from uwserver_adapters.ros2.actions import ActionServer
from uwserver_adapters.ros2.carrier import Carrier, Respond, Writer
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.ros2.parameters import ParameterServer

log = logging.getLogger(__name__)


class Node:
    """A node of ROS 2. Implements `uwserver_adapters.ros2.carrier.Host`.

    Args:
        context: the world.
        config: config of the adapter.
        refusals: counts what is refused.
        carrier: the transport, which is open.
        types: message types of the distribution.

    Attributes:
        types, carrier: as given.
        feed: topics, services, actions and settings of the world.
        conversation: all commands and calls to the world are made in it.
    """

    def __init__(
        self, context: AdapterContext, config: Ros2Config, refusals: Refusals, carrier: Carrier, types: Types
    ) -> None:
        self._context, self._config, self._refusals, self.carrier = context, config, refusals, carrier
        self.types = types
        self.conversation = Conversation(context, context.name)
        self._writers: dict[str, tuple[str, Writer]] = {}
        self._heard: set[str] = set()
        self._command_topics: dict[tuple[str, str], Callable[[], None]] = {}
        self._offers: dict[tuple[str, str], Callable[[], None]] = {}
        self._parameters: ParameterServer | None = None
        self._actions: dict[tuple[str, str], Callable[[], None]] = {}
        facts = Facts(geoid_m=config.geoid_m, truth=config.truth, tf=config.tf)
        self.feed = Feed(context, refusals, self.types, facts, self._deliver, config.clock_hz, self._follow)

    # -- what there is ----------------------------------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        """Have the topics and services of the catalogue, and no others."""
        topics, catalogue, carrier = self.feed.topics, self.feed.catalogue, self.carrier
        for topic, (kind, writer) in list(self._writers.items()):
            if topics.get(topic) != kind:
                writer.close()
                self._hearing(topic, False)
                del self._writers[topic]
        for topic, kind in topics.items():
            if topic not in self._writers:
                writer = carrier.advertise(topic, kind, self.feed.is_latched(topic), self._hearing)
                self._writers[topic] = (kind, writer)
        # A new catalogue has new functions. What stays under its name and type looks them up when it is used.
        wanted = {(command_topic.name, command_topic.type) for command_topic in catalogue.command_topics.values()}
        _follow(
            self._command_topics, wanted, lambda topic, kind: carrier.listen(topic, kind, partial(self._command, topic))
        )
        if self._config.offers_services:
            self._follow_services()
        # It is always heard: its writer keeps the message for late subscribers.
        static = self.feed.hear(TF_STATIC) if TF_STATIC not in self._heard else None
        self._heard.add(TF_STATIC)
        if static is not None:
            self._deliver(TF_STATIC, static)

    def _follow_services(self) -> None:
        catalogue, carrier = self.feed.catalogue, self.carrier
        offered = {(offer.name, offer.type) for offer in catalogue.offers.values()}
        _follow(self._offers, offered, lambda name, kind: carrier.serve(name, kind, partial(self._serve, name)))
        if self._parameters is None:
            self._parameters = ParameterServer(self, f"/{self._config.node}")
        acting = {(action.name, action.type) for action in catalogue.actions.values()}
        _follow(self._actions, acting, lambda name, _: ActionServer(self, catalogue.actions[name]).close)

    def _hearing(self, topic: str, is_heard: bool) -> None:
        if topic == TF_STATIC or (topic in self._heard) == is_heard:
            return
        if is_heard:
            self._heard.add(topic)
            last = self.feed.hear(topic)
            if last is not None:
                self._deliver(topic, last)
        else:
            self._heard.discard(topic)
            self.feed.leave(topic)

    # -- out --------------------------------------------------------------------------------------------------------------------------------

    def _deliver(self, topic: str, outgoing: OutgoingMessage) -> None:
        known = self._writers.get(topic)
        if known is not None and outgoing.raw is not None:
            self.send(topic, known[1], outgoing.raw)

    def send(self, topic: str, writer: Writer, data: bytes) -> None:
        """Send a message of a topic; count one that cannot be sent."""
        stats = self._context.stats
        stats.encoded += 1
        try:
            if not writer.put(data):
                return
        except Exception as error:  # noqa: BLE001  # a fault of a closing session must not end the adapter
            stats.count_error(f"a message of {topic} could not be sent: {error}")
            log.debug("%s", stats.last_error)
            return
        stats.samples_sent += 1
        stats.bytes_sent += len(data)

    # -- in ---------------------------------------------------------------------------------------------------------------------------------

    def _command(self, topic: str, data: bytes, sender: str) -> None:
        command_topic = self.feed.catalogue.command_topics.get(topic)
        if command_topic is None:
            return

        def answered(reply: Reply) -> None:
            if reply.fault is not None:
                self.refuse(reply.fault.code, f"{topic}: {reply.fault.text}")

        try:
            value = command_topic.value(
                self.types.from_cdr(data, command_topic.type, self.types.most_bytes(command_topic.type))
            )
            command(self.conversation, command_topic, value, answered, source=f"{self._context.name}:{sender}")
        except BadMessage as bad:
            self.refuse("message", f"{topic}: {bad}")
        except Refused as refused:
            self.refuse(refused.fault.code, f"{topic}: {refused.fault.text}")

    def refuse(self, cause: str, text: str) -> None:
        """Count and log a request that was not carried out."""
        self._context.stats.errors += 1
        self._refusals.note(cause, text)

    def _serve(self, service: str, data: bytes, _: str, respond: Respond) -> None:
        """Carry out a request. One that cannot be read is answered too, as its client would wait for minutes."""
        offer = self.feed.catalogue.offers.get(service)
        if offer is None:
            return

        def answered(response: object | None, text: str) -> None:
            if text:
                self.refuse("service", f"{service}: {text}")
            if response is None:
                response = self.types.make(f"{offer.type}_Response", **self._reason(offer, text))
            respond(self.types.cdr(response))

        kind = f"{offer.type}_Request"
        try:
            request = self.types.from_cdr(data, kind, self.types.most_bytes(kind))
        except BadMessage as bad:
            answered(None, str(bad))
            return
        call(self.conversation, offer, request, answered)

    def _reason(self, offer: Offer, text: str) -> dict[str, object]:
        """Return the text in the field of a response that can hold it; nothing where its type has none."""
        fields = dict(self.types.fields(f"{offer.type}_Response"))
        if "message" in fields:
            return {"message": text}
        if "result" in fields:
            failed = self.types.make("simulation_interfaces/msg/Result", result=4, error_message=text)
            return {"result": failed}
        return {}

    async def close(self) -> None:
        """End all calls, and the feed."""
        self.conversation.close()
        await self.feed.close()


def _follow(
    ends: dict[tuple[str, str], Callable[[], None]], wanted: Set[tuple[str, str]],
    begin: Callable[[str, str], Callable[[], None]],
) -> None:  # fmt: skip
    """Begin what is wanted, and end what is not.

    Args:
        ends: what ends each thing that there is, by its name and type.
        wanted: names and types.
        begin: begins one, and returns what ends it.
    """
    for gone in ends.keys() - wanted:
        ends.pop(gone)()
    for new in wanted - ends.keys():
        ends[new] = begin(*new)
