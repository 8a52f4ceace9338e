"""What a transport does for a node of ROS 2, and what the parts of the node may ask of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from uwserver.adapter import Conversation
from uwserver_adapters.ros.messages.actions import Action
from uwserver_adapters.ros.messages.settings import Setting
from uwserver_adapters.ros.messages.types import Types


class Writer(Protocol):
    """A topic's way out."""

    def put(self, data: bytes) -> bool:
        """Send a message; whether it went out."""

    def close(self) -> None:
        """The topic has gone."""


Respond = Callable[[bytes], None]
"""Sends the response to a request."""
WAITING_BYTES = 16 << 20
"""Of messages and requests that wait for the loop."""
Heard = Callable[[str, bool], None]
"""Told on the loop that somebody listens to a topic, or nobody any more."""


class Carrier(Protocol):
    """What a transport does for a node; all on the loop."""

    def advertise(self, topic: str, type_name: str, latched: bool, heard: Heard) -> Writer:
        """A topic of the node's."""

    def listen(self, topic: str, type_name: str, take: Callable[[bytes, str], None]) -> Callable[[], None]:
        """Take a topic's messages, with who sent each; the returned function ends it."""

    def serve(self, service: str, type_name: str, take: Callable[[bytes, str, Respond], None]) -> Callable[[], None]:
        """Offer a service; the returned function ends it."""


class Host(Protocol):
    """The node, as its actions and parameters see it; all on the loop.

    Attributes:
        types: of the distribution.
        carrier: its transport.
        conversation: in which all is asked of the world.
    """

    types: Types
    carrier: Carrier
    conversation: Conversation

    def send(self, topic: str, writer: Writer, data: bytes) -> None:
        """A message of a topic."""

    def refuse(self, cause: str, text: str) -> None:
        """What a peer asked for was not done: counted and told."""

    def stamp(self) -> Any:
        """The time."""

    def action(self, name: str) -> Action | None:
        """The action as the world has it now."""

    def settings(self) -> Mapping[str, Setting]:
        """Parameters as the world has them now."""
