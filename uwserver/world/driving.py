"""How a world is driven on the thread that steps it: commands, calls, ticks, and the newest readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping

from uwserver.ports import Call, Command, Event, Json, OnReply, Port, Refused, Service
from uwserver.ports.checks import checked_args, checked_command, checked_whole, find
from uwserver.ports.crossing import Later, Posted, TickOutput
from uwserver.ports.sample_batch import Samples
from uwserver.world.parts.part import Carry
from uwserver.world.sensing.reading import Reading
from uwserver.world.sensing.sensing import Sensing
from uwserver.world.stepping.requests import Requests


class Diverged(Exception):
    """The state of a body is not finite, or absurdly fast. The text names the body, the tick and the last commands.

    Attributes:
        output: replies to the requests that were carried out at the start of the tick, and samples of earlier ticks that were made in the
            same call of `advance`.
        samples: samples of the earlier ticks of the same `step`.
    """

    def __init__(self, text: str, output: TickOutput) -> None:
        super().__init__(text)
        self.output = output
        self.samples = Samples()

    def __reduce__(self) -> tuple[type[Diverged], tuple[str, TickOutput]]:
        # For another process, which has neither the world nor who waits for a reply.
        return type(self), (str(self), TickOutput(self.output.tick, self.output.t_ns, []))


class Driven(ABC):
    """The part of a world that takes requests, runs ticks and gives readings.

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

    def step(self, n: int = 1, events: deque[Event] | None = None) -> Samples:
        """Run n ticks. Who waits for a reply gets it. Returns the samples delivered in them, as a list; each sample object is made when it
        is accessed.

        Args:
            n: ticks.
            events: gets the events of these ticks; None to drop them.

        Raises:
            Refused: n is no whole number above 0; nothing is stepped.
            Diverged: the state of a body is not finite; the world must not be stepped any further. It has the samples of this call.
        """
        n = checked_ticks(n)
        samples = Samples()
        try:
            while n > 0:
                output = self.advance(most=n)
                n -= output.ticks
                if output.batch is not None:
                    samples.add(output.batch)
                if output.made:
                    samples.add(output.made)
                if output.events and events is not None:
                    events += output.events
                for on_reply, reply in output.replies:
                    on_reply(reply)
        except Diverged as diverged:
            samples.add(diverged.output.batch or ())
            samples.add(diverged.output.made)
            if events is not None:
                events += diverged.output.events
            diverged.samples = samples
            raise
        return samples

    def read(self, port: str) -> Reading | None:
        """Return the newest delivered sample of a sensor, by field: ``world.read("rov/depth").depth``; None before the first.

        Raises:
            Refused: no such port, or it is an actuator's, which gives no samples.
        """
        find("port", port, self.ports)
        known = self.ports[port]
        if known.direction != "sensor":
            fields = ", ".join(f"{field.name}=..." for field in known.fields)
            text = f'"{port}" is an actuator: it takes commands, command("{port}", {fields}), and gives no samples'
            raise Refused("bad_argument", f'{text}; call("{port}/get") tells its last command', port)
        sample = self.sensing.newest(port)
        return None if sample is None else Reading(known, sample)


def checked_ticks(n: int) -> int:
    """Return a number of ticks to run.

    Raises:
        Refused: it is no whole number above 0.
    """
    if type(n) is int and n > 0:
        return n
    return checked_whole("n", n, 1, "step takes a whole number of ticks, 1 or more")
