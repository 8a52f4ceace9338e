"""Requests as data: what to send, how to read the result, and what it means if the request is lost or given up."""

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
    """A request.

    Attributes:
        method: method in the protocol.
        params: params of the method, as plain values.
        parse: reads the result; raises ProtocolError.
        title: name of the request in errors.
        changes: whether it may change the world, so that its outcome is unknown after a lost connection.
        waits: whether it may take long, so that it has no time limit unless the caller gives one.
        cancellable: whether the server must be told to stop it when it is given up.
    """

    method: str
    params: Mapping[str, object]
    parse: Callable[[object], T]
    title: str
    changes: bool = False
    waits: bool = False
    cancellable: bool = False


def hello(name: str | None, token: str | None) -> Verb[dict[str, object]]:
    """Return the request that introduces the client."""
    params: dict[str, object] = {"version": PROTOCOL_VERSION}
    if name is not None:
        params["name"] = name
    if token is not None:
        params["token"] = token
    return Verb("hello", params, lambda result: wire.as_map(result, "a greeting"), "hello")


def describe(pattern: str = "**") -> Verb[Description]:
    """Return a request for ports and services."""
    return Verb("describe", {"pattern": pattern}, Description.from_wire, "describe")


def subscribe(pattern: str, options: Mapping[str, object]) -> Verb[Subscription]:
    """Return a request for samples. `options` has those of rate_hz, fields, delivery and pictures that were given."""

    def parse(result: object) -> Subscription:
        data = wire.as_map(result, "a subscription")
        ports = wire.as_list(data.get("ports", []), "ports")
        return Subscription(wire.integer(data, "subscription"), pattern, tuple(str(port) for port in ports))

    return Verb("subscribe", {"pattern": pattern, **options}, parse, f"subscribe to {pattern}")


def unsubscribe(pattern: str) -> Verb[int]:
    """Return the request that ends the subscriptions with a pattern."""
    return Verb(
        "unsubscribe",
        {"pattern": pattern},
        lambda result: wire.integer(wire.as_map(result, "an answer"), "removed"),
        f"unsubscribe from {pattern}",
    )


def command(port: str, value: Mapping[str, object]) -> Verb[Ack]:
    """Return a command of an actuator. `value` must have been checked."""
    return Verb("command", {"port": port, "value": dict(value)}, Ack.from_wire, f"the command to {port}", changes=True)


def call(path: str, args: Mapping[str, object], service: Service | None) -> Verb[object]:
    """Return the call of a service. `service` is its description, or None if it is not known."""
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
    """Return the call of a service of which only the tick matters (pause, resume, reset)."""
    return Verb("call", {"service": path, "args": {}}, Ack.from_wire, f"the call of {path}", changes=True)


def status() -> Verb[dict[str, object]]:
    """Return the call of world/status. Its result always has the `tick` and `t_ns` of the answer."""

    def parse(result: object) -> dict[str, object]:
        ack = Ack.from_wire(result)
        value = wire.as_map(wire.as_map(result, "a result").get("value"), "a status")
        return {**value, "tick": ack.tick, "t_ns": ack.t_ns}

    return Verb("call", {"service": "world/status", "args": {}}, parse, "the call of world/status")


def run_until(t_s: float, service: Service | None) -> Verb[object]:
    """Return the call of world/run_until. The name of its first argument comes from its description."""
    name = service.arguments[0].name if service is not None and service.arguments else "t_s"
    return call("world/run_until", {name: t_s}, service)


def step(n: int) -> Verb[Ack]:
    """Return the request that advances the world by n ticks."""
    return Verb("step", {"n": n}, Ack.from_wire, "step", changes=True, waits=True, cancellable=True)


def cancel(identity: RequestId) -> Verb[bool]:
    """Return the request that stops an unfinished call or step of this client."""
    return Verb(
        "cancel",
        {"id": identity},
        lambda result: wire.flag(wire.as_map(result, "an answer"), "cancelled"),
        f"cancel of request {identity}",
    )
