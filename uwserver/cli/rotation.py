"""Options of `uwserver run` that let a recording go on in further files."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import click

_MB = "Go on in another file, as run.0002.mcap, when one has grown so far."
_S = "Likewise after so much simulated time."


def rotated(run: Callable[..., None]) -> Callable[..., None]:
    """The two options, which the command gets as one `rotation`, a `Rotation`."""

    @click.option("--record-rotate-mb", "most_mb", type=click.FloatRange(1e-3, 1e9), metavar="MB", help=_MB)
    @click.option("--record-rotate-s", "most_s", type=click.FloatRange(1.0, 1e9), metavar="SECONDS", help=_S)
    @functools.wraps(run)
    def with_rotation(most_mb: float | None, most_s: float | None, **others: Any) -> None:
        from uwserver.recording.parts import Rotation

        if (most_mb or most_s) and others["record"] is None:
            raise click.UsageError("--record-rotate-mb and --record-rotate-s need --record FILE")
        run(**others, rotation=Rotation(round(1e6 * (most_mb or 0.0)), most_s or 0.0))

    return with_rotation
