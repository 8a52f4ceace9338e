"""What all commands share at the terminal: types of options, colours, text from files that is safe to print, and messages about faults."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

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


Colour = Literal["green", "yellow", "red", "cyan"]


def styled(text: str, fg: Colour | None = None, bold: bool = False) -> str:
    """Return the text in a colour."""
    return text if os.environ.get("NO_COLOR") else click.style(text, fg=fg, bold=bold or None)


def coloured_problems(text: str) -> str:
    """Return the faults and warnings of a scenario, one on each line, with the place in red, or in yellow for a warning."""
    return "\n".join(map(_problem, text.splitlines()))


def _problem(line: str) -> str:
    place = re.match(r"\S+?:(?:\d+:\d+:)?(?= )", line)
    if place is None:
        return styled(line, bold=True)
    return styled(place[0], fg="yellow" if ": warning: " in line else "red") + line[place.end() :]


@contextlib.contextmanager
def told(
    place: str | Path, *faults: type[Exception], text: Callable[[Exception], str] = str, status: int = 1
) -> Iterator[None]:
    """Report the listed exceptions, and every `OSError`, as messages of the command line.

    Args:
        place: the file or name that a message about an `OSError` begins with if the error names no file.
        faults: exceptions whose text is written for the user.
        text: makes the message of such an exception.
        status: exit status of the process.

    Raises:
        click.ClickException: in place of the exception.
    """
    reported: tuple[type[Exception], ...] = (*faults, OSError)
    try:
        yield
    except reported as error:
        message = text(error)
        # An error of the system has a reason of its own; the text of one that uwserver raises says everything.
        if isinstance(error, OSError) and not isinstance(error, faults) and error.strerror is not None:
            message = f"{error.filename or place}: {error.strerror}"
        refusal = click.ClickException(message)
        refusal.exit_code = status  # type: ignore[misc]  # click declares it for classes
        raise refusal from error


def printable(text: str) -> str:
    """Return text from a log with a placeholder for each control character, so that it cannot command a terminal."""
    return "".join(c if c.isprintable() else "\ufffd" for c in text)


def printable_error(error: Exception) -> str:
    """Return the message of an error that may quote a log, as `printable`."""
    return printable(str(error))
