"""Services over MOOS: a call is written to one variable, its answer to another, both latched.

``UWSERVER_CALL`` is ``[id] service [JSON arguments]`` or a JSON map ``{"id", "service", "args", "timeout_s"}``; ``UWSERVER_REPLY`` is a JSON map with
the same `id`, and either `value` and `tick`, or `error`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import Struct

from uwserver.adapter import AdapterContext
from uwserver.ports import Fault, Json, Progress, Refused, Reply

TIMEOUT_S = 10.0
OPEN = 64
"""Calls that may be under way."""
TEXT_LIMIT = 1 << 16

Answer = dict[str, Json]
"""`id`, `service`, `src`, and either `tick`, `t_ns` and `value`, or `error`."""


class Request(Struct, frozen=True):
    """A call as it was written."""

    service: str
    id: str | int | None = None
    args: dict[str, Any] = {}
    timeout_s: float = TIMEOUT_S


def parse(text: str) -> Request:
    """Read the variable.

    Raises:
        Refused: the text says what is wrong.
    """
    if len(text) > TEXT_LIMIT:
        raise Refused("too_large", f"a call of {len(text)} characters: the longest has {TEXT_LIMIT}")
    text = text.strip()
    try:
        if text.startswith("{"):
            return msgspec.json.decode(text.encode("utf-8", "replace"), type=Request)
        words = text.split(None, 1)
        id: str | None = None
        if words and "/" not in words[0]:
            id, words = words[0], words[1].split(None, 1) if len(words) > 1 else []
        if not words:
            raise Refused("invalid_request", 'write [id] service [arguments], as in 7 world/step {"n": 10}')
        args = msgspec.json.decode(words[1].encode("utf-8", "replace"), type=dict[str, Any]) if len(words) > 1 else {}
        return Request(words[0], id, args)
    except (msgspec.DecodeError, RecursionError) as error:
        raise Refused("parse_error", f"the arguments are no JSON map: {error}") from None


class Calls:
    """Calls under way. Loop thread.

    Args:
        context: where they go.
        reply: takes each answer.
    """

    def __init__(self, context: AdapterContext, reply: Callable[[Answer], None]) -> None:
        self._context = context
        self._reply = reply
        self._running: dict[object, Callable[[], bool]] = {}
        self._timers: dict[object, asyncio.TimerHandle] = {}

    def take(self, text: str, source: str, answer: Callable[[Answer], None] | None = None) -> None:
        """Begin a call, or say why not.

        Args:
            text: see `parse`.
            source: client that wrote it.
            answer: takes the one answer instead of `reply`.
        """
        stats = self._context.stats
        stats.calls += 1
        answer = answer or self._reply
        id: str | int | None = None
        service = ""
        try:
            request = parse(text)
            id, service = request.id, request.service
            if len(self._running) >= OPEN:
                raise Refused("overload", f"{OPEN} calls are under way: wait for some of them")
            if not 0.0 < request.timeout_s < 1e6:
                raise Refused("bad_argument", "timeout_s is a number of seconds above zero", "timeout_s")
            self._begin(request, source, answer)
        except Refused as refused:
            stats.errors += 1
            answer(_error(id, service, source, refused.fault))

    def _begin(self, request: Request, source: str, answer: Callable[[Answer], None]) -> None:
        token = object()
        is_done = is_late = False

        def on_reply(outcome: Reply | Progress) -> None:
            nonlocal is_done
            if isinstance(outcome, Progress) or is_done:
                return
            is_done = True
            self._running.pop(token, None)
            timer = self._timers.pop(token, None)
            if timer is not None:
                timer.cancel()
            fault = outcome.fault
            if fault is not None:
                if is_late:
                    text = f"not done within {request.timeout_s:g} s and cancelled: give a longer timeout_s"
                    fault = Fault("timeout", text, request.service)
                self._context.stats.errors += 1
                answer(_error(request.id, request.service, source, fault))
                return
            said: Answer = {"id": request.id, "service": request.service, "src": source, "tick": outcome.tick}
            answer({**said, "t_ns": outcome.t_ns, "value": outcome.result})

        def give_up() -> None:
            nonlocal is_late
            is_late = True
            if not cancel():
                # It cannot be taken back any more; its answer, when it comes, has nobody who waits for it.
                on_reply(Reply(0, 0, fault=Fault("timeout", "", request.service)))

        cancel = self._context.call(request.service, request.args, source, on_reply)
        if not is_done:
            self._running[token] = cancel
            self._timers[token] = asyncio.get_running_loop().call_later(request.timeout_s, give_up)

    def close(self) -> None:
        """Cancel what is under way; nobody is answered any more."""
        for timer in self._timers.values():
            timer.cancel()
        for cancel in list(self._running.values()):
            cancel()
        self._running.clear()
        self._timers.clear()


def _error(id: str | int | None, service: str, source: str, fault: Fault) -> Answer:
    error: Answer = {"code": fault.code, "message": fault.text, "where": fault.where}
    return {"id": id, "service": service, "src": source, "error": error}
