"""Fields of another component's samples, found by name once, when a world is built."""

from __future__ import annotations

from collections.abc import Sequence

from uwserver.ports.checks import suggestion
from uwserver.ports.values import Field


def bind(port: str, fields: Sequence[Field], *names: str) -> tuple[int, ...]:
    """Where these fields stand in the value of each sample of a port.

    Raises:
        ValueError: the port has no such field; the text names the nearest, and all that there are.
    """
    known = [field.name for field in fields]
    for name in names:
        if name not in known:
            raise ValueError(f'"{port}" has no field "{name}"{suggestion(name, known)}; it has: {", ".join(known)}')
    return tuple(known.index(name) for name in names)
