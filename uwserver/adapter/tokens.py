"""The token that an adapter's clients show: the one of its table or of the environment, or one that is made for this run."""

from __future__ import annotations

import os
import secrets
from typing import NamedTuple

TOKEN_VARIABLE = "UWSERVER_TOKEN"
"""Of the environment: the token of adapters whose table names none, and of clients."""


class Token(NamedTuple):
    """What clients must show.

    Attributes:
        text: the token; None where none is needed.
        is_new: it was made for this run, and somebody must be told.
    """

    text: str | None
    is_new: bool = False


def known_token(configured: str | None) -> str | None:
    """The token of a table, else of the environment; None where neither has one."""
    return configured or os.environ.get(TOKEN_VARIABLE) or None


def new_token() -> str:
    """A token that nobody guesses; hexadecimal, as a hyphen in front would be an option of a command line."""
    return secrets.token_hex(24)


def token_for(known: str | None, needed: bool) -> Token:
    """What clients must show: the known token, or a new one where one is needed and none is known."""
    return Token(known) if known or not needed else Token(new_token(), True)
