"""A world for programs in the same process: the methods with which they command, call, step, read and record it, and the readings and traces
that they get."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Buffer, Call, Command, Field, Json, OnReply, Port, Refused, Sample, Service, Value, matches
from uwserver.ports.checks import checked_args, checked_command, find
from uwserver.ports.crossing import Later, Posted, TickOutput
from uwserver.ports.sample_batch import Samples
from uwserver.units import NANOSECONDS
from uwserver.world.parts.part import Carry
from uwserver.world.sensing.sensing import Sensing
from uwserver.world.stepping.requests import Requests


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


class Reading(Mapping[str, Value]):
    """The newest sample of a sensor: ``reading.depth`` or ``reading["depth"]`` as the sensor gave it, ``reading.array("p_NS")`` as an
    array.

    A field with the name of one of the attributes can only be read by ``reading["..."]``.

    Attributes:
        sample: the sample as it was delivered; its `port`, `seq`, `t_ns`, `t_sent_ns`, `valid` and `value` are attributes of the reading
            too.
    """

    __slots__ = ("_fields", "sample")

    def __init__(self, port: Port, sample: Sample) -> None:
        self.sample = sample
        self._fields: tuple[Field, ...] = port.fields

    @property
    def port(self) -> str:
        """Path of the port."""
        return self.sample.port

    @property
    def seq(self) -> int:
        """Number of the sample: counts what the sensor produced."""
        return self.sample.seq

    @property
    def t_ns(self) -> int:
        """Simulation time at which the sample was true, ns."""
        return self.sample.t_ns

    @property
    def t_s(self) -> float:
        """Simulation time at which the sample was true, s."""
        return self.sample.t_ns / NANOSECONDS

    @property
    def t_sent_ns(self) -> int:
        """Simulation time of its delivery, ns."""
        return self.sample.t_sent_ns

    @property
    def valid(self) -> bool:
        """Whether the sensor could measure."""
        return self.sample.valid

    @property
    def value(self) -> tuple[Value, ...]:
        """One entry for each field of the port."""
        return self.sample.value

    def array(self, name: str) -> NDArray[Any]:
        """Return a field as an array of its shape: numbers as floats, with NaN for a missing value; a buffer as it is.

        Raises:
            KeyError: no such field.
        """
        return as_array(self._field(name), self[name])

    def __getitem__(self, name: str) -> Value:
        return self.sample.value[self._fields.index(self._field(name))]

    def __getattr__(self, name: str) -> Value:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __iter__(self) -> Iterator[str]:
        return (field.name for field in self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def __eq__(self, other: object) -> bool:
        return self.sample == (other.sample if isinstance(other, Reading) else other)

    def __hash__(self) -> int:
        return hash(self.sample)

    def __repr__(self) -> str:
        values = "".join(f", {name} = {value!r}" for name, value in self.items())
        return f"<{self.port} at {self.t_s:.6f} s{'' if self.valid else ', invalid'}{values}>"

    def _field(self, name: str) -> Field:
        for field in self._fields:
            if field.name == name:
                return field
        raise KeyError(f'{self.port} has no field "{name}"; there are: {", ".join(self)}')


def as_array(field: Field, value: Value) -> NDArray[Any]:
    """Return one value of a field as an array; a missing number is NaN."""
    if isinstance(value, Buffer) and field.type == "buffer":
        return value.array()
    if field.is_packed or field.type == "str":
        found = np.empty((), dtype=object)
        found[()] = value
        return found
    if value is None:
        return np.full(field.shape, np.nan)
    return np.array(value, dtype=float).reshape(field.shape)


class Trace:
    """All samples of one port, in their order: ``trace.t``, and ``trace.depth`` or ``trace["depth"]`` of shape (n, *shape of the field).

    Attributes:
        port: the port.
        samples: as they were delivered.
    """

    def __init__(self, port: Port) -> None:
        self.port = port
        self.samples: list[Sample] = []

    @property
    def t(self) -> FloatArray:
        """(n) simulation times of the measurements, s."""
        return np.array([sample.t_ns for sample in self.samples], dtype=float) / NANOSECONDS

    @property
    def valid(self) -> NDArray[Any]:
        """(n) whether the sensor could measure."""
        return np.array([sample.valid for sample in self.samples], dtype=bool)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return arrays (n) by name, as ``pandas.DataFrame`` takes them: `t`, `valid`, and each number of each field: `depth`, `p_NS_0`,
        `p_NS_1`, `p_NS_2`.

        Buffers are left out, as each of them is a table itself.
        """
        columns = {"t": self.t, "valid": self.valid}
        for field in self.port.fields:
            if field.is_packed:
                continue
            values = self[field.name].reshape(len(self.samples), field.size)
            names = [field.name] if not field.shape else [f"{field.name}_{k}" for k in range(field.size)]
            columns |= {name: values[:, k] for k, name in enumerate(names)}
        return columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return all values of a field; KeyError if the port has no such field."""
        for k, field in enumerate(self.port.fields):
            if field.name == name:
                values = [as_array(field, sample.value[k]) for sample in self.samples]
                if len({value.shape for value in values}) > 1:  # pictures of different sizes
                    whole = np.empty(len(values), dtype=object)
                    whole[:] = values
                    return whole
                return np.stack(values) if values else np.empty((0, *field.shape))
        fields = ", ".join(field.name for field in self.port.fields)
        raise KeyError(f'{self.port.path} has no field "{name}"; there are: {fields}')

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        fields = ", ".join(field.name for field in self.port.fields)
        return f"<{self.port.path}: {len(self)} samples of {fields}>"


class Traces(Mapping[str, Trace]):
    """Traces by the path of their port. They grow with each step until `stop`, or until the end of a ``with`` block."""

    def __init__(self, ports: Iterable[Port], growing: list[Traces]) -> None:
        """Record these ports; `growing` has all traces that still grow, and takes this one in."""
        self._traces = {port.path: Trace(port) for port in ports}
        self._growing = growing
        growing.append(self)

    def take(self, samples: Samples) -> None:
        """Keep the samples of the recorded ports."""
        for sample in samples.of(self._traces):
            self._traces[sample.port].samples.append(sample)

    def stop(self) -> None:
        """Take no more samples, and keep those that there are."""
        if self in self._growing:
            self._growing.remove(self)

    def __enter__(self) -> Traces:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __getitem__(self, path: str) -> Trace:
        if path not in self._traces:
            raise KeyError(f'"{path}" is not recorded; there are: {", ".join(self._traces)}')
        return self._traces[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self._traces)

    def __len__(self) -> int:
        return len(self._traces)

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = object.__hash__

    def __repr__(self) -> str:
        return "\n".join(map(repr, self._traces.values()))


def chosen(ports: Mapping[str, Port], patterns: Sequence[str]) -> list[Port]:
    """Return the sensor ports that match one of the patterns; all of them if there is no pattern.

    Raises:
        Refused: no sensor matches.
    """
    wanted = patterns or ("**",)
    sensors = [port for port in ports.values() if port.direction == "sensor"]
    found = [port for port in sensors if any(matches(pattern, port.path) for pattern in wanted)]
    if not found:
        there = ", ".join(port.path for port in sensors) or "none"
        raise Refused("unknown_port", f"no sensor matches {', '.join(wanted)}; there are: {there}", "patterns")
    return found
