"""Services over MOOS: a call is written to one variable, and its answer to another.

``UWSERVER_CALL`` is ``[id] service [JSON arguments]`` or a JSON map ``{"id", "service", "args", "timeout_s"}``; ``UWSERVER_REPLY`` is a JSON map with
the same `id`, and either `value` and `tick`, or `error`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
from msgspec import Struct

from uwserver.adapter import AdapterContext, Conversation, InFlightLimit, Undecodable, decode, json_member
from uwserver.ports import Fault, Json, Refused, Reply

TIMEOUT_S = 10.0
"""Wall time in which a call must be done, unless it says otherwise."""
OPEN = 64
"""Most calls under way at the same time."""
TEXT_LIMIT = 1 << 16
"""Longest call, characters."""

T = TypeVar("T")
Answer = dict[str, Json]
"""`id`, `service`, `src`, and either `tick`, `t_ns` and `value`, or `error`."""


class Request(Struct, frozen=True):
    """A call as it was written."""

    service: str
    id: str | int | None = None
    args: dict[str, Any] = {}
    timeout_s: float = TIMEOUT_S


def parse(text: str) -> Request:
    """Parse a call.

    Raises:
        Refused: the text says what is wrong.
    """
    if len(text) > TEXT_LIMIT:
        raise Refused("too_large", f"a call of {len(text)} characters: the longest has {TEXT_LIMIT}")
    text = text.strip()
    if text.startswith("{"):
        return _converted(text, Request)
    id, service, args = words(text)
    if not service:
        raise Refused("invalid_request", 'write [id] service [arguments], as in 7 world/step {"n": 10}')
    return Request(service, id, _converted(args, dict[str, Any]) if args else {})


def words(text: str) -> tuple[str | None, str, str]:
    """Return id, service and arguments of the short form. The id is None where there is none; the others may be empty."""
    first, rest = (*text.split(None, 1), "", "")[:2]
    if not first or "/" in first:
        return None, first, rest
    service, args = (*rest.split(None, 1), "", "")[:2]
    return first, service, args


def id_of(text: str) -> str | int | None:
    """Return the id of a call that cannot be read; None where it has none."""
    text = text[:TEXT_LIMIT].strip()
    return json_member(text.encode("utf-8", "replace"), "id") if text.startswith("{") else words(text)[0]


def _converted(text: str, kind: type[T]) -> T:
    try:
        return msgspec.convert(decode(text.encode("utf-8", "replace"), "json"), kind)
    except Undecodable as error:
        raise Refused(error.fault.code, f"the arguments are no JSON map that is taken: {error}") from None
    except msgspec.ValidationError as error:
        raise Refused("parse_error", f"the arguments are no JSON map: {error}") from None


class Calls:
    """Calls under way. Loop thread.

    Args:
        context: where they go.
    """

    def __init__(self, context: AdapterContext) -> None:
        self._stats = context.stats
        self._peer = Conversation(context, "", InFlightLimit(OPEN))

    @property
    def waiting(self) -> int:
        """Number of calls that wait for their answer."""
        return self._peer.in_flight.count

    def take(self, text: str, source: str, answer: Callable[[Answer], None], refusal: Fault | None = None) -> None:
        """Begin a call, or answer why not.

        Args:
            text: see `parse`.
            source: client that wrote it.
            answer: gets the one answer.
            refusal: why the call shall not even begin.
        """
        request = Request("", id_of(text))

        def tell(**outcome: Json) -> None:
            answer({"id": request.id, "service": request.service, "src": source, **outcome})

        def fail(fault: Fault) -> None:
            self._stats.errors += 1
            tell(error={"code": fault.code, "message": fault.text, "where": fault.where})

        def on_answer(reply: Reply) -> None:
            if reply.fault is not None:
                fail(reply.fault)
            else:
                tell(tick=reply.tick, t_ns=reply.t_ns, value=reply.result)

        if refusal is not None:
            fail(refusal)
            return
        try:
            request = parse(text)
            if not 0.0 < request.timeout_s < 1e6:
                raise Refused("bad_argument", "timeout_s is a number of seconds above zero", "timeout_s")
            self._peer.call(request.service, request.args, on_answer, timeout_s=request.timeout_s, source=source)
        except Refused as refused:
            fail(refused.fault)

    def close(self) -> None:
        """Cancel all calls; nobody is answered any more."""
        self._peer.close()
