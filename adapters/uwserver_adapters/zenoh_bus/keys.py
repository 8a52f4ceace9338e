"""The keys of everything on the zenoh network."""

from __future__ import annotations

import re

_CHUNK = re.compile(r"[^/*$?#@\x00-\x20][^/*$?#\x00-\x20]*")


class BadName(ValueError):
    """A name cannot be part of a key; the text says what to do."""


class KeyScheme:
    """The keys of one server: ``<prefix>/<server>/<path>`` for ports and services, and levels that begin with ``@`` for everything else.

    zenoh's wildcards never match a level that begins with ``@``: a subscription to ``uw/<server>/**`` gets samples and commands only.

    Args:
        prefix: first levels of all keys.
        server: name of the server.

    Raises:
        BadName: prefix or server cannot be part of a key.
    """

    def __init__(self, prefix: str, server: str) -> None:
        for what, chunks in (("prefix", prefix.split("/")), ("server", [server])):
            for chunk in chunks:
                if not _CHUNK.fullmatch(chunk):
                    raise BadName(
                        f'{what} = "{prefix if what == "prefix" else server}" cannot be part of a zenoh key: use letters, digits, "-", "_" and "."'
                    )
        self.root = f"{prefix}/{server}"
        self.everything = f"{self.root}/**"
        self.describe = f"{self.root}/@describe"
        self.hello = f"{self.root}/@hello"
        self.cancel = f"{self.root}/@cancel"
        self.event = f"{self.root}/@event"
        self.identities = f"{self.root}/@id/*"
        self.clients = f"{self.root}/@client/*"
        self.losses = f"{self.root}/@lost/*"
        self.requests = (self.everything, self.describe, self.hello, self.cancel)

    def of(self, path: str) -> str:
        """Return the key of a port's samples and commands, or of a service."""
        return f"{self.root}/{path}"

    def path(self, key: str) -> str | None:
        """Return the path of the port or service with this key; None for other keys."""
        path = key.removeprefix(f"{self.root}/")
        return None if path == key or path.startswith("@") else path

    def alive(self, path: str = "") -> str:
        """Return the token of a vehicle or port, or by default of the server."""
        return f"{self.root}/@alive/{path}" if path else f"{self.root}/@alive"

    def jpeg(self, path: str) -> str:
        """Return the key of a port's pictures as JPEG."""
        return f"{self.root}/@jpeg/{path}"

    def identity(self, zid: str) -> str:
        """Return the token that distinguishes servers of the same name."""
        return f"{self.root}/@id/{zid}"

    def error(self, client: str, path: str) -> str:
        """Return the key under which the refusal of a put is published."""
        return f"{self.root}/@error/{client}/{path}"

    def progress(self, client: str, request: int) -> str:
        """Return the key under which the progress of a call is published."""
        return f"{self.root}/@progress/{client}/{request}"
