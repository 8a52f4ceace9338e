"""Errors between a program and uwserver."""

from __future__ import annotations


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
