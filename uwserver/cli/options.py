"""Types of options that several commands have, and the options of `uwserver run` that continue a recording in further files."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

FILE = click.Path(path_type=Path)
LOG_LEVEL = click.Choice(["debug", "info", "warning", "error"])
_MB = "Continue the recording in another file, such as run.0002.mcap, when one has this many megabytes."
_S = "Continue the recording in another file after this much simulated time."


class Number(click.FloatRange):
    """`FloatRange`, which alone would let NaN pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail("a number is needed, not nan", param, ctx)
        return number


SECONDS = Number(0.0, 1e9)


def rotated(run: Callable[..., None]) -> Callable[..., None]:
    """Add the two options to a command, which gets them as one argument `rotation`, a `Rotation`."""

    @click.option("--record-rotate-mb", "most_mb", type=Number(1e-3, 1e9), metavar="MB", help=_MB)
    @click.option("--record-rotate-s", "most_s", type=Number(1.0, 1e9), metavar="SECONDS", help=_S)
    @functools.wraps(run)
    def with_rotation(most_mb: float | None, most_s: float | None, **others: Any) -> None:
        from uwserver.recording.parts import Rotation

        if (most_mb or most_s) and others["record"] is None:
            raise click.UsageError("--record-rotate-mb and --record-rotate-s need --record FILE")
        run(**others, rotation=Rotation(round(1e6 * (most_mb or 0.0)), most_s or 0.0))

    return with_rotation
