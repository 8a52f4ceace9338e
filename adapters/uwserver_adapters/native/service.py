"""What all clients of one adapter share, whatever carries their bytes: the token, limits, samples, refusals, and the methods of the protocol.

The methods are those of docs/reference/protocol.md. Each gets a session and a request, and returns the result, or `LATER`. Params are read with
their types: every mistake is a `Refused` that names the parameter, what it must be, and what came.
"""

from __future__ import annotations

import asyncio
import hmac
import itertools
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from uwserver.adapter import AdapterContext, Lockout, Refusals, check_path, did_you_mean, install_command
from uwserver.adapter.pictures import EXTRA, can_encode_jpeg
from uwserver.ports import Fault, Json, Refused, Reply
from uwserver_adapters.native.codec import Codec
from uwserver_adapters.native.fanout import Fanout, has_any
from uwserver_adapters.native.messages import Request
from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.native.session import Allowance, Session
from uwserver_adapters.native.shares import Subscription

NAME_LIMIT = 256
"""Longest port, service, pattern, field or client name, characters."""

Params = dict[str, object]
VERSION = 1
LATER: Final = object()
"""The result of a method whose answer comes later, from the world."""


def params_of(request: Request, names: Sequence[str]) -> Params:
    """Return the params as a map, in which only `names` may be keys."""
    params = request.params
    if params is None:
        return {}
    if not isinstance(params, dict):
        raise Refused("bad_argument", f'"params" of "{request.method}" must be a map', "params")
    for key in params:
        if key not in names:
            text = f'"{request.method}" has no parameter "{key}"{did_you_mean(str(key), names)}; it takes: {", ".join(names) or "none"}'
            raise Refused("bad_argument", text, str(key))
    return params


def name(params: Params, key: str, what: str) -> str:
    """Return a text that must be there."""
    value = params.get(key)
    if isinstance(value, str) and 0 < len(value) <= NAME_LIMIT:
        return value
    raise Refused("bad_argument", f'"{key}" must be {what}, a text of 1 to {NAME_LIMIT} characters', key)


def optional_name(params: Params, key: str, what: str) -> str | None:
    """Return a text that may be missing or null."""
    return None if params.get(key) is None else name(params, key, what)


def names(params: Params, key: str, what: str) -> tuple[str, ...] | None:
    """Return a list of texts that may be missing or null."""
    value = params.get(key)
    if value is None:
        return None
    if isinstance(value, list) and 0 < len(value) <= NAME_LIMIT and all(isinstance(entry, str) for entry in value):
        return tuple(dict.fromkeys(value))
    raise Refused("bad_argument", f'"{key}" must be {what}, a list of texts', key)


def positive(params: Params, key: str, what: str) -> float | None:
    """Return a finite number above zero that may be missing or null."""
    value = params.get(key)
    if value is None:
        return None
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # an integer of hundreds of digits
            number = math.inf
        if math.isfinite(number) and number > 0.0:
            return number
    raise Refused("bad_argument", f'"{key}" must be {what}, a number above zero', key)


log = logging.getLogger(__name__)


class _Rejected(Refused):
    """The version or token is wrong, and the connection must end with this fault."""


def take(session: Session, request: Request, token: str | None) -> Fault | None:
    """Carry out a request and queue its answer. It never raises: a fault of ours is logged, and answered with `internal`.

    Returns:
        The fault with which the connection must end; None if it goes on.
    """
    try:
        result = _carry_out(session, request, token)
    except Refused as refused:
        session.refuse(request.id, refused.fault)
        return refused.fault if isinstance(refused, _Rejected) else None
    except Exception:
        # A fault of ours must not end the adapter.
        log.exception("%s of client %s failed", request.method[:NAME_LIMIT], session.conversation.source)
        session.refuse(
            request.id, Fault("internal", "the server failed to carry this out: please report it with the server's log")
        )
    else:
        if result is not LATER:
            session.reply(request.id, result)
    return None


def _carry_out(session: Session, request: Request, token: str | None) -> object:
    if request.method == "hello":
        return _hello(session, request, token)
    if not session.admitted:
        raise Refused("denied", 'this server wants a token: send "hello" with "version" and "token" first', "token")
    verb = _VERBS.get(request.method)
    if verb is None:
        known = ("hello", *_VERBS)
        hint = did_you_mean(request.method, known)
        raise Refused("unknown_method", f'no method "{request.method}"{hint}; there are: {", ".join(known)}', "method")
    return verb(session, request)


def _hello(session: Session, request: Request, token: str | None) -> object:
    params = params_of(request, ("version", "name", "token"))
    version = params.get("version")
    if "version" not in params:
        raise Refused("bad_argument", f'"hello" needs "version": {VERSION}', "version")
    if version != VERSION or isinstance(version, bool):
        text = f"this server speaks version {VERSION} of the protocol, not {str(version)[:20]}: use a client of its release"
        raise _Rejected("version", text, "version")
    if token is not None:
        given = params.get("token")
        if not isinstance(given, str) or not hmac.compare_digest(given.encode("utf-8", "replace"), token.encode()):
            text = "the token is missing or wrong: use the one that the server was given (UWSERVER_TOKEN) or printed when it started"
            raise _Rejected("denied", text, "token")
    if session.greeted:
        raise Refused("invalid_request", '"hello" was said before: once is enough', "hello")
    session.greet(optional_name(params, "name", "the client's name"))
    common = session.context.hello()
    return {"version": VERSION, **common, "session": session.serial, "encoding": session.codec.encoding.name}


def _describe(session: Session, request: Request) -> object:
    params = params_of(request, ("pattern",))
    pattern = optional_name(params, "pattern", "a pattern of paths") or "**"
    return session.fanout.described(pattern, session.codec.encoding)


def _subscribe(session: Session, request: Request) -> object:
    params = params_of(request, ("pattern", "rate_hz", "fields", "delivery", "pictures"))
    pattern = name(params, "pattern", "a path, or a pattern of paths with * and **")
    rate_hz = positive(params, "rate_hz", "samples a second of simulation time")
    fields = names(params, "fields", "names of fields")
    delivery = params.get("delivery", "ring")
    if delivery not in session.outbox.deliveries:
        raise Refused("bad_argument", f'"delivery" is here one of {", ".join(session.outbox.deliveries)}', "delivery")
    is_jpeg = _is_jpeg(params.get("pictures", "raw"))
    most = session.allowance.subscriptions
    if len(session.subscriptions) >= most:
        text = f"{most} subscriptions are the most a client can have: unsubscribe, or use one pattern for many"
        raise Refused("overload", text, "pattern")
    _check_coverage(session, pattern, fields)
    there = sum(len(subscription.paths) for subscription in session.subscriptions.values())
    covered = session.fanout.most_covered()
    if there + len(session.fanout.covered(pattern)) > covered:
        text = (
            f"all subscriptions of a client cover {covered} ports at most, a port counted for each of them, and these cover {there}: "
            "unsubscribe, or name the ports"
        )
        raise Refused("overload", text, "pattern")
    subscription = Subscription(next(session.serials), pattern, rate_hz, fields, delivery, is_jpeg)
    session.fanout.add(session, subscription)
    session.subscriptions[subscription.serial] = subscription
    return {"subscription": subscription.serial, "ports": subscription.paths}


def _is_jpeg(form: object) -> bool:
    if form not in ("raw", "jpeg"):
        raise Refused("bad_argument", '"pictures" is "raw" or "jpeg"', "pictures")
    if form == "jpeg" and not can_encode_jpeg():
        raise Refused(
            "bad_argument", f"JPEG needs a library for it where the server runs: {install_command(EXTRA)}", "pictures"
        )
    return form == "jpeg"


def _check_coverage(session: Session, pattern: str, fields: tuple[str, ...] | None) -> None:
    ports = session.context.ports
    covered = session.fanout.covered(pattern)
    if not covered and "*" not in pattern:
        if pattern in ports:
            raise Refused(
                "bad_argument", f'"{pattern}" is an actuator: it gives no samples, send it a "command"', pattern
            )
        check_path("port", pattern, ports)
    for field in fields or ():
        if covered and not any(has_any(ports[path], (field,)) for path in covered):
            there = list(dict.fromkeys(known.name for path in covered for known in ports[path].fields))
            hint = did_you_mean(field, there)
            text = f'no port of "{pattern}" has a field "{field[:NAME_LIMIT]}"{hint}; there are: {", ".join(there)}'
            raise Refused("bad_argument", text, "fields")


def _unsubscribe(session: Session, request: Request) -> object:
    params = params_of(request, ("subscription", "pattern"))
    if ("subscription" in params) == ("pattern" in params):
        raise Refused("bad_argument", '"unsubscribe" takes either "subscription" or "pattern"', "subscription")
    wanted = params.get("subscription")
    if "subscription" in params and (not isinstance(wanted, int) or isinstance(wanted, bool)):
        raise Refused("bad_argument", '"subscription" must be the number that "subscribe" gave', "subscription")
    pattern = name(params, "pattern", "a pattern as it was subscribed") if "pattern" in params else None
    ended = [s for s in session.subscriptions.values() if s.serial == wanted or s.pattern == pattern]
    for subscription in ended:
        session.fanout.remove(session, subscription)
        del session.subscriptions[subscription.serial]
    return {"removed": len(ended)}


def _command(session: Session, request: Request) -> object:
    params = params_of(request, ("port", "value"))
    port = name(params, "port", "the path of an actuator")
    value = params.get("value")
    if not isinstance(value, dict):
        raise Refused("bad_argument", '"value" must be a map from field to number or list', "value")

    def answer(reply: Reply) -> None:
        result: dict[str, Json] = {"tick": reply.tick, "t_ns": reply.t_ns, "conflict": reply.conflict}
        session.answer(request.id, reply, result)

    session.conversation.command(port, value, answer)
    return LATER


def _call(session: Session, request: Request) -> object:
    params = params_of(request, ("service", "args"))
    service = name(params, "service", "the path of a service")
    args = params.get("args")
    if args is not None and not isinstance(args, dict):
        raise Refused("bad_argument", '"args" must be a map from argument to value', "args")

    def answer(reply: Reply) -> None:
        session.answer(request.id, reply, {"tick": reply.tick, "t_ns": reply.t_ns, "value": reply.result})

    return _start(session, request, service, args or {}, answer)


def _step(session: Session, request: Request) -> object:
    params = params_of(request, ("n",))

    def answer(reply: Reply) -> None:
        session.answer(request.id, reply, {"tick": reply.tick, "t_ns": reply.t_ns})

    return _start(session, request, "world/step", params, answer)


def _start(
    session: Session, request: Request, service: str, args: Mapping[str, object], answer: Callable[[Reply], None]
) -> object:
    key, conversation = request.id, session.conversation
    if key is not None and conversation.is_running(key):
        raise Refused("invalid_request", f'the id "{key}" belongs to an unfinished request: use another one', "id")
    conversation.call(service, args, answer, key=key, progress=lambda progress: session.progress(key, progress))
    return LATER


def _cancel(session: Session, request: Request) -> object:
    identity = params_of(request, ("id",)).get("id")
    is_id = isinstance(identity, int | str) and not isinstance(identity, bool)
    if not is_id or not session.conversation.is_running(identity):
        raise Refused("bad_argument", '"id" is not that of an unfinished call or step of this connection', "id")
    return {"cancelled": session.conversation.cancel(identity)}


def _ping(session: Session, request: Request) -> object:
    encoding = session.codec.encoding
    try:
        encoding.encode(request.params)
    except (
        TypeError,
        ValueError,
        OverflowError,
    ) as error:  # such as an integer above 2^64 in a JSON text where answers are msgpack
        raise Refused(
            "bad_argument", f"this has no {encoding.name} encoding, in which it would be sent back ({error})"
        ) from None
    return request.params


_VERBS: Mapping[str, Callable[[Session, Request], object]] = {
    "describe": _describe,
    "subscribe": _subscribe,
    "unsubscribe": _unsubscribe,
    "command": _command,
    "call": _call,
    "cancel": _cancel,
    "step": _step,
    "ping": _ping,
}


class NativeService:
    """Serves the native protocol.

    Args:
        context: the context of the adapter.
        token: the token that clients must show; None if none is needed.
        allowance: limits of one client.
        requests_per_s: requests of one client in a second; more are refused.
        refusals: counts what the adapter refuses.

    Attributes:
        context, token, requests_per_s, refusals: as given.
        fanout: sends samples and events to clients; the adapter's `Subscriber`.
        lockout: hosts that try tokens.
    """

    def __init__(
        self,
        context: AdapterContext,
        token: str | None,
        allowance: Allowance,
        requests_per_s: int,
        refusals: Refusals,
    ) -> None:
        self.context = context
        self.token = token
        self.requests_per_s = requests_per_s
        self.refusals = refusals
        self.fanout = Fanout(context)
        self.lockout = Lockout()
        self._allowance = allowance
        self._serials = itertools.count(1)

    def session(self, codec: Codec, outbox: Outgoing, wake: Callable[[], None]) -> Session:
        """Return the session of a new client.

        Args:
            codec: encodes its answers.
            outbox: where its answers and samples wait.
            wake: called after an answer that comes later than its request.
        """
        return Session(next(self._serials), codec, outbox, self.fanout, wake, self._allowance)

    def take(self, session: Session, request: Request, host: str) -> Fault | None:
        """Carry out a request of a client at a host; return the fault with which its connection must end, if there is one."""
        fault = take(session, request, self.token)
        if fault is not None:
            self.refusals.note(fault.code, fault.text)
            if fault.code == "denied" and self.lockout.wrong(host, asyncio.get_running_loop().time()):
                self.refusals.note("lockout", self.lockout.fault.text)
        return fault
