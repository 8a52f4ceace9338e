"""The token that an adapter's clients must show: that of its table or of the environment, or one that is made for this run."""

from __future__ import annotations

import os
import secrets
from typing import NamedTuple

TOKEN_VARIABLE = "UWSERVER_TOKEN"
"""Environment variable with the token of clients, and of adapters whose table has none."""


class Token(NamedTuple):
    """The token that clients must show.

    Attributes:
        text: the token; None if none is needed.
        is_new: whether it was made for this run, so that the user must be told.
    """

    text: str | None
    is_new: bool = False


def known_token(configured: str | None) -> str | None:
    """Return the token of a table, or else of the environment; None if neither has one."""
    return configured or os.environ.get(TOKEN_VARIABLE) or None


def new_token() -> str:
    """Return a token that nobody can guess. It is hexadecimal, because a command line would take a token with a leading hyphen for an option."""
    return secrets.token_hex(24)


def token_for(known: str | None, needed: bool) -> Token:
    """Return the known token, or a new one if one is needed and none is known."""
    return Token(known) if known or not needed else Token(new_token(), True)
