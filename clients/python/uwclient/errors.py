"""Errors between a program and uwserver."""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path


class UwError(Exception):
    """The base of all errors that uwclient raises.

    Attributes:
        message: what is wrong and what to do.
        code: a short, stable word; for a refusal that of the server (docs/reference/protocol.md, "Error codes").
        where: the argument, field, port or service at fault, or "".
    """

    def __init__(self, message: str, *, code: str = "error", where: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.code = code
        self.where = where

    def __str__(self) -> str:
        place = f"{self.code}: {self.where}" if self.where else self.code
        return f"{self.message} [{place}]"


class ConnectionLost(UwError):
    """The connection could not be made, or it ended. The text says whether a command may have been applied."""


class CallRefused(UwError):
    """A request was refused, by the server or by the client's own check against `describe`."""


class Timeout(UwError):
    """The answer or the sample did not come in time."""


class ProtocolError(UwError):
    """The peer does not speak the protocol of uwserver."""


def install_command(requirement: str) -> str:
    """Return the shell command that installs a package for the Python that runs: the first `pip` on PATH often installs elsewhere."""
    python, here, pip = Path(sys.executable or "python"), Path.cwd(), shutil.which("pip")
    if not sys.executable or (pip is not None and Path(pip).parent == python.parent):
        return f'pip install "{requirement}"'
    name = python.relative_to(here) if python.is_relative_to(here) else python
    return f'{shlex.quote(str(name))} -m pip install "{requirement}"'
