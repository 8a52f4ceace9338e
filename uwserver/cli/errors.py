"""Reports faults of a command to its user: one message, an exit status and no traceback."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import click


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
