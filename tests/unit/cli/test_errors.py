"""Faults of a command become a message and an exit status."""

from __future__ import annotations

import errno

import click
import pytest

from uwserver.cli.errors import told


class BadFile(Exception):
    """A fault whose text is for the user."""


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (BadFile("line 3: no number"), "line 3: no number"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "b.mcap"), "b.mcap: No such file or directory"),
        (OSError(errno.ENOSPC, "No space left on device"), "a.mcap: No space left on device"),
        (FileExistsError("a.mcap: it exists already"), "a.mcap: it exists already"),
    ],
)
def test_a_fault_is_a_message_that_names_the_file(error: Exception, message: str) -> None:
    with pytest.raises(click.ClickException) as caught, told("a.mcap", BadFile):
        raise error
    assert (caught.value.message, caught.value.exit_code) == (message, 1)
    assert caught.value.__cause__ is error


def test_text_and_status_may_be_others() -> None:
    with pytest.raises(click.ClickException) as caught, told("a", BadFile, text=lambda error: f"{error}!", status=2):
        raise BadFile("no")
    assert (caught.value.message, caught.value.exit_code) == ("no!", 2)


def test_other_errors_pass() -> None:
    with pytest.raises(KeyError), told("a", BadFile):
        raise KeyError("x")
