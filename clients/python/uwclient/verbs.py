"""Each verb as data: the request to send, how to read its result, and what its loss or its giving up means."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from uwclient import wire
from uwclient.checks import plain
from uwclient.ports import Ack, Description, Service, Subscription
from uwclient.wire import RequestId

T = TypeVar("T")

PROTOCOL_VERSION = 1


@dataclass(frozen=True)
class Verb(Generic[T]):
    """One request.

    Attributes:
        method: the wire's method.
        params: its params, plain values.
        parse: reads the result; raises ProtocolError.
        title: how an error names it.
        changes: it may change the world, so after a lost connection its fate is unknown.
        waits: it may rightly take long: no time limit unless the caller gives one.
        cancellable: giving up tells the server to stop it.
    """

    method: str
    params: Mapping[str, object]
    parse: Callable[[object], T]
    title: str
    changes: bool = False
    waits: bool = False
    cancellable: bool = False


def hello(name: str | None, token: str | None) -> Verb[dict[str, object]]:
    """Introduce the client."""
    params: dict[str, object] = {"version": PROTOCOL_VERSION}
    if name is not None:
        params["name"] = name
    if token is not None:
        params["token"] = token
    return Verb("hello", params, lambda result: wire.as_map(result, "a greeting"), "hello")


def describe(pattern: str = "**") -> Verb[Description]:
    """Ask for ports and services."""
    return Verb("describe", {"pattern": pattern}, Description.from_wire, "describe")


def subscribe(pattern: str, options: Mapping[str, object]) -> Verb[Subscription]:
    """Ask for samples; `options` holds rate_hz, fields, delivery as far as given."""

    def parse(result: object) -> Subscription:
        data = wire.as_map(result, "a subscription")
        ports = wire.as_list(data.get("ports", []), "ports")
        return Subscription(wire.integer(data, "subscription"), pattern, tuple(str(port) for port in ports))

    return Verb("subscribe", {"pattern": pattern, **options}, parse, f"subscribe to {pattern}")


def unsubscribe(pattern: str) -> Verb[int]:
    """End the subscriptions made with this pattern."""
    return Verb(
        "unsubscribe",
        {"pattern": pattern},
        lambda result: wire.integer(wire.as_map(result, "an answer"), "removed"),
        f"unsubscribe from {pattern}",
    )


def command(port: str, value: Mapping[str, object]) -> Verb[Ack]:
    """Command an actuator; `value` has been checked."""
    return Verb("command", {"port": port, "value": dict(value)}, Ack.from_wire, f"the command to {port}", changes=True)


def call(path: str, args: Mapping[str, object], service: Service | None) -> Verb[object]:
    """Call a service; `service` is its description when it is known."""
    return Verb(
        "call",
        {"service": path, "args": {name: plain(value) for name, value in args.items()}},
        lambda result: wire.as_map(result, "a result").get("value"),
        f"the call of {path}",
        changes=service is None or not service.reads_only,
        waits=service is not None and service.long_running,
        cancellable=True,
    )


def acknowledged(path: str) -> Verb[Ack]:
    """Call a service of the world for its tick (pause, resume, reset)."""
    return Verb("call", {"service": path, "args": {}}, Ack.from_wire, f"the call of {path}", changes=True)


def status() -> Verb[dict[str, object]]:
    """Call world/status; its map always holds the `tick` and `t_ns` of the answer."""

    def parse(result: object) -> dict[str, object]:
        ack = Ack.from_wire(result)
        value = wire.as_map(wire.as_map(result, "a result").get("value"), "a status")
        return {**value, "tick": ack.tick, "t_ns": ack.t_ns}

    return Verb("call", {"service": "world/status", "args": {}}, parse, "the call of world/status")


def run_until(t_s: float, service: Service | None) -> Verb[object]:
    """Call world/run_until; the name of its first argument comes from its description."""
    name = service.arguments[0].name if service is not None and service.arguments else "t_s"
    return call("world/run_until", {name: t_s}, service)


def step(n: int) -> Verb[Ack]:
    """Advance the world by n ticks."""
    return Verb("step", {"n": n}, Ack.from_wire, "step", changes=True, waits=True, cancellable=True)


def cancel(identity: RequestId) -> Verb[bool]:
    """Stop an own, unfinished call or step."""
    return Verb(
        "cancel",
        {"id": identity},
        lambda result: wire.flag(wire.as_map(result, "an answer"), "cancelled"),
        f"cancel of request {identity}",
    )
