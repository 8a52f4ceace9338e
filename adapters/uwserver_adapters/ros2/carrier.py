"""What a transport does for a node of ROS 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


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
