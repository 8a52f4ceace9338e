"""The node: which topics and services it has on its transport, and what passes between these and the world. Loop thread."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from uwserver.adapter import AdapterContext, Conversation, Refusals
from uwserver.ports import Event, Refused, Reply, Sample
from uwserver_adapters.ros.feed import Feed, Told, call, command
from uwserver_adapters.ros.messages.actions import Action
from uwserver_adapters.ros.messages.commands import Inlet
from uwserver_adapters.ros.messages.services import Offer
from uwserver_adapters.ros.messages.settings import Setting
from uwserver_adapters.ros.messages.source import Facts
from uwserver_adapters.ros.messages.types import BadMessage, Types
from uwserver_adapters.ros2.actions import ActionServer
from uwserver_adapters.ros2.carrier import Carrier, Respond, Writer
from uwserver_adapters.ros2.config import Ros2Config
from uwserver_adapters.ros2.parameters import ParameterServer

log = logging.getLogger(__name__)


class Node:
    """The adapter's `Subscriber`.

    Args:
        context: the world.
        config: of the adapter.
        refusals: counts what is refused.
        carrier: the transport, open.
        types: of the distribution.

    Attributes:
        types, carrier: as given.
        feed: of the world.
        conversation: in which all is asked of it.
    """

    def __init__(
        self, context: AdapterContext, config: Ros2Config, refusals: Refusals, carrier: Carrier, types: Types
    ) -> None:
        self._context, self._config, self._refusals, self.carrier = context, config, refusals, carrier
        self.types = types
        self.conversation = Conversation(context, context.name)
        self._writers: dict[str, tuple[str, Writer]] = {}
        self._heard: set[str] = set()
        self._inlets: dict[tuple[str, str], Callable[[], None]] = {}
        self._offers: dict[tuple[str, str], Callable[[], None]] = {}
        self._parameters: ParameterServer | None = None
        self._actions: dict[tuple[str, str], ActionServer] = {}
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
                self._writers[topic] = (
                    kind,
                    carrier.advertise(topic, kind, self.feed.is_latched(topic), self._hearing),
                )
        # Functions of the catalogue are new with each; what is there under the same name and type asks for the newest.
        wanted = {(inlet.topic, inlet.type) for inlet in catalogue.inlets.values()}
        _close_others(self._inlets, wanted)
        for topic, kind in wanted - self._inlets.keys():
            self._inlets[topic, kind] = carrier.listen(topic, kind, self._taker(topic))
        self._follow_services()
        static = self.feed.hear("/tf_static") if "/tf_static" not in self._heard else None
        self._heard.add("/tf_static")
        if static is not None:
            self._deliver("/tf_static", static)

    def _follow_services(self) -> None:
        if not self._config.offers_services:
            return
        catalogue, carrier = self.feed.catalogue, self.carrier
        offered = {(o.name, o.type) for o in catalogue.offers.values()}
        _close_others(self._offers, offered)
        for service, kind in offered - self._offers.keys():
            self._offers[service, kind] = carrier.serve(service, kind, self._server(service))
        if self._parameters is None:
            self._parameters = ParameterServer(self, f"/{self._config.node}")
        actions = {(a.name, a.type): a for a in catalogue.actions.values()}
        for gone in self._actions.keys() - actions.keys():
            self._actions.pop(gone).close()
        for new in actions.keys() - self._actions.keys():
            self._actions[new] = ActionServer(self, actions[new])

    def _hearing(self, topic: str, is_heard: bool) -> None:
        if topic == "/tf_static" or (topic in self._heard) == is_heard:
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

    def _deliver(self, topic: str, told: Told) -> None:
        known = self._writers.get(topic)
        if known is None:
            return
        data = told.raw
        if data is not None:
            self.send(topic, known[1], data)

    def send(self, topic: str, writer: Writer, data: bytes) -> None:
        """A message of a topic goes out; one that cannot is counted."""
        stats = self._context.stats
        stats.encoded += 1
        try:
            if not writer.put(data):
                return
        except Exception as error:  # noqa: BLE001  # a fault of a closing session must not end the adapter
            stats.errors += 1
            stats.last_error = f"a message of {topic} could not be sent: {error}"
            log.debug("%s", stats.last_error)
            return
        stats.samples_sent += 1
        stats.bytes_sent += len(data)

    @property
    def wanted(self) -> Collection[str]:
        """Ports whose samples are needed."""
        return self.feed.wanted

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Samples of one tick."""
        self.feed.put_samples(samples)

    def put_event(self, event: Event) -> None:
        """Other ports, or another time."""
        self.feed.put_event(event)

    # -- in ---------------------------------------------------------------------------------------------------------------------------------

    def _taker(self, topic: str) -> Callable[[bytes, str], None]:
        def take(data: bytes, sender: str) -> None:
            inlet = self.feed.catalogue.inlets.get(topic)
            if inlet is not None:
                self._command(inlet, data, sender)

        return take

    def _command(self, inlet: Inlet, data: bytes, sender: str) -> None:
        def answered(reply: Reply) -> None:
            if reply.fault is not None:
                self.refuse(reply.fault.code, f"{inlet.topic}: {reply.fault.text}")

        try:
            value = inlet.value(self.types.from_cdr(data, inlet.type, self.types.most_bytes(inlet.type)))
            command(self.conversation, inlet, value, answered, source=f"{self._context.name}:{sender}")
        except BadMessage as bad:
            self.refuse("message", f"{inlet.topic}: {bad}")
        except Refused as refused:
            self.refuse(refused.fault.code, f"{inlet.topic}: {refused.fault.text}")

    def refuse(self, cause: str, text: str) -> None:
        """What a peer asked for was not done."""
        self._context.stats.errors += 1
        self._refusals.note(cause, text)

    def _server(self, service: str) -> Callable[[bytes, str, Respond], None]:
        def take(data: bytes, sender: str, respond: Respond) -> None:
            offer = self.feed.catalogue.offers.get(service)
            if offer is not None:
                self._serve(offer, data, respond)

        return take

    def _serve(self, offer: Offer, data: bytes, respond: Respond) -> None:
        """A client of ROS waits for minutes where no response comes: what cannot be read is answered, too."""

        def answered(response: object | None, text: str) -> None:
            if text:
                self.refuse("service", f"{offer.name}: {text}")
            if response is None:
                response = self.types.make(f"{offer.type}_Response", **self._says_why(offer, text))
            respond(self.types.cdr(response))

        kind = f"{offer.type}_Request"
        try:
            request = self.types.from_cdr(data, kind, self.types.most_bytes(kind))
        except BadMessage as bad:
            answered(None, str(bad))
            return
        call(self.conversation, offer, request, answered)

    def _says_why(self, offer: Offer, text: str) -> dict[str, object]:
        """The field of a response that holds a text, where its type has one."""
        fields = {name for name, _ in self.types.fields(f"{offer.type}_Response")}
        if "message" in fields:
            return {"message": text}
        if "result" in fields:
            failed = self.types.make("simulation_interfaces/msg/Result", result=4, error_message=text)
            return {"result": failed}
        return {}

    def stamp(self) -> Any:
        """The time of the simulation, as a message."""
        return self.types.stamp(self.feed.now_ns())

    def action(self, name: str) -> Action | None:
        """The action as the world has it now."""
        return self.feed.catalogue.actions.get(name)

    def settings(self) -> Mapping[str, Setting]:
        """Parameters as the world has them now."""
        return self.feed.catalogue.settings

    async def close(self) -> None:
        """It has gone."""
        self.conversation.close()
        await self.feed.close()


def _close_others(there: dict[tuple[str, str], Callable[[], None]], wanted: Collection[tuple[str, str]]) -> None:
    for key in [key for key in there if key not in wanted]:
        there.pop(key)()
