"""Frozen types of what crosses the wire: descriptions, samples, events, acknowledgements.

Units are SI, angles are in radians, quaternions are (w, x, y, z), and times are integer nanoseconds of simulation time. The frame of a field is
in its description (N = north-east-down world, B = forward-right-down body, S = sensor).
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

from uwclient import wire
from uwclient.buffers import Buffer, unpacked
from uwclient.errors import UwError, install_command

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class Field:
    """A field of a port.

    Attributes:
        name: name of the field.
        type: type of its components: float, int, bool, str, bytes or buffer.
        shape: () for a scalar; a size of -1 is variable. For a buffer it is the shape of the buffer.
        unit: unit of the values, "1" or "" if they have none.
        frame: frame of a vector or rotation.
        doc: one sentence.
        minimum, maximum: limits of commands.
        dtype: type of the items of a buffer.
    """

    name: str
    type: str
    shape: tuple[int, ...] = ()
    unit: str = ""
    frame: str = ""
    doc: str = ""
    minimum: float | None = None
    maximum: float | None = None
    dtype: str = ""

    @classmethod
    def from_wire(cls, value: object) -> Field:
        """Read an entry of a port's `fields`. Raises ProtocolError."""
        data = wire.as_map(value, "a field")
        buffer = wire.as_map(data.get("buffer", {}), "a buffer")
        sizes = wire.as_list(buffer.get("shape", data.get("shape", [])), "a shape")
        return cls(
            name=wire.text(data, "name"),
            type=wire.text(data, "type", "float"),
            shape=tuple(size if isinstance(size, int) else -1 for size in sizes),
            unit=wire.text(data, "unit", ""),
            frame=wire.text(data, "frame", ""),
            doc=wire.text(data, "doc", ""),
            minimum=wire.number(data, "minimum"),
            maximum=wire.number(data, "maximum"),
            dtype=wire.text(buffer, "dtype", ""),
        )


@dataclass(frozen=True)
class Propulsor:
    """One thruster of a command: its position in B, m, and the direction in which it pushes at a positive command."""

    name: str
    r_B: tuple[float, ...]
    axis_B: tuple[float, ...]

    @classmethod
    def from_wire(cls, value: object) -> Propulsor:
        """Read an entry of a port's `propulsors`. Raises ProtocolError."""
        data = wire.as_map(value, "a propulsor")
        r, axis = (wire.as_list(data.get(key, []), key) for key in ("r_B", "axis_B"))
        return cls(
            wire.text(data, "name", ""),
            tuple(float(each) for each in r if isinstance(each, (int, float))),
            tuple(float(each) for each in axis if isinstance(each, (int, float))),
        )


@dataclass(frozen=True)
class Port:
    """A typed stream: a sensor, which sends samples, or an actuator, which takes commands."""

    path: str
    direction: str
    kind: str
    fields: tuple[Field, ...]
    rate_hz: float | None = None
    timeout_s: float | None = None
    doc: str = ""
    propulsors: tuple[Propulsor, ...] = ()

    @classmethod
    def from_wire(cls, value: object) -> Port:
        """Read an entry of `ports`. Raises ProtocolError."""
        data = wire.as_map(value, "a port")
        return cls(
            path=wire.text(data, "path"),
            direction=wire.text(data, "direction"),
            kind=wire.text(data, "kind", ""),
            fields=tuple(Field.from_wire(entry) for entry in wire.as_list(data.get("fields", []), "fields")),
            rate_hz=wire.number(data, "rate_hz"),
            timeout_s=wire.number(data, "timeout_s"),
            doc=wire.text(data, "doc", ""),
            propulsors=tuple(
                Propulsor.from_wire(entry) for entry in wire.as_list(data.get("propulsors", []), "propulsors")
            ),
        )


@dataclass(frozen=True)
class Argument:
    """An argument of a service."""

    name: str
    type: str
    unit: str = ""
    doc: str = ""
    required: bool = False
    default: object = None
    minimum: float | None = None
    maximum: float | None = None

    @classmethod
    def from_wire(cls, value: object) -> Argument:
        """Read an entry of a service's `arguments`. Raises ProtocolError."""
        data = wire.as_map(value, "an argument")
        return cls(
            name=wire.text(data, "name"),
            type=wire.text(data, "type", ""),
            unit=wire.text(data, "unit", ""),
            doc=wire.text(data, "doc", ""),
            required=wire.flag(data, "required"),
            default=data.get("default"),
            minimum=wire.number(data, "minimum"),
            maximum=wire.number(data, "maximum"),
        )


@dataclass(frozen=True)
class Service:
    """A service, which can be called."""

    path: str
    arguments: tuple[Argument, ...] = ()
    reads_only: bool = False
    long_running: bool = False
    doc: str = ""

    @classmethod
    def from_wire(cls, value: object) -> Service:
        """Read an entry of `services`. Raises ProtocolError."""
        data = wire.as_map(value, "a service")
        arguments = wire.as_list(data.get("arguments", []), "arguments")
        return cls(
            path=wire.text(data, "path"),
            arguments=tuple(Argument.from_wire(entry) for entry in arguments),
            reads_only=wire.flag(data, "reads_only"),
            long_running=wire.flag(data, "long_running"),
            doc=wire.text(data, "doc", ""),
        )


@dataclass(frozen=True)
class Description:
    """The answer to `describe`: `server` and `world` as they were sent, ports and services by path."""

    server: Mapping[str, object] = field(default_factory=dict[str, object], hash=False)
    world: Mapping[str, object] = field(default_factory=dict[str, object], hash=False)
    ports: Mapping[str, Port] = field(default_factory=dict[str, Port], hash=False)
    services: Mapping[str, Service] = field(default_factory=dict[str, Service], hash=False)

    @classmethod
    def from_wire(cls, value: object) -> Description:
        """Read the result of `describe`. Raises ProtocolError."""
        data = wire.as_map(value, "a description")
        ports = [Port.from_wire(entry) for entry in wire.as_list(data.get("ports", []), "ports")]
        services = [Service.from_wire(entry) for entry in wire.as_list(data.get("services", []), "services")]
        return cls(
            server=wire.as_map(data.get("server", {}), "server"),
            world=wire.as_map(data.get("world", {}), "world"),
            ports={port.path: port for port in ports},
            services={service.path: service for service in services},
        )


@dataclass(frozen=True)
class Sample:
    """A measurement. It was true at `t_ns`, and the device delivered it at `t_sent_ns` (simulation time, ns).

    A sensor that could not measure sends `valid` False, and None for missing values.
    """

    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: Mapping[str, object] = field(hash=False)

    @classmethod
    def from_wire(cls, value: object) -> Sample:
        """Read the params of a `sample` notification. Raises ProtocolError."""
        data = wire.as_map(value, "a sample")
        t_ns = wire.integer(data, "t_ns")
        return cls(
            port=wire.text(data, "port"),
            seq=wire.integer(data, "seq"),
            t_ns=t_ns,
            t_sent_ns=wire.integer(data, "t_sent_ns") if "t_sent_ns" in data else t_ns,
            valid=wire.flag(data, "valid", True),
            value={name: unpacked(entry) for name, entry in wire.as_map(data.get("value"), "a value").items()},
        )

    @property
    def time_s(self) -> float:
        """Simulation time of the measurement, s."""
        return self.t_ns / NANOSECONDS

    def __getitem__(self, name: str) -> object:
        """Return the value of a field: a number, a list, bytes, a Buffer, or None. Raises UwError if there is no such field."""
        try:
            return self.value[name]
        except KeyError:
            names = ", ".join(sorted(self.value)) or "none"
            raise UwError(
                f'a sample of {self.port} has no field "{name}"; it has: {names}', code="unknown_field", where=name
            ) from None

    def number(self, name: str) -> float:
        """Return a scalar field as float, with NaN for a missing value. Raises UwError for a list."""
        numbers = self.vector(name)
        if len(numbers) != 1:
            raise UwError(f'field "{name}" of {self.port} is no scalar; use vector() or array()', where=name)
        return numbers[0]

    def vector(self, name: str) -> tuple[float, ...]:
        """Return a field as floats in row-major order, one for a scalar, with NaN for missing values."""
        return tuple(_floats(self[name], self.port, name))

    def array(self, name: str) -> NDArray[Any]:
        """Return a field as a numpy array of its shape: float64 with NaN for missing values, or a buffer in its own type.

        Raises:
            UwError: numpy is not installed, or the sample has no such field.
        """
        value = self[name]
        if isinstance(value, Buffer):
            return value.array()
        try:
            np = importlib.import_module("numpy")
        except ImportError:
            raise UwError(
                f"Sample.array needs numpy: {install_command('uwclient[numpy]')} (or use Sample.vector)",
                code="missing_package",
            ) from None
        return cast("NDArray[numpy.float64]", np.asarray(value, dtype=np.float64))


def _floats(value: object, port: str, name: str) -> Iterator[float]:
    if value is None:
        yield math.nan
    elif isinstance(value, (int, float)):
        yield float(value)
    elif isinstance(value, (list, tuple)):
        for entry in cast("list[object]", value):
            yield from _floats(entry, port, name)
    else:
        raise UwError(f'field "{name}" of {port} holds {type(value).__name__}, which is no number', where=name)


@dataclass(frozen=True)
class Event:
    """An event in the world or the server: `paused`, `reset`, `conflict`, `shutdown`, ..."""

    event: str
    tick: int | None
    t_ns: int | None
    text: str

    @classmethod
    def from_wire(cls, value: object) -> Event:
        """Read the params of an `event` notification. Raises ProtocolError."""
        data = wire.as_map(value, "an event")
        return cls(
            event=wire.text(data, "event"),
            tick=wire.integer(data, "tick") if data.get("tick") is not None else None,
            t_ns=wire.integer(data, "t_ns") if data.get("t_ns") is not None else None,
            text=wire.text(data, "text", ""),
        )


@dataclass(frozen=True)
class Progress:
    """The progress of a long-running call. `id` is what `cancel` takes; `fraction` goes from 0 to 1."""

    id: int | str
    fraction: float
    t_ns: int | None

    @classmethod
    def from_wire(cls, value: object) -> Progress:
        """Read the params of a `progress` notification. Raises ProtocolError."""
        data = wire.as_map(value, "progress")
        identity = wire.request_id(data)
        return cls(
            id=identity if identity is not None else "",
            fraction=wire.number(data, "fraction") or 0.0,
            t_ns=wire.integer(data, "t_ns") if data.get("t_ns") is not None else None,
        )


@dataclass(frozen=True)
class Ack:
    """The tick at which a request was applied. `conflict` says that another client commanded the same port in that tick."""

    tick: int
    t_ns: int
    conflict: bool = False

    @classmethod
    def from_wire(cls, value: object) -> Ack:
        """Read the result of `command`, `step` or `call`. Raises ProtocolError."""
        data = wire.as_map(value, "an acknowledgement")
        return cls(wire.integer(data, "tick"), wire.integer(data, "t_ns"), wire.flag(data, "conflict"))

    @property
    def time_s(self) -> float:
        """Simulation time, s."""
        return self.t_ns / NANOSECONDS


@dataclass(frozen=True)
class Subscription:
    """The result of `subscribe`: the number that the server gave it, and the ports that it covers now."""

    id: int
    pattern: str
    ports: tuple[str, ...]


def matches(pattern: str, path: str) -> bool:
    """Tell whether a pattern matches a path: `*` is one level, `**` is any number of levels, including none."""
    return _levels_match(pattern.split("/"), path.split("/"))


def _levels_match(pattern: list[str], path: list[str]) -> bool:
    if not pattern:
        return not path
    if pattern[0] == "**":
        return any(_levels_match(pattern[1:], path[start:]) for start in range(len(path) + 1))
    return bool(path) and pattern[0] in ("*", path[0]) and _levels_match(pattern[1:], path[1:])
