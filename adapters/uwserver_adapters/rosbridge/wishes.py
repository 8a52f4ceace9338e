"""Reads the parts of a client's message, and bounds what is kept of it."""

from __future__ import annotations

from typing import Any, NamedTuple

from uwserver_adapters.ros.messages.plain import built
from uwserver_adapters.ros.messages.types import Types, full_name
from uwserver_adapters.rosbridge.codec import COMPRESSIONS
from uwserver_adapters.rosbridge.subscriptions import LONGEST_QUEUE, Options

LONGEST_NAME = 256
"""Longest name, type or id, characters: these are kept."""
LEAST_PIECE = 1024
"""Shortest limit for the pieces of a message, characters: each piece costs more than its characters."""

Map = dict[str, Any]


class BadRequest(Exception):
    """A request of a client cannot be carried out; the client is told the text."""


class Asked(NamedTuple):
    """What is kept of a request until it is answered.

    Attributes:
        id: id of the request; None where it has none.
        options: the form in which the answer is sent.
    """

    id: object
    options: Options


def asked_of(message: Map) -> Asked:
    """Return what is kept of a request. Where its options are wrong it is answered in the default form."""
    try:
        return Asked(message.get("id"), options_of(message))
    except BadRequest:
        return Asked(message.get("id"), Options())


def name_of(message: Map, key: str) -> str:
    """Return the topic, service or action that a message names.

    Args:
        message: message of the client.
        key: "topic", "service" or "action".

    Raises:
        BadRequest: it names none, or the name is too long.
    """
    name, article = message.get(key), "an" if key == "action" else "a"
    if not isinstance(name, str) or not name.strip("/"):
        raise BadRequest(f'{message.get("op")} needs {article} "{key}"')
    if len(name) > LONGEST_NAME:
        raise BadRequest(f"{article} {key} has at most {LONGEST_NAME} characters")
    return "/" + name.strip("/")


def action_name(message: Map) -> str:
    """Return the action that a message names. What follows a # in the name only matters to its client.

    Raises:
        BadRequest: it names none, or the name is too long.
    """
    return "/" + name_of(message, "action").partition("#")[0].strip("/")


def offered_type(message: Map, kind: str) -> str:
    """Return the full name of the type of a service or action that a client offers.

    Args:
        message: message of the client.
        kind: "srv" or "action".

    Raises:
        BadRequest: it has no type, or one that is too long.
    """
    name = message.get("type")
    if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME:
        raise BadRequest(f'{message.get("op")} needs a "type" of at most {LONGEST_NAME} characters')
    return full_name(name, kind)


def arguments(types: Types, type_name: str, args: Any) -> Any:
    """Return the message that a client gives as a map, or as a list in the order of the fields.

    Raises:
        BadMessage: it is not of this type.
    """
    if isinstance(args, list):
        args = dict(zip((field for field, _ in types.fields(type_name)), args, strict=False))
    return built(types, type_name, args or {})


def shorten(message: Map) -> None:
    """Check the id of a message, as ids are kept and repeated in answers. An id that is no text or plain number becomes a text.

    Raises:
        BadRequest: it is too long; it is removed.
    """
    key = message.get("id")
    if isinstance(key, str) and len(key) > LONGEST_NAME:
        del message["id"]
        raise BadRequest(f"an id has at most {LONGEST_NAME} characters")
    if not (key is None or isinstance(key, str | float) or (isinstance(key, int) and abs(key) < 1 << 63)):
        message["id"] = str(key)[:200]


def options_of(message: Map) -> Options:
    """Return the options of a message.

    Raises:
        BadRequest: one of them is wrong.
    """
    compression = message.get("compression") or "none"
    if compression not in COMPRESSIONS:
        raise BadRequest(f"compression is one of {', '.join(COMPRESSIONS)}, not {compression!r:.60}")
    throttle = _whole(message, "throttle_rate", 0, 3_600_000)
    queue = _whole(message, "queue_length", 0, 1 << 31)
    size = _whole(message, "fragment_size", 0, 1 << 31)
    return Options(throttle / 1000.0, min(queue, LONGEST_QUEUE), max(size, LEAST_PIECE) if size else None, compression)


def _whole(message: Map, key: str, low: int, high: int) -> int:
    value = message.get(key)
    if value is None:
        return 0
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise BadRequest(f"{key} must be a number from {low} to {high}, not {value!r:.60}")
    return int(value)
