"""One client of the request channel. Nothing here knows a socket: requests in, lines out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from uwserver.adapter import Conversation, InFlightLimit, did_you_mean
from uwserver.ports import Json, Refused, Reply, Sample, Service
from uwserver_adapters.morse import codec
from uwserver_adapters.morse.grammar import Cancel, Malformed, Request, Status, answer
from uwserver_adapters.morse.stage import GOTO, Component, Stage

STATUS = "world/status"

LARGEST = 1e15
"""Numbers must be smaller than this; whole numbers of JSON may have hundreds of digits."""


class Session:
    """One client.

    Args:
        stage: what all clients share.
        name: name of this client.
        send: sends a line.
        most: most calls that may wait for the world.

    Attributes:
        conversation: its calls.
    """

    def __init__(self, stage: Stage, name: str, send: Callable[[bytes], None], most: int) -> None:
        self._stage = stage
        self._context = stage.context
        self._send = send
        self.conversation = Conversation(stage.context, name, InFlightLimit(most))
        simulation: dict[str, Callable[[Request], None]] = {
            "list_robots": lambda request: self._give(request, [each.name for each in self._context.world.vehicles]),
            "details": lambda request: self._give(request, self._stage.details),
            "list_streams": lambda request: self._give(request, list(self._ports())),
            "get_all_stream_ports": lambda request: self._give(request, {**self._ports()}),
            "get_stream_port": self._stream_port,
            "reset_objects": lambda request: self._simply(request, "world/reset"),
            "suspend_dynamics": lambda request: self._simply(request, "world/pause"),
            "restore_dynamics": lambda request: self._simply(request, "world/resume"),
            "activate": lambda request: self._switch(request, "activate"),
            "deactivate": lambda request: self._switch(request, "deactivate"),
            "quit": lambda request: self._simply(request, "world/shutdown"),
            "terminate": lambda request: self._simply(request, "world/shutdown"),
        }
        time: dict[str, Callable[[Request], None]] = {
            "now": self._now,
            "sleep": self._sleep,
            "set_time_scale": self._set_time_scale,
            "mode": lambda request: self._give(request, self._context.world.mode),
            "statistics": lambda request: self._simply(request, STATUS),
        }
        self._own = {"simulation": simulation, "time": time}

    def take(self, event: Request | Cancel | Malformed) -> None:
        """Carry out a line. Every fault is told to the client."""
        if isinstance(event, Malformed):
            self._fail(event.id, event.text)
        elif isinstance(event, Cancel):
            if not self.conversation.cancel(event.id):
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
        name, service = request.component, request.service
        component, place = self._stage.components.get(name), self._stage.places.get(name)
        known: Mapping[str, Callable[[Request], None]]
        if name in self._own:
            known = self._own[name]
        elif component is not None:
            known = dict.fromkeys(component.services, partial(self._of_component, component))
        elif place is not None:
            known = {each: partial(self._call_by_place, path) for each, path in place.items()}
        else:
            there = [*self._own, *self._stage.places, *self._stage.components]
            raise Refused("unknown_service", f'no component "{name[:80]}"{_among(name, there)}')
        if service not in known:
            raise Refused("unknown_service", f'no service "{service}" of {name}{_among(service, known)}')
        known[service](request)

    # -- components -----------------------------------------------------------------------------------------------------------------------

    def _of_component(self, component: Component, request: Request) -> None:
        service = request.service
        if service == "get_local_data":
            _expect(request)
            self._read(request, component)
        elif service in ("get_properties", "get_configurations"):
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
            by_port = {sample.port: sample for sample in samples}
            own = by_port.get(component.path)
            if self.conversation.is_closed:
                return
            if own is None:
                self._fail(request.id, f"{component.name} has measured nothing yet")
            else:
                data: Any = self._stage.data(component, own, by_port.get(component.pose_path))
                self._give(request, data)

        self._context.read(self._stage.sources(component), on_samples, self.conversation.source)

    def _goto(self, request: Request, component: Component) -> None:
        """Carry out ``goto(x, y, z[, tolerance[, speed]])``. It is answered when the place is reached."""
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

    def _ports(self) -> dict[str, int]:
        """Return the ports of the streams of all present components, by name."""
        ports = self._stage.stream_ports
        return {name: ports[name] for name in self._stage.components if name in ports}

    def _stream_port(self, request: Request) -> None:
        (name,) = _expect(request, "component")
        ports = self._ports()
        if str(name) not in ports:
            raise Refused("bad_argument", f'no stream "{str(name)[:80]}"{_among(str(name), self._stage.components)}')
        self._give(request, ports[str(name)])

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

    def _now(self, request: Request) -> None:
        _expect(request)
        epoch_ns = self._context.world.epoch_ns
        self._with_time(request, lambda t_ns: self._give(request, codec.timestamp(epoch_ns, t_ns)))

    def _with_time(self, request: Request, go_on: Callable[[int], None]) -> None:
        """Ask the world for its time, and go on with that."""

        def on_reply(reply: Reply) -> None:
            try:
                go_on(reply.t_ns)
            except Refused as refused:
                self._fail(request.id, refused.fault.text)

        self.conversation.call(STATUS, {}, on_reply)

    # -- calls and answers ----------------------------------------------------------------------------------------------------------------

    def _simply(self, request: Request, path: str) -> None:
        _expect(request)
        self._call(request, path, {})

    def _call_by_place(self, path: str, request: Request) -> None:
        """Call a service of the world. Its arguments come in their order, or as one object with their names."""
        service = self._context.services.get(path)
        if service is None:  # it has gone, and the event of that is still to come
            raise Refused("unknown_service", f"no service {path}{_among(path, self._context.services)}")
        self._call(request, path, _args(request, service))

    def _call(self, request: Request, path: str, args: Mapping[str, object]) -> None:
        self.conversation.call(path, args, lambda reply: self._answer(request.id, reply), key=request.id)

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
