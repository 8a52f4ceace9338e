"""The interface between a ROS 2 node, its transport, and the parts of the node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from uwserver.adapter import Conversation
from uwserver_adapters.ros.feed import Feed
from uwserver_adapters.ros.messages.types import BadMessage, Types


class Writer(Protocol):
    """Publishes one topic."""

    def put(self, data: bytes) -> bool:
        """Send a message; return whether it went out."""

    def close(self) -> None:
        """End the topic."""


Respond = Callable[[bytes], None]
"""Sends the response to a request."""
WAITING_BYTES = 16 << 20
"""Most bytes of messages and requests that wait for the loop."""
Heard = Callable[[str, bool], None]
"""Called on the loop with a topic when it gets its first subscriber (True) or loses its last one (False)."""


class Carrier(Protocol):
    """A transport; all on the loop."""

    def advertise(self, topic: str, type_name: str, latched: bool, heard: Heard) -> Writer:
        """Publish a topic."""

    def listen(self, topic: str, type_name: str, take: Callable[[bytes, str], None]) -> Callable[[], None]:
        """Subscribe to a topic; `take` gets each message and its sender. The returned function ends it."""

    def serve(self, service: str, type_name: str, take: Callable[[bytes, str, Respond], None]) -> Callable[[], None]:
        """Offer a service; `take` gets each request, its sender, and what sends the response. The returned function ends it."""


class Host(Protocol):
    """The node, as its actions and parameters see it; all on the loop.

    Attributes:
        types: message types of the distribution.
        carrier: its transport.
        conversation: all commands and calls to the world are made in it.
        feed: topics, services, actions and settings of the world.
    """

    types: Types
    carrier: Carrier
    conversation: Conversation
    feed: Feed

    def send(self, topic: str, writer: Writer, data: bytes) -> None:
        """Send a message of a topic."""

    def refuse(self, cause: str, text: str) -> None:
        """Count and log a request that was not carried out."""


Answer = Callable[..., None]
"""Sends the response with these fields."""


def serve(host: Host, name: str, kind: str, act: Callable[[Any, Answer], None], **unread: object) -> Callable[[], None]:
    """Offer a service of the node.

    A request that cannot be read is answered too, as its client would wait for minutes.

    Args:
        host: the node.
        name: name of the service.
        kind: its type, ``package/srv/Name``.
        act: gets each request and what sends its response. May raise `BadMessage` before it responds.
        unread: fields of the response to a request that is wrong.

    Returns:
        A function that ends the service.
    """
    types, request = host.types, f"{kind}_Request"

    def take(data: bytes, _: str, respond: Respond) -> None:
        def answer(**fields: object) -> None:
            respond(types.cdr(types.make(f"{kind}_Response", **fields)))

        try:
            act(types.from_cdr(data, request, types.most_bytes(request)), answer)
        except BadMessage as bad:
            host.refuse("message", f"{name}: {bad}")
            answer(**unread)

    return host.carrier.serve(name, kind, take)
