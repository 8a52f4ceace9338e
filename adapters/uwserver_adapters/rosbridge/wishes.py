"""What a client's message asks for, read and bounded: what is kept of it is short."""

from __future__ import annotations

from typing import Any

from uwserver_adapters.rosbridge.codec import COMPRESSIONS
from uwserver_adapters.rosbridge.subscriptions import LONGEST_QUEUE, Wish

LONGEST_NAME = 256
"""Characters of a name, a type or an id: these are kept."""
LEAST_PIECE = 1024
"""Characters of a piece, at least: each costs more than its characters."""

Map = dict[str, Any]


class Wrong(Exception):
    """What a client asked for cannot be done; it is told why."""


def topic_name(message: Map) -> str:
    """The topic that it is about."""
    topic = message.get("topic")
    if not isinstance(topic, str) or not topic.strip("/"):
        raise Wrong(f'{message.get("op")} needs a "topic"')
    if len(topic) > LONGEST_NAME:
        raise Wrong(f"a topic has at most {LONGEST_NAME} characters")
    return "/" + topic.strip("/")


def service_name(message: Map) -> str:
    """The service that it is about."""
    name = str(message.get("service", ""))
    if len(name) > LONGEST_NAME:
        raise Wrong(f"a service has at most {LONGEST_NAME} characters")
    return "/" + name.strip("/")


def action_name(message: Map) -> str:
    """The action that it is about; what follows a # is for the client."""
    name = message.get("action")
    if not isinstance(name, str) or not name.strip("/"):
        raise Wrong(f'{message.get("op")} needs an "action"')
    if len(name) > LONGEST_NAME:
        raise Wrong(f"an action has at most {LONGEST_NAME} characters")
    return "/" + name.partition("#")[0].strip("/")


def shorten(message: Map) -> None:
    """Ids are kept, and said again: nothing long, and no number that cannot be said."""
    key = message.get("id")
    if isinstance(key, str) and len(key) > LONGEST_NAME:
        del message["id"]
        raise Wrong(f"an id has at most {LONGEST_NAME} characters")
    if not (key is None or isinstance(key, str | float) or (isinstance(key, int) and abs(key) < 1 << 63)):
        message["id"] = str(key)[:200]


def answerable(message: Map) -> Map:
    """What is kept of a call until it is answered."""
    try:
        wish_of(message)
    except Wrong:
        return {"id": message.get("id")}
    return {key: message.get(key) for key in ("id", "compression", "fragment_size")}


def wish_of(message: Map) -> Wish:
    """In which form the client wants what it asks for."""
    compression = message.get("compression") or "none"
    if compression not in COMPRESSIONS:
        raise Wrong(f"compression is one of {', '.join(COMPRESSIONS)}, not {compression!r:.60}")
    throttle = _whole(message, "throttle_rate", 0, 3_600_000)
    queue = _whole(message, "queue_length", 0, 1 << 31)
    size = _whole(message, "fragment_size", 0, 1 << 31)
    return Wish(throttle / 1000.0, min(queue, LONGEST_QUEUE), max(size, LEAST_PIECE) if size else None, compression)


def _whole(message: Map, key: str, low: int, high: int) -> int:
    value = message.get(key)
    if value is None:
        return 0
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise Wrong(f"{key} must be a number from {low} to {high}, not {value!r:.60}")
    return int(value)
