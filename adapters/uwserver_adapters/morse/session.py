"""What one client of the request channel asks, and is answered. Knows no socket: requests in, lines out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from uwserver.adapter import AdapterContext, Conversation, Owed, did_you_mean
from uwserver.ports import Json, Progress, Refused, Reply, Sample, Service
from uwserver_adapters.morse import codec
from uwserver_adapters.morse.components import GOTO, Component
from uwserver_adapters.morse.grammar import Cancel, Malformed, Request, Status, answer

STATUS = "world/status"

LARGEST = 1e15
"""Of a number; whole ones of JSON may have hundreds of digits."""

Tell = Callable[[Reply], None]


class Stage(Protocol):
    """What all clients share."""

    context: AdapterContext

    @property
    def components(self) -> Mapping[str, Component]:
        """All of them, by name."""

    @property
    def places(self) -> Mapping[str, Mapping[str, str]]:
        """Services that belong to no component, by name -> path, for each vehicle, and for ``world`` and its like."""

    @property
    def details(self) -> Json:
        """What ``simulation details`` answers."""

    def stream_port(self, name: str) -> int | None:
        """TCP port of a component's stream; None where it has none."""

    def data(self, component: Component, samples: Sequence[Sample]) -> dict[str, object] | None:
        """What a component's stream says of these samples: its own, and where it needs it that of the vehicle's pose; None without its own."""

    def companions(self, component: Component) -> list[str]:
        """Paths of the ports that `data` needs."""


class Session:
    """One client.

    Args:
        stage: that it stands on.
        name: of this client.
        send: takes a line.
        most: calls that may wait for the world.
    """

    def __init__(self, stage: Stage, name: str, send: Callable[[bytes], None], most: int) -> None:
        self._stage = stage
        self._context = stage.context
        self._send = send
        self._conversation = Conversation(stage.context, name, Owed(most))
        self._simulation: dict[str, Callable[[Request], None]] = {
            "list_robots": lambda request: self._give(request, [each.name for each in self._context.world.vehicles]),
            "details": lambda request: self._give(request, self._stage.details),
            "list_streams": lambda request: self._give(request, [name for name, _ in self._ports()]),
            "get_all_stream_ports": lambda request: self._give(request, dict(self._ports())),
            "get_stream_port": self._stream_port,
            "reset_objects": lambda request: self._simply(request, "world/reset"),
            "suspend_dynamics": lambda request: self._simply(request, "world/pause"),
            "restore_dynamics": lambda request: self._simply(request, "world/resume"),
            "activate": lambda request: self._switch(request, "activate"),
            "deactivate": lambda request: self._switch(request, "deactivate"),
            "quit": lambda request: self._simply(request, "world/shutdown"),
            "terminate": lambda request: self._simply(request, "world/shutdown"),
        }
        self._time: dict[str, Callable[[Request], None]] = {
            "now": lambda request: self._with_time(request, lambda t_ns: self._give(request, self._stamp(t_ns))),
            "sleep": self._sleep,
            "set_time_scale": self._set_time_scale,
            "mode": lambda request: self._give(request, self._context.world.mode),
            "statistics": lambda request: self._simply(request, STATUS),
        }

    def close(self) -> None:
        """The client has gone."""
        self._conversation.close()

    def end_calls(self) -> None:
        """The client asks for nothing more: end its calls that take long."""
        self._conversation.end_calls()

    @property
    def waiting(self) -> int:
        """Calls that wait for the world."""
        return self._conversation.owed.count

    def take(self, event: Request | Cancel | Malformed) -> None:
        """Carry out a line; every fault is told."""
        if isinstance(event, Malformed):
            self._fail(event.id, event.text)
        elif isinstance(event, Cancel):
            if not self._conversation.cancel(event.id):
                self._fail(
                    event.id,
                    "nothing that can be cancelled runs under this id; its call may have been answered already",
                )
        else:
            try:
                self._dispatch(event)
            except Refused as refused:
                self._fail(event.id, refused.fault.text)

    def _dispatch(self, request: Request) -> None:
        component, service = request.component, request.service
        if component in ("simulation", "time"):
            table = self._simulation if component == "simulation" else self._time
            if service not in table:
                raise Refused("unknown_service", f'no service "{service}" of {component}{_among(service, table)}')
            table[service](request)
        elif component in self._stage.components:
            self._of_component(request, self._stage.components[component])
        elif component in self._stage.places:
            known = self._stage.places[component]
            if service not in known:
                raise Refused("unknown_service", f'no service "{service}" of {component}{_among(service, known)}')
            self._call_by_place(request, known[service])
        else:
            there = ["simulation", "time", *self._stage.places, *self._stage.components]
            raise Refused("unknown_service", f'no component "{component[:80]}"{_among(component, there)}')

    # -- components -----------------------------------------------------------------------------------------------------------------------

    def _of_component(self, request: Request, component: Component) -> None:
        service = request.service
        if service not in component.services:
            raise Refused(
                "unknown_service", f'no service "{service}" of {component.name}{_among(service, component.services)}'
            )
        if service == "get_local_data":
            _expect(request)
            self._read(request, component)
        elif service in ("get_properties", "get_configurations"):
            _expect(request)
            self._simply(request, f"{component.path}/get")
        elif service == "set_property":
            name, value = _expect(request, "name", "value")
            self._call(request, f"{component.path}/set", {str(name): value})
        elif service == "goto":
            self._goto(request, component)
        else:
            self._simply(request, f"{component.robot}/autopilot/cancel_goto")

    def _read(self, request: Request, component: Component) -> None:
        def on_samples(samples: Sequence[Sample]) -> None:
            if self._conversation.is_closed:
                return
            data: Any = self._stage.data(component, samples)
            if data is None:
                self._fail(request.id, f"{component.name} has measured nothing yet")
            else:
                self._give(request, data)

        self._context.read(self._stage.companions(component), on_samples, self._conversation.source)

    def _goto(self, request: Request, component: Component) -> None:
        """``goto(x, y, z[, tolerance[, speed]])``, answered when the place is reached."""
        if not 3 <= len(request.args) <= 5:
            raise _wrong_number(request, "x, y, z, and perhaps tolerance and speed")
        numbers = [
            _number(name, given)
            for name, given in zip(("x", "y", "z", "tolerance", "speed"), request.args, strict=False)
        ]
        args: dict[str, object] = {"position_ned_m": codec.place(*numbers[:3])}
        args |= dict(zip(("radius_m", "speed_mps"), numbers[3:], strict=False))
        self._call(request, f"{component.robot}/{GOTO}", args)

    # -- simulation and time --------------------------------------------------------------------------------------------------------------

    def _ports(self) -> list[tuple[str, int]]:
        numbers = ((name, self._stage.stream_port(name)) for name in self._stage.components)
        return [(name, number) for name, number in numbers if number is not None]

    def _stream_port(self, request: Request) -> None:
        (name,) = _expect(request, "component")
        number = self._stage.stream_port(str(name))
        if number is None:
            raise Refused("bad_argument", f'no stream "{str(name)[:80]}"{_among(str(name), self._stage.components)}')
        self._give(request, number)

    def _switch(self, request: Request, verb: str) -> None:
        (name,) = _expect(request, "component")
        component = self._stage.components.get(str(name))
        if component is None or component.role != "port":
            raise Refused("bad_argument", f'no component "{str(name)[:80]}"{_among(str(name), self._stage.components)}')
        self._call(request, f"{component.path}/{verb}", {})

    def _sleep(self, request: Request) -> None:
        (span,) = _expect(request, "seconds")
        span_s = _number("seconds", span)
        self._with_time(
            request, lambda t_ns: self._call(request, "world/run_until", {"t_s": codec.seconds(t_ns) + span_s})
        )

    def _set_time_scale(self, request: Request) -> None:
        (scale,) = _expect(request, "scale")
        self._call(request, "world/set_speed", {"speed": _number("scale", scale)})

    def _stamp(self, t_ns: int) -> float:
        return codec.timestamp(self._context.world.epoch_ns, t_ns)

    def _with_time(self, request: Request, go_on: Callable[[int], None]) -> None:
        """Ask what time it is, and go on with that."""

        def on_reply(reply: Reply) -> None:
            try:
                go_on(reply.t_ns)
            except Refused as refused:
                self._fail(request.id, refused.fault.text)

        if request.service == "now":
            _expect(request)
        self._conversation.call(STATUS, {}, on_reply)

    # -- calls and answers ----------------------------------------------------------------------------------------------------------------

    def _simply(self, request: Request, path: str) -> None:
        _expect(request)
        self._call(request, path, {})

    def _call_by_place(self, request: Request, path: str) -> None:
        """A service of ours with its arguments in their order, or one object with their names."""
        service = self._context.services.get(path)
        if service is None:  # it went, and the event has not come yet
            raise Refused("unknown_service", f"no service {path}{_among(path, self._context.services)}")
        self._call(request, path, _args(request, service))

    def _call(self, request: Request, path: str, args: Mapping[str, object]) -> None:
        self._conversation.call(
            path, args, lambda reply: self._answer(request.id, reply), key=request.id, progress=_ignore
        )

    def _answer(self, id: str, reply: Reply) -> None:
        if reply.fault is None:
            self._send(answer(id, "SUCCESS", reply.result))
        else:
            status: Status = "PREEMPTED" if reply.fault.code == "preempted" else "FAILED"
            self._send(answer(id, status, reply.fault.text))

    def _give(self, request: Request, value: Json) -> None:
        self._send(answer(request.id, "SUCCESS", value))

    def _fail(self, id: str, text: str) -> None:
        self._context.stats.errors += 1
        self._send(answer(id, "FAILED", text))


def _ignore(_: Progress) -> None:
    """The protocol has no word for it."""


def _args(request: Request, service: Service) -> dict[str, object]:
    known = service.arguments
    given = request.args
    if len(given) == 1 and isinstance(given[0], dict) and not (known and known[0].type == "json"):
        return given[0]
    if len(given) > len(known):
        raise _wrong_number(request, ", ".join(each.name for each in known) or "none")
    return {argument.name: value for argument, value in zip(known, given, strict=False)}


def _expect(request: Request, *names: str) -> tuple[object, ...]:
    if len(request.args) != len(names):
        raise _wrong_number(request, ", ".join(names) or "none")
    return request.args


def _wrong_number(request: Request, needs: str) -> Refused:
    # pymorse raises a TypeError where an answer says these words.
    return Refused(
        "bad_argument", f"wrong # of parameters for {request.service}: it takes {needs}, not {len(request.args)}"
    )


def _number(name: str, given: object) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not abs(given) < LARGEST:
        raise Refused("bad_argument", f"{name} is a number below {LARGEST:g}")
    return float(given)


def _among(word: str, known: Mapping[str, object] | Sequence[str]) -> str:
    hint = did_you_mean(word[:80], known)
    return hint or f"; there are: {', '.join(list(known)[:40]) or 'none'}"
