"""What is in a world, as text for the person at a prompt."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from uwserver.ports import Argument, Field, Port, Refused, Service, matches
from uwserver.ports.checks import suggestion
from uwserver.world import World as Core

_FEW = 2
"""So many ports or services are described with the meaning of each field or argument."""
_WIDEST = 44
"""Widest column of a table, characters."""
_LINE = 90
"""Characters for the fields of a port, if there are many ports."""


@dataclass(frozen=True, repr=False)
class Description:
    """What is in a world, or in a part of it; `print` or a prompt shows it.

    Attributes:
        title: the world in a line.
        bodies: vehicles and objects: the model of each, by name.
        sensors, actuators: ports, in the order of their paths.
        services: in the order of their paths.
    """

    title: str
    bodies: Mapping[str, str]
    sensors: tuple[Port, ...]
    actuators: tuple[Port, ...]
    services: tuple[Service, ...]

    def __repr__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield self.title
        if self.bodies:
            yield ""
            yield 'bodies: world.vehicles["..."]'
            yield from _aligned((name, model) for name, model in self.bodies.items())
        is_detailed = len(self.sensors) + len(self.actuators) <= _FEW
        for ports, title in (
            (self.sensors, 'sensors: world.read("...")'),
            (self.actuators, 'actuators: world.command("...", field=...)'),
        ):
            if ports:
                yield ""
                yield title
                yield from (_whole(ports) if is_detailed else _aligned(map(_row, ports)))
        if self.services:
            yield ""
            yield 'services: world.call("...", argument=...)'
            yield from self._service_lines()

    def _service_lines(self) -> Iterator[str]:
        of_ports = {"sensor": self.sensors, "actuator": self.actuators}
        directions = {port.path: direction for direction, ports in of_ports.items() for port in ports}
        shared: dict[str, dict[str, None]] = {}
        own = []
        for service in self.services:
            place, _, name = service.path.rpartition("/")
            if place in directions and len(self.services) > _FEW:
                shared.setdefault(directions[place], {})[name] = None
            else:
                own.append(service)
        yield from _aligned(
            (f"{each.path}({', '.join(map(_call_word, each.arguments))})", _first(each.doc)) for each in own
        )
        for direction, names in shared.items():
            yield f"  and of each {direction}, below its path: {', '.join(names)}"
        if len(self.services) <= _FEW:
            for argument in (argument for each in own for argument in each.arguments):
                yield f"    {argument.name}: {argument.doc}{_limits(argument.unit, argument.minimum, argument.maximum)}"


def described(core: Core, patterns: Sequence[str]) -> Description:
    """Return what is in a world.

    Args:
        core: the world.
        patterns: paths with ``*`` for one level and ``**`` for any; () for everything.

    Raises:
        Refused: nothing matches.
    """

    def is_wanted(path: str) -> bool:
        return not patterns or any(matches(pattern, path) for pattern in patterns)

    ports = [port for path, port in sorted(core.ports.items()) if is_wanted(path)]
    found = Description(
        f"{core.name}: {float(core.rate_hz):g} ticks a second, seed {core.seed}; SI units, angles in rad, N = north-east-down, "
        "B = forward-right-down, quaternions w x y z",
        {name: body.model for name, body in core.vehicles.items() if is_wanted(name)},
        tuple(port for port in ports if port.direction == "sensor"),
        tuple(port for port in ports if port.direction == "actuator"),
        tuple(service for path, service in sorted(core.services.items()) if is_wanted(path)),
    )
    if not (found.bodies or ports or found.services):
        known = [*core.vehicles, *core.ports, *core.services]
        hints = "".join(suggestion(pattern, known) for pattern in patterns)
        text = f'nothing here matches {", ".join(patterns)}{hints}; "*" stands for one level of a path, "**" for any number'
        raise Refused("unknown_port", text, "patterns")
    return found


def _aligned(rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Yield the rows of a table, indented, with columns of equal width; only a very wide cell pushes the others of its row aside."""
    table = list(rows)
    widths = [min(max(map(len, column)), _WIDEST) for column in zip(*table, strict=True)]
    for row in table:
        yield "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def _row(port: Port) -> tuple[str, str, str]:
    return port.path, _pace(port), _shortened(list(map(_form, port.fields)))


def _shortened(words: Sequence[str]) -> str:
    """Return as many words as fit into a line, and how many there are besides."""
    count = next((k for k in range(2, len(words)) if len(", ".join(words[: k + 1])) > _LINE), len(words))
    more = len(words) - count
    return ", ".join(words[:count]) + (f", and {more} more" if more else "")


def _pace(port: Port) -> str:
    if port.direction == "sensor":
        return f"{port.rate_hz:g} Hz" if port.rate_hz else "at times"
    return f"neutral after {port.timeout_s:g} s" if port.timeout_s else "keeps its command"


def _form(field: Field) -> str:
    """Return a field in a few characters: ``f_S (3) m/s^2``."""
    shape = f" ({field.form})" if field.shape or field.is_packed else ""
    unit = "" if field.unit == "1" else f" {field.unit}"
    kind = "" if field.type in ("float", "bytes", "buffer") else f" {field.type}"
    return f"{field.name}{shape}{kind}{unit}"


def _whole(ports: Iterable[Port]) -> Iterator[str]:
    """Yield all that is known of some ports."""
    for port in ports:
        yield f"  {port.path}: {port.kind}, {_pace(port)}. {port.doc}"
        yield from (
            f"  {line}"
            for line in _aligned(
                (
                    _form(field),
                    f"in {field.frame}" if field.frame else "",
                    f"{field.doc}{_limits(field.unit, field.minimum, field.maximum)}",
                )
                for field in port.fields
            )
        )


def _call_word(argument: Argument) -> str:
    return argument.name if argument.required else f"{argument.name}={argument.default!r}"


def _limits(unit: str, low: float | None, high: float | None) -> str:
    bounds = [f"{word} {bound:g}" for word, bound in (("from", low), ("to", high)) if bound is not None]
    unit = "" if unit == "1" else f" {unit}"
    return f" ({' '.join(bounds)}{unit})" if bounds else ""


def _first(doc: str) -> str:
    """Return the first sentence."""
    return doc.partition(". ")[0].removesuffix(".")
