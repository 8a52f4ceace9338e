"""What all clients share: the topics of the world and of clients, and the services and actions that clients offer to each other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

from uwserver.adapter import AdapterContext, Refusals
from uwserver.ports import Event, Sample
from uwserver_adapters.ros.feed import Feed, OutgoingMessage
from uwserver_adapters.ros.messages import Facts, Types
from uwserver_adapters.rosbridge.config import RosbridgeConfig
from uwserver_adapters.rosbridge.subscriptions import ClientMessage, TopicMessage, WorldMessage

TOPICS = 4096
"""Most topics that clients may have advertised, all together."""


class Client(Protocol):
    """A session, as other sessions see it."""

    name: str

    def hear(self, topic: str, message: TopicMessage) -> None:
        """Take a message of a topic to which it subscribes."""

    def serve(self, service: str, args: object, answer: Callable[[bool, object], None]) -> None:
        """Carry out a call of a service that it offers; `answer` gets whether it succeeded, and the values."""

    def flush(self) -> None:
        """Send what waits."""


class Performer(Protocol):
    """Carries out the goals of actions that a client offers."""

    def perform(
        self,
        name: str,
        args: object,
        wants_feedback: bool,
        feedback: Callable[[object], None],
        end: Callable[[int, object, bool], None],
    ) -> Callable[[], None]:
        """See `uwserver_adapters.rosbridge.actions.Offers.perform`."""


class Hub:
    """Passes messages between the world and the clients. It is the adapter's `Subscriber`.

    Args:
        context: the world.
        config: config of the adapter.
        refusals: counts what is refused.

    Attributes:
        context, config, refusals: as given.
        types: message types of the distribution.
        feed: topics and services of the world.
        advertised: topics of clients -> type and advertisers.
        served: services of clients -> type and the client that offers it.
        acting: actions of clients -> type and what carries out its goals.
    """

    def __init__(self, context: AdapterContext, config: RosbridgeConfig, refusals: Refusals) -> None:
        self.context, self.config, self.refusals = context, config, refusals
        self.types = Types(config.ros_distro)
        facts = Facts(geoid_m=config.geoid_m, truth=config.truth, tf=config.tf)
        self.feed = Feed(context, refusals, self.types, facts, self._deliver, config.clock_hz)
        self.advertised: dict[str, tuple[str, set[Client]]] = {}
        self.served: dict[str, tuple[str, Client]] = {}
        self.acting: dict[str, tuple[str, Performer]] = {}
        self._listeners: dict[str, dict[Client, None]] = {}
        self._due: dict[Client, None] = {}

    # -- topics ---------------------------------------------------------------------------------------------------------------------------

    def type_of(self, topic: str) -> str:
        """Return the type of a topic that is published or taken here; "" where there is none."""
        command_topic = self.feed.catalogue.command_topics.get(topic)
        if command_topic is not None:
            return command_topic.type
        return self.feed.topics.get(topic) or self.advertised.get(topic, ("",))[0]

    def topics(self) -> Mapping[str, str]:
        """Return all topics -> type."""
        command_topics = {
            topic: command_topic.type for topic, command_topic in self.feed.catalogue.command_topics.items()
        }
        return {**{topic: kind for topic, (kind, _) in self.advertised.items()}, **command_topics, **self.feed.topics}

    def subscribe(self, client: Client, topic: str) -> TopicMessage | None:
        """Let a client hear a topic, once; return the newest message where late subscribers get it."""
        listeners = self._listeners.setdefault(topic, {})
        if client in listeners:
            return None
        listeners[client] = None
        last = self.feed.hear(topic)
        return None if last is None else self._of_world(last)

    def unsubscribe(self, client: Client, topic: str) -> None:
        """Let a client hear a topic no more."""
        listeners = self._listeners.get(topic, {})
        if client in listeners:
            del listeners[client]
            self.feed.leave(topic)
        if not listeners:
            self._listeners.pop(topic, None)

    def listeners(self, topic: str) -> list[str]:
        """Return the names of the clients that hear a topic."""
        return [client.name for client in self._listeners.get(topic, ())]

    def unadvertise(self, client: Client, topic: str) -> None:
        """Let a client publish a topic no more; without advertisers the topic goes."""
        _, advertisers = self.advertised.get(topic, ("", set()))
        advertisers.discard(client)
        if not advertisers:
            self.advertised.pop(topic, None)

    def relay(self, topic: str, message: dict[str, Any]) -> None:
        """Pass a client's message to the clients that hear its topic."""
        passed = ClientMessage(message)
        for client in tuple(self._listeners.get(topic, ())):
            client.hear(topic, passed)
            client.flush()

    def leave(self, client: Client) -> None:
        """Remove a client that has gone, with its subscriptions, topics and services."""
        for topic in list(self._listeners):
            self.unsubscribe(client, topic)
        for topic in list(self.advertised):
            self.unadvertise(client, topic)
        self.served = {name: offered for name, offered in self.served.items() if offered[1] is not client}
        self._due.pop(client, None)

    # -- the world ------------------------------------------------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> Collection[str]:
        """Ports whose samples are needed."""
        return self.feed.subscriptions

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Take the samples of one tick."""
        self.feed.put_samples(samples)

    def send_samples(self) -> None:
        """Send the messages of the ticks until now together: no more samples wait."""
        due, self._due = self._due, {}
        for client in due:
            client.flush()

    def put_event(self, event: Event) -> None:
        """Follow a change of ports or of time."""
        self.feed.put_event(event)

    def _of_world(self, outgoing: OutgoingMessage) -> WorldMessage:
        return WorldMessage(outgoing, self.feed.catalogue.facts.epoch_ns + self.feed.t_ns)

    def _deliver(self, topic: str, outgoing: OutgoingMessage) -> None:
        listeners = self._listeners.get(topic)
        if not listeners:
            return
        message = self._of_world(outgoing)
        self.context.stats.encoded += 1
        for client in tuple(listeners):
            client.hear(topic, message)
            self._due[client] = None
