"""The methods with which a program in the same process commands, calls, steps, reads and records a world."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from uwserver.ports import Call, Command, Json, OnReply, Port, Refused, Service
from uwserver.ports.checks import checked_args, checked_command, find
from uwserver.ports.crossing import Later, Posted, TickOutput
from uwserver.ports.sample_batch import Samples
from uwserver.world.part import Carry
from uwserver.world.reading import Reading
from uwserver.world.requests import Requests
from uwserver.world.sensing import Sensing
from uwserver.world.traces import Traces, chosen


class InProcess(ABC):
    """The part of a world that is for programs in the same process.

    Attributes:
        ports, services, requests, sensing: see `World`.
        carry: the function of each service, by path.
    """

    ports: Mapping[str, Port]
    services: Mapping[str, Service]
    requests: Requests
    sensing: Sensing

    def __init__(self) -> None:
        self.carry: dict[str, Carry] = {}
        self._traces: list[Traces] = []

    @property
    @abstractmethod
    def tick(self) -> int:
        """Ticks done."""

    @abstractmethod
    def advance(self, *, most: int = 1) -> TickOutput:
        """Make one tick, or up to `most`."""

    def submit(self, item: Command | Call, on_reply: OnReply | None = None) -> None:
        """Post a checked command or call for the start of the next tick."""
        self.post(Posted(item, on_reply))

    def post(self, posted: Posted) -> None:
        """Post a request for the start of the next tick."""
        self.requests.posted.append(posted)

    def command(self, port: str, **value: object) -> None:
        """Check and post a command: ``world.command("rov/thrusters", u=[...])``, with lists or arrays, texts, bytes. It acts from the next
        `step` on.

        Raises:
            Refused: unknown port or field, wrong type or shape, not finite, out of range, too large.
        """
        find("port", port, self.ports)
        known = self.ports[port]
        self.post(Posted(Command(port, checked_command(known, value), "in-process"), None, known.fields))

    def call(self, service: str, **args: object) -> Json:
        """Carry out a service at once, between two ticks, and return its result. A long-running service is only begun, and gives None.

        Raises:
            Refused: unknown service or argument, wrong type, out of range, or refused by the service.
        """
        find("service", service, self.services)
        self.requests.changes += 1
        result = self.carry[service](checked_args(self.services[service], args))
        return None if isinstance(result, Later) else result

    def step(self, n: int = 1) -> Samples:
        """Run n ticks. Returns the samples delivered in them, as a list; each sample object is made when it is accessed.

        Raises:
            Refused: n is below 1; nothing is stepped.
            Diverged: the state of a body is not finite; the world must not be stepped any further.
        """
        if n < 1:
            raise Refused("out_of_range", f"step takes 1 tick or more, not {n}", "n")
        samples = Samples()
        while n > 0:
            output = self.advance(most=n)
            n -= output.ticks
            samples.add(output.batch or ())
            samples.add(output.made)
            for on_reply, reply in output.replies:
                on_reply(reply)
        for traces in self._traces:
            traces.take(samples)
        return samples

    def read(self, port: str) -> Reading | None:
        """Return the newest delivered sample of a sensor, by field: ``world.read("rov/depth").depth``; None before the first.

        Raises:
            Refused: no such port.
        """
        find("port", port, self.ports)
        sample = self.sensing.newest(port)
        return None if sample is None else Reading(self.ports[port], sample)

    def record(self, *patterns: str) -> Traces:
        """Record the sensors that match a pattern as arrays, from now on and while `step` runs (``*`` stands for one level; default: all
        sensors).

        Raises:
            Refused: no sensor matches.
        """
        return Traces(chosen(self.ports, patterns), self._traces)
