"""What a program in the same process asks of a world: to command, to call, to step, to read and to record."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from uwserver.ports import Call, Command, Json, OnReply, Port, Refused, Service
from uwserver.ports.checks import checked_args, checked_command, find
from uwserver.ports.crossing import Later, Posted, TickOutput
from uwserver.ports.told import Samples
from uwserver.world.part import Carry
from uwserver.world.reading import Reading
from uwserver.world.requests import Requests
from uwserver.world.sensing import Sensing
from uwserver.world.traces import Traces, Tracing


class InProcess(ABC):
    """That part of a world.

    Attributes:
        ports, services, requests, sensing: see `World`.
        carry: what each service does.
    """

    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    requests: Requests
    sensing: Sensing

    def __init__(self) -> None:
        self.carry: dict[str, Carry] = {}
        self._tracing = Tracing()

    @property
    @abstractmethod
    def tick(self) -> int:
        """Ticks done."""

    @abstractmethod
    def advance(self, *, most: int = 1) -> TickOutput:
        """One tick, or up to `most`."""

    def submit(self, item: Command | Call, on_reply: OnReply | None = None) -> None:
        """Post a checked command or call for the start of the next tick."""
        self.post(Posted(item, on_reply))

    def post(self, posted: Posted) -> None:
        """The same, as it came over the crossing."""
        self.requests.posted.append(posted)

    def command(self, port: str, **value: object) -> None:
        """Check and post a command: ``world.command("rov/thrusters", u=[...])``, lists or arrays, texts, bytes. It acts from the next `step` on.

        Raises:
            Refused: unknown port or field, wrong type or shape, not finite, out of range, too large.
        """
        find("port", port, self.ports)
        known = self.ports[port]
        self.post(Posted(Command(port, checked_command(known, value), "in-process"), None, known.fields))

    def call(self, service: str, **args: object) -> Json:
        """Carry out a service at once, between two ticks, and return its result; a long-running one is only begun.

        Raises:
            Refused: unknown service or argument, wrong type, out of range, or refused by the service.
        """
        find("service", service, self.services)
        self.requests.changes += 1
        result = self.carry[service](checked_args(self.services[service], args))
        return None if isinstance(result, Later) else result

    def step(self, n: int = 1) -> Samples:
        """Run n ticks; returns the samples delivered in them, as a list: each is made when somebody looks.

        Raises:
            Refused: n below 1; nothing is stepped.
            Diverged: a body's state is not finite; the world must not be stepped on.
        """
        if n < 1:
            raise Refused("out_of_range", f"step takes 1 tick or more, not {n}", "n")
        samples = Samples()
        while n > 0:
            output = self.advance(most=n)
            n -= output.ticks
            samples.add(output.told or ())
            samples.add(output.made)
            for on_reply, reply in output.replies:
                on_reply(reply)
        self._tracing.take(samples)
        return samples

    def read(self, port: str) -> Reading | None:
        """The newest delivered sample of a sensor, by field: ``world.read("rov/depth").depth``; None before the first.

        Raises:
            Refused: no such port.
        """
        find("port", port, self.ports)
        sample = self.sensing.newest(port)
        return None if sample is None else Reading(self.ports[port], sample)

    def record(self, *patterns: str) -> Traces:
        """Arrays of what the sensors that match (``*`` one level; default: all) say in `step` from now on; Refused where none matches."""
        return self._tracing.begin(self.ports, patterns)
